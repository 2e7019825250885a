"""What a page takes from a result folder: its own pictures and texts, of a bounded size, through no link."""

from __future__ import annotations

import base64
import stat
from html import escape
from pathlib import Path
from typing import Final

from loi_core.errors import SceneError
from loi_core.io.files import read_bytes

__all__ = ["Pictures"]

MOST_PICTURE: Final = 2**26  # bytes of one PNG
MOST_PICTURES: Final = 2**28  # and of all on a page
PNG_SIGNATURE: Final = b"\x89PNG\r\n\x1a\n"
SMALL: Final = 512  # pixels: wider pictures are shown smooth, others with their pixels


class Pictures:
    """The PNGs of a result folder, put into a page; what lies elsewhere, or is no PNG, is not.

    Parameters
    ----------
    folder : Path
        The folder of results.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._left = MOST_PICTURES

    def figure(
        self, name: str, caption: str, attributes: str = "", *, image_class: str = "", key: str = "", alt: str = ""
    ) -> str:
        """A PNG with a caption; nothing if there is no such file, or it is not a PNG.

        Parameters
        ----------
        name : str
            Of the file.
        caption : str
            Also what it is called where it is not seen, unless `alt` says more.
        attributes : str
            Of the figure, as they stand in HTML.
        image_class : str
            Of the image.
        key : str
            What scripts find it by.
        alt : str

        Raises
        ------
        SceneError
            If it is a link, or too large.
        """
        png = self.read(name)
        if png is None:
            return ""
        data = base64.b64encode(png).decode("ascii")
        width, height = int.from_bytes(png[16:20], "big"), int.from_bytes(png[20:24], "big")
        kinds = [kind for kind in (image_class, "pixels" if width < SMALL and not image_class else "") if kind]
        told = [f'class="{" ".join(kinds)}"'] if kinds else []
        told += [f'data-picture="{escape(key)}"'] if key else []
        told += [f'width="{width}" height="{height}"'] if 0 < width < 2**16 and 0 < height < 2**16 else []
        image = f'<img {" ".join(told)} alt="{escape(alt or caption)}" src="data:image/png;base64,{data}">'
        return f"<figure{attributes}>{image}<figcaption>{escape(caption)}</figcaption></figure>"

    def read(self, name: str) -> bytes | None:
        """The bytes of a PNG; None and errors as in :meth:`figure`."""
        content = self._content(name, min(MOST_PICTURE, self._left))
        if content is None or not content.startswith(PNG_SIGNATURE):
            return None
        self._left -= len(content)
        return content

    def size(self, name: str) -> int:
        """How many bytes a file has; 0 if it is none of the folder's."""
        path = self._own(name)
        return 0 if path is None else path.lstat().st_size

    def text(self, name: str, most: int) -> str:
        """A text of the folder; empty if there is none, or it has more than `most` bytes.

        Raises
        ------
        SceneError
            If it is a link.
        """
        if self.size(name) > most:
            return ""
        content = self._content(name, most)
        return "" if content is None else content.decode("utf-8", errors="replace")

    def _content(self, name: str, most: int) -> bytes | None:
        path = self._own(name)
        if path is None:
            return None
        if path.lstat().st_size > most:
            raise self._refused(path, "is too large for a page")
        return read_bytes(path, most)

    def _own(self, name: str) -> Path | None:
        """A regular file within the folder, or None."""
        path, mode = self._folder, 0
        for part in Path(name).parts:
            path = path / part
            try:
                mode = path.lstat().st_mode
            except (FileNotFoundError, NotADirectoryError):
                return None
            if stat.S_ISLNK(mode):
                raise self._refused(path, "is a link, and may lead anywhere")
        return path if stat.S_ISREG(mode) else None

    @staticmethod
    def _refused(path: Path, why: str) -> SceneError:
        return SceneError(f"{path} {why}; a report shows the pictures of its own folder")
