"""Results of the rows in the tables of ``benchmarks.speed``."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from benchmarks.peers import PRESETS, Row

__all__ = ["Result", "Results", "Size"]

Size = tuple[int, int]


@dataclass
class Result:
    """Measurements of a row at one size."""

    size: Size
    row: Row
    milliseconds: float | None = None
    evaluations: int = 0
    peak: float | None = None  # bytes
    note: str = ""

    @property
    def stack(self) -> float | None:
        """Bytes of one inner scale's stack of levels, float32; None for losses without levels."""
        if not self.row.preset:
            return None
        scales = PRESETS[self.row.preset]
        return 4.0 * 3.0 * self.pixels * sum(map(scales.level_count, scales.beta))

    @property
    def pixels(self) -> int:
        """Pixels of the image."""
        return self.size[0] * self.size[1]


class Results(list[Result]):
    """All results of a run."""

    def milliseconds(self, size: Size, library: str, what: str, preset: str = "", device: str = "cpu") -> float | None:
        """Return the time of one row, None without a result."""
        result = self.find(size, library, what, preset, device)
        return result.milliseconds if result else None

    def find(self, size: Size, library: str, what: str, preset: str = "", device: str = "cpu") -> Result | None:
        """Return the result of one row, None without a result."""
        names = (library, what, preset, device)
        return next((result for result in self if result.size == size and result.row.names == names), None)

    def peer(self, size: Size, device: str) -> float | None:
        """The time of pytorch-msssim."""
        return self.milliseconds(size, "pytorch-msssim", "MS-SSIM", "", device)

    def rows(self) -> Iterator[tuple[Row, list[Result]]]:
        """Yield every row with its timed results, smallest image first."""
        for row in {result.row.names: result.row for result in self}.values():
            timed = [result for result in self if result.row.names == row.names and result.milliseconds is not None]
            yield row, sorted(timed, key=lambda result: result.pixels)
