"""What a fit has reached must not be lost to what breaks."""

from __future__ import annotations

from dataclasses import dataclass

from loi_core.errors import FitDivergedError, FitError, LoiError, NonFiniteImageError
from loi_core.fitting.state import State
from loi_core.support.guards import is_ctrl_c
from loi_core.support.wording import described

__all__ = ["keeping"]


@dataclass(frozen=True)
class keeping:  # noqa: N801 - it reads as what it does: with keeping(state, "rendering")
    """Whatever breaks after the first step must not take the best parameters with it.

    A class, since a generator that Ctrl-C cuts off could not tell its own end from an error.
    """

    state: State
    what: str

    def __enter__(self) -> None:
        pass

    def __exit__(self, _: object, error: BaseException | None, __: object) -> None:
        if error is None or is_ctrl_c(error):
            return
        result = self.state.result()
        if result is None and isinstance(error, LoiError) and not isinstance(error, NonFiniteImageError):
            return  # nothing is lost yet, and the error says what is wrong with the call
        if isinstance(error, NonFiniteImageError):
            msg = f"step {self.state.step}: the render is not finite: {described(error)}"
            raise FitDivergedError(msg, result) from error
        msg = f"step {self.state.step}: {self.what} failed: {described(error)}"
        raise FitError(msg, result) from error
