"""Short, one-line texts of arbitrary values and errors for messages."""

from __future__ import annotations

import io
from collections.abc import Collection, Iterable
from typing import Final, TextIO

__all__ = ["MAX_LISTED", "PlainText", "clause", "described", "listed", "printable", "shown"]

MAX_SHOWN_LENGTH: Final = 60
MAX_ERROR_LENGTH: Final = 500
MAX_LISTED: Final = 4
"""Names in a list before the others are only counted; a single other is named as well."""


def shown(value: object) -> str:
    """Return the first 60 characters of `value` as Python code on one line; its type if it cannot be printed.

    Numbers of thousands of digits, deeply nested values and objects of a plugin cannot always be printed.
    """
    try:
        text = repr(value)
    except Exception:  # noqa: BLE001 - the message around the value matters more than the error
        return f"a {type(value).__name__} that cannot be printed"
    return " ".join(text[:MAX_SHOWN_LENGTH].split())


def listed(names: Iterable[str]) -> str:
    """Return each name once, in quotes; of more than five names the first four and the number of the others."""
    quoted = [repr(name) for name in dict.fromkeys(names)]
    omitted = len(quoted) - MAX_LISTED
    return ", ".join(quoted) if omitted <= 1 else f"{', '.join(quoted[:MAX_LISTED])} and {omitted} others"


def clause(names: Collection[str], singular: str, plural: str) -> str:
    """Return the names as :func:`listed`, followed by `singular` for one name and `plural` for several."""
    return f"{listed(names)} {singular if len(set(names)) == 1 else plural}"


def described(error: BaseException) -> str:
    """Return the type and the message of an error on one line."""
    name = type(error).__name__
    try:
        text = str(error)
    except Exception:  # noqa: BLE001 - the type of the error is still useful
        text = "its message cannot be printed"
    text = " ".join(text[:MAX_ERROR_LENGTH].split())
    return f"{name}: {text}" if text else name


def printable(text: str) -> str:
    """Return `text` on one line, with control characters and invalid Unicode escaped."""
    return _escaped(" ".join(text.split()))


def _escaped(text: str) -> str:
    return "".join(
        letter if letter.isprintable() or letter == "\t" else letter.encode("unicode_escape").decode("ascii")
        for letter in text
    )


class PlainText(io.TextIOBase):
    """A text stream that escapes control characters, so that titles and paths cannot control the terminal.

    Parameters
    ----------
    stream : text stream
        The stream that receives the text; line ends stay as they are.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """Write `text` and return its length."""
        self._stream.write("\n".join(map(_escaped, text.split("\n"))))
        return len(text)

    @property
    def encoding(self) -> str:  # type: ignore[override]  # writable in the base, for no reason
        """The encoding of the underlying stream."""
        return self._stream.encoding

    def flush(self) -> None:
        """Flush the underlying stream."""
        self._stream.flush()

    def isatty(self) -> bool:
        """Return whether the underlying stream is a terminal."""
        return self._stream.isatty()
