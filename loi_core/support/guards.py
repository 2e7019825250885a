"""Running foreign code, which may raise anything."""

from __future__ import annotations

from dataclasses import dataclass

from loi_core.errors import LoiError, RendererError
from loi_core.support.wording import described

__all__ = ["is_ctrl_c", "wrap_errors"]


def is_ctrl_c(error: BaseException) -> bool:
    """Return whether the user interrupts; subclasses of ``KeyboardInterrupt`` in a plugin do not count."""
    return type(error) is KeyboardInterrupt


@dataclass(frozen=True)
class wrap_errors:  # noqa: N801 - a context manager reads as a verb: with wrap_errors("rendering")
    """Turn any error of a renderer into a :class:`RendererError` that names the failed action.

    Errors of loi, Ctrl-C and a lack of memory pass unchanged.
    """

    action: str

    def __enter__(self) -> None:
        pass

    def __exit__(self, _: object, error: BaseException | None, __: object) -> None:
        if error is None or is_ctrl_c(error) or isinstance(error, LoiError | MemoryError):
            return
        msg = f"{self.action} failed: {described(error)}"
        raise RendererError(msg) from error
