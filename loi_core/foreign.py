"""Running code that is not ours and may raise anything."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from loi_core.errors import LoiError, RendererError
from loi_core.messages import told

__all__ = ["foreign", "is_ctrl_c"]


def is_ctrl_c(error: BaseException) -> bool:
    """Whether the user wants to stop; a plugin's own exceptions derived from ``KeyboardInterrupt`` do not say so."""
    return type(error) is KeyboardInterrupt


@contextlib.contextmanager
def foreign(what: str) -> Iterator[None]:
    """Turn whatever a renderer raises into a :class:`RendererError` that says what failed.

    Our own errors, Ctrl-C and a lack of memory pass as they are.
    """
    try:
        yield
    except (LoiError, MemoryError):
        raise
    except BaseException as error:  # SystemExit as well, and what derives from BaseException alone
        if is_ctrl_c(error):
            raise
        msg = f"{what} failed: {told(error)}"
        raise RendererError(msg) from error
