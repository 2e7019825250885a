"""Published figures of Table 1: PSNR in dB and SSIM for 4, 16, 32, 64 and 256 disks."""

from __future__ import annotations

from typing import Final

from examples.paper.table1.settings import LABELS

__all__ = ["PAPER"]

PAPER: Final[dict[str, tuple[tuple[float, float], ...]]] = {
    LABELS["gaussian_pyramid"]: ((25.05, 0.97), (19.83, 0.91), (16.83, 0.83), (15.34, 0.76), (9.60, 0.34)),
    LABELS["ms_ssim"]: ((27.44, 0.98), (21.41, 0.94), (17.93, 0.87), (15.42, 0.78), (9.83, 0.35)),
    LABELS["lpips_vgg"]: ((27.79, 0.98), (20.94, 0.93), (17.88, 0.86), (17.04, 0.82), (15.2, 0.76)),
    LABELS["loi"]: ((30.40, 0.99), (33.55, 0.99), (27.43, 0.97), (28.23, 0.96), (21.57, 0.90)),
}
