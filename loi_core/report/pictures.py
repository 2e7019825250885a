"""The pictures and texts of a result folder for a page: of limited size, and never through a link."""

from __future__ import annotations

import stat
from html import escape
from pathlib import Path
from typing import Final

from loi_core.errors import SceneError
from loi_core.io.files import read_bytes
from loi_core.report.document import data_uri

__all__ = ["Pictures", "picture_figure"]

MAX_PICTURE_BYTES: Final = 2**26  # of one PNG
MAX_TOTAL_BYTES: Final = 2**28  # of all PNGs of a page
PNG_SIGNATURE: Final = b"\x89PNG\r\n\x1a\n"
SMOOTH_WIDTH: Final = 512  # pixels; narrower pictures are shown with hard pixels


def picture_figure(png: bytes, caption: str, attributes: str = "", *, key: str = "", alt: str = "") -> str:
    """Return a PNG with a caption as HTML.

    Parameters
    ----------
    png : bytes
    caption : str
        Also the alternative text, unless `alt` is given.
    attributes : str
        Attributes of the figure, as HTML.
    key : str
        The name of the image for the script.
    alt : str
    """
    width, height = int.from_bytes(png[16:20], "big"), int.from_bytes(png[20:24], "big")
    image = ['class="pixels"'] if width < SMOOTH_WIDTH else []
    image += [f'data-picture="{escape(key)}"'] if key else []
    image += [f'width="{width}" height="{height}"'] if 0 < width < 2**16 and 0 < height < 2**16 else []
    image += [f'alt="{escape(alt or caption)}" src="{data_uri(png)}"']
    return f"<figure{attributes}><img {' '.join(image)}><figcaption>{escape(caption)}</figcaption></figure>"


class Pictures:
    """The PNGs of a result folder for a page; files outside the folder and other kinds of files are left out.

    Parameters
    ----------
    folder : Path
        The folder of results.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._remaining = MAX_TOTAL_BYTES

    def figure(self, name: str, caption: str, attributes: str = "", *, key: str = "", alt: str = "") -> str:
        """Return a PNG file of the folder as :func:`picture_figure` does; empty if it is missing or not a PNG.

        Raises
        ------
        SceneError
            If it is a link, or too large.
        """
        png = self.read(name)
        return "" if png is None else picture_figure(png, caption, attributes, key=key, alt=alt)

    def read(self, name: str) -> bytes | None:
        """Return the bytes of a PNG; None and errors as in :meth:`figure`."""
        content = self._content(name, min(MAX_PICTURE_BYTES, self._remaining))
        if content is None or not content.startswith(PNG_SIGNATURE):
            return None
        self._remaining -= len(content)
        return content

    def size(self, name: str) -> int:
        """Return the number of bytes of a file; 0 if the folder has no such file."""
        path = self._resolve(name)
        return 0 if path is None else path.lstat().st_size

    def text(self, name: str, max_bytes: int) -> str:
        """Return a text file of the folder; empty if it is missing or larger than `max_bytes`.

        Raises
        ------
        SceneError
            If it is a link.
        """
        if self.size(name) > max_bytes:
            return ""
        content = self._content(name, max_bytes)
        return "" if content is None else content.decode("utf-8", errors="replace")

    def _content(self, name: str, max_bytes: int) -> bytes | None:
        path = self._resolve(name)
        if path is None:
            return None
        if path.lstat().st_size > max_bytes:
            raise self._refusal(path, "is too large for a page")
        return read_bytes(path, max_bytes)

    def _resolve(self, name: str) -> Path | None:
        """Return the path of a regular file within the folder, or None."""
        path, mode = self._folder, 0
        for segment in Path(name).parts:
            path = path / segment
            try:
                mode = path.lstat().st_mode
            except (FileNotFoundError, NotADirectoryError):
                return None
            if stat.S_ISLNK(mode):
                raise self._refusal(path, "is a link, and may lead anywhere")
        return path if stat.S_ISREG(mode) else None

    @staticmethod
    def _refusal(path: Path, reason: str) -> SceneError:
        return SceneError(f"{path} {reason}; a report shows the pictures of its own folder")
