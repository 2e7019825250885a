"""What messages show of values and errors that may be anything: always short, always one line."""

from __future__ import annotations

import io
from collections.abc import Collection, Iterable
from typing import Final, TextIO

__all__ = ["LISTED", "PlainText", "clause", "described", "listed", "printable", "shown"]

MOST: Final = 60
MOST_DESCRIBED: Final = 500
LISTED: Final = 4
"""Names in a list, before others are counted; one more is named as well."""


def shown(value: object) -> str:
    """The first 60 characters of how `value` would be typed, on one line; its type if it cannot be printed.

    Numbers of thousands of digits, nests of thousands of levels and objects of a plugin cannot always be.
    """
    try:
        text = repr(value)
    except Exception:  # noqa: BLE001 - whatever it is, the message that shows it matters more
        return f"a {type(value).__name__} that cannot be printed"
    return " ".join(text[:MOST].split())


def listed(names: Iterable[str]) -> str:
    """Each of `names` once, in quotes; of more than five the first four, and how many others there are."""
    quoted = [repr(one) for one in dict.fromkeys(names)]
    more = len(quoted) - LISTED
    return ", ".join(quoted) if more <= 1 else f"{', '.join(quoted[:LISTED])} and {more} others"


def clause(names: Collection[str], one: str, several: str) -> str:
    """The names as :func:`listed`, and what they do: `one` if there is one of them, or else `several`."""
    return f"{listed(names)} {one if len(set(names)) == 1 else several}"


def described(error: BaseException) -> str:
    """The type of `error` and what it says, on one line."""
    name = type(error).__name__
    try:
        text = str(error)
    except Exception:  # noqa: BLE001 - likewise
        text = "its message cannot be printed"
    text = " ".join(text[:MOST_DESCRIBED].split())
    return f"{name}: {text}" if text else name


def printable(text: str) -> str:
    """`text` on one line, with control characters and such as have no UTF-8 escaped, so that a terminal shows all."""
    return _escaped(" ".join(text.split()))


def _escaped(text: str) -> str:
    plain = (one if one.isprintable() or one == "\t" else one.encode("unicode_escape").decode("ascii") for one in text)
    return "".join(plain)


class PlainText(io.TextIOBase):
    """A stream on which titles, paths and names may be printed, whoever chose them: a terminal obeys none of them.

    Parameters
    ----------
    stream : text stream
        Where the text goes on to, with line ends as they are and all other control characters escaped.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """Write `text`; how long it was."""
        self._stream.write("\n".join(map(_escaped, text.split("\n"))))
        return len(text)

    @property
    def encoding(self) -> str:  # type: ignore[override]  # writable in the base, for no reason
        """Of the stream that the text goes on to."""
        return self._stream.encoding

    def flush(self) -> None:
        """Have all that was written go on."""
        self._stream.flush()

    def isatty(self) -> bool:
        """Whether it ends at a terminal."""
        return self._stream.isatty()
