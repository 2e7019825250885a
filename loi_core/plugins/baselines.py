"""Baselines by name: objectives of the core and of plugins for comparison with the loss."""

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

BUILT_IN: Final[dict[str, ObjectiveFactory]] = {
    "pixel_l2": PixelL2,
    "gaussian_pyramid": GaussianPyramid,
    "ms_ssim": MSSSIM,
}


def is_objective_name(name: object) -> bool:
    """Return whether `name` is a valid name of an objective; folders of results have the same name."""
    return isinstance(name, str) and re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}", name) is not None


def baseline_names() -> list[str]:
    """Return the names of all baselines, core baselines first, without importing plugins."""
    return [*BUILT_IN, *(name for name in OBJECTIVES.names() if is_objective_name(name) and name not in BUILT_IN)]


def make_baseline(
    name: str, target: FloatImage, *, nan_policy: NanPolicy, tone: LogTone | None, weights: FloatImage | None = None
) -> Objective:
    """Return the baseline called `name`, with `target` as its reference.

    Raises
    ------
    LoiError
        If it cannot be loaded, rejects the reference or an option, or its factory does not return an objective.
    """
    factory = BUILT_IN[name] if name in BUILT_IN else OBJECTIVES.load(name)
    try:
        options = {} if weights is None else {"weights": weights}
        objective = factory(target, nan_policy=nan_policy, tone=tone, **options)
        usable = isinstance(objective, Objective)
    except LoiError:
        raise
    except BaseException as error:  # a third party may raise anything, SystemExit too
        if is_ctrl_c(error):
            raise
        msg = f"{name} refused: {described(error)}"
        raise OptionError(msg) from error
    if not usable:
        msg = f"{name} made a {type(objective).__name__}, which is not an objective"
        raise OptionError(msg)
    return objective
