"""Running code that is not ours and may raise anything."""

from __future__ import annotations

from dataclasses import dataclass

from loi_core.errors import LoiError, RendererError
from loi_core.support.wording import described

__all__ = ["foreign", "is_ctrl_c"]


def is_ctrl_c(error: BaseException) -> bool:
    """Whether the user wants to stop; a plugin's own exceptions derived from ``KeyboardInterrupt`` do not say so."""
    return type(error) is KeyboardInterrupt


@dataclass(frozen=True)
class foreign:  # noqa: N801 - it reads as what it does: with foreign("rendering")
    """Turns whatever a renderer raises into a :class:`RendererError` that says what failed.

    Our own errors, Ctrl-C and a lack of memory pass as they are.
    """

    what: str

    def __enter__(self) -> None:
        pass

    def __exit__(self, _: object, error: BaseException | None, __: object) -> None:
        if error is None or is_ctrl_c(error) or isinstance(error, LoiError | MemoryError):
            return
        msg = f"{self.what} failed: {described(error)}"
        raise RendererError(msg) from error
