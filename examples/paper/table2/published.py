"""Published figures of Table 2: PSNR in dB, and MAE of the parameters in a unit that the paper does not state."""

from __future__ import annotations

from typing import Final

from examples.paper.table2.settings import LABELS

__all__ = ["PAPER"]

PAPER: Final[dict[str, tuple[tuple[float, float], ...]]] = {
    LABELS["gaussian_pyramid"]: ((24.44, 1.1349), (24.06, 2.3491), (21.02, 0.7317), (23.55, 0.5189), (28.73, 0.8072)),
    LABELS["ms_ssim"]: ((24.35, 0.9320), (24.34, 0.9061), (10.30, 86.2286), (18.91, 0.7742), (30.26, 0.6703)),
    LABELS["prdpt"]: ((31.77, 0.0035), (27.74, 6.0147), (17.09, 4.8801), (22.25, 0.9201), (31.87, 0.7543)),
    LABELS["loi"]: ((54.33, 0.0034), (54.73, 0.0033), (32.58, 0.3475), (25.23, 0.4855), (36.17, 0.0775)),
}
