"""Published figures of Table 3: PSNR in dB, and MAE, or SSIM in the last three columns."""

from __future__ import annotations

from typing import Final

from examples.paper.table3.settings import LABELS

__all__ = ["PAPER"]

PAPER: Final[dict[str, tuple[tuple[float, float], ...]]] = {
    LABELS["gaussian_pyramid"]: (
        (31.16, 0.18), (22.40, 0.49), (25.55, 0.59), (19.53, 2.11), (14.82, 0.73), (42.48, 0.99), (47.79, 0.99),
    ),
    LABELS["ms_ssim"]: (
        (23.51, 0.60), (17.61, 0.88), (11.20, 0.83), (17.74, 2.37), (9.01, 0.33), (11.19, 0.72), (23.30, 0.73),
    ),
    LABELS["rgbxy"]: (
        (63.62, 0.00), (26.66, 0.45), (30.75, 0.30), (30.23, 0.68), (23.50, 0.92), (33.01, 0.96), (32.43, 0.91),
    ),
    LABELS["loi"]: (
        (51.77, 0.00), (30.73, 0.33), (28.22, 0.54), (36.23, 0.35), (27.22, 0.96), (49.07, 1.00), (55.22, 1.00),
    ),
}  # fmt: skip
