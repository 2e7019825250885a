"""The names of objectives and scales for people, and the names of pictures in a result folder."""

from __future__ import annotations

from typing import Final

__all__ = [
    "EFFECTS_FOLDER",
    "FRAMES_FOLDER",
    "GRADIENTS_FOLDER",
    "MOMENTS",
    "effect_file",
    "frame_file",
    "gradient_file",
    "objective_label",
    "scale_name",
]

FRAMES_FOLDER: Final = "frames"
EFFECTS_FOLDER: Final = "effects"
GRADIENTS_FOLDER: Final = "gradients"
MOMENTS: Final = ("start", "end")
LABELS: Final = {
    "loi": "loi (ours)",
    "pixel_l2": "pixel L2",
    "gaussian_pyramid": "Gaussian pyramid",
    "ms_ssim": "MS-SSIM",
}


def objective_label(name: str) -> str:
    """Return the name of an objective for tables and legends."""
    return LABELS.get(name, name)


def scale_name(sigma: float, alpha: float, beta: float) -> str:
    """Return a scale as words, such as "sigma 1, alpha 3, beta 0.125"."""
    return f"sigma {sigma:g}, alpha {alpha:g}, beta {beta:g}"


def frame_file(step: int) -> str:
    """Return the picture of a recorded step, within the result folder."""
    return f"{FRAMES_FOLDER}/{step:06d}.png"


def effect_file(name: str) -> str:
    """Return the picture of an effect, within the result folder."""
    return f"{EFFECTS_FOLDER}/{name.replace(' ', '-')}.png"


def gradient_file(moment: str, sigma: float, alpha: float, beta: float) -> str:
    """Return the picture of a scale's gradient, within the result folder; `moment` is "start" or "end"."""
    return f"{GRADIENTS_FOLDER}/{moment}-sigma-{sigma:.9g}-alpha-{alpha:.9g}-beta-{beta:.9g}.png"
