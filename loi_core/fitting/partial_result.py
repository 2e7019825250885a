"""Errors during a fit, with the best result so far."""

from __future__ import annotations

from dataclasses import dataclass

from loi_core.errors import FitDivergedError, FitError, LoiError, NonFiniteImageError
from loi_core.fitting.state import State
from loi_core.support.guards import is_ctrl_c
from loi_core.support.wording import described

__all__ = ["with_partial_result"]


@dataclass(frozen=True)
class with_partial_result:  # noqa: N801 - a context manager
    """Raise any error of the block as a :class:`FitError` with the best result so far.

    Ctrl-C passes unchanged. Errors of the library before the first value pass too, since they name the wrong argument.
    This is a class because a generator that Ctrl-C interrupts cannot distinguish its own end from an error.
    """

    state: State
    action: str

    def __enter__(self) -> None:
        pass

    def __exit__(self, _: object, error: BaseException | None, __: object) -> None:
        if error is None or is_ctrl_c(error):
            return
        result = self.state.result()
        if result is None and isinstance(error, LoiError) and not isinstance(error, NonFiniteImageError):
            return
        if isinstance(error, NonFiniteImageError):
            msg = f"step {self.state.step}: the render is not finite: {described(error)}"
            raise FitDivergedError(msg, result) from error
        msg = f"step {self.state.step}: {self.action} failed: {described(error)}"
        raise FitError(msg, result) from error
