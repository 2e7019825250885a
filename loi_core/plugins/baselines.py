"""The objectives that scenes compare the loss with, by name: the core's own, and those that packages announce."""

from __future__ import annotations

import re
from typing import Final

from loi_core.errors import LoiError, OptionError
from loi_core.io.images import FloatImage
from loi_core.objectives import MSSSIM, GaussianPyramid, Objective, PixelL2
from loi_core.pixels.nonfinite import NanPolicy
from loi_core.pixels.tone_curve import LogTone
from loi_core.plugins.registry import OBJECTIVES, ObjectiveFactory
from loi_core.support.guards import is_ctrl_c
from loi_core.support.wording import described

__all__ = ["baseline_names", "is_objective_name", "make_baseline"]

OWN: Final[dict[str, ObjectiveFactory]] = {
    "pixel_l2": PixelL2,
    "gaussian_pyramid": GaussianPyramid,
    "ms_ssim": MSSSIM,
}


def is_objective_name(name: object) -> bool:
    """Whether an objective may have this name, which becomes that of a folder."""
    return isinstance(name, str) and re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}", name) is not None


def baseline_names() -> list[str]:
    """The names of all baselines, the core's own first; no package is imported."""
    return [*OWN, *(name for name in OBJECTIVES.names() if is_objective_name(name) and name not in OWN)]


def make_baseline(
    name: str, target: FloatImage, *, nan_policy: NanPolicy, tone: LogTone | None, weights: FloatImage | None = None
) -> Objective:
    """The baseline of this name, with `target` as its reference.

    Raises
    ------
    LoiError
        If it cannot be loaded, does not take the reference or an option, or what comes is no objective.
    """
    factory = OWN[name] if name in OWN else OBJECTIVES.load(name)
    try:
        own = {} if weights is None else {"weights": weights}
        made = factory(target, nan_policy=nan_policy, tone=tone, **own)
        usable = isinstance(made, Objective)
    except LoiError:
        raise
    except BaseException as error:  # a third party may raise anything, SystemExit too
        if is_ctrl_c(error):
            raise
        msg = f"{name} refused: {described(error)}"
        raise OptionError(msg) from error
    if not usable:
        msg = f"{name} made a {type(made).__name__}, which is not an objective"
        raise OptionError(msg)
    return made
