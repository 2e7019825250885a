"""The objectives of the stages of a fit: far ones before the objective, and a comparison of pixels after it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, TypeAlias, get_args

from loi_core.errors import OptionError
from loi_core.method.scales import ScaleSpace
from loi_core.objectives import ImageObjective, LOIObjective, Objective, PixelL2
from loi_core.support.wording import shown

__all__ = ["Polish", "Stages", "far_objectives", "polish_objectives"]

Stages: TypeAlias = Literal["auto"] | Sequence[ScaleSpace | Objective] | None
Polish: TypeAlias = Literal["pixels"] | None


def far_objectives(objective: Objective, stages: object) -> tuple[Objective, ...]:
    """Return the objectives of a fit without a polish, from far to near; `objective` is the last.

    Parameters
    ----------
    objective : Objective
    stages : "auto", None, or a sequence of ScaleSpace or Objective
        "auto" puts :meth:`ScaleSpace.far_to_near` before an objective with default scales; None adds nothing; a
        sequence lists the stages before the objective.

    Raises
    ------
    OptionError
        If `stages` is not allowed.
    """
    if stages is None:
        return (objective,)
    if isinstance(stages, str) and stages == "auto":
        if not isinstance(objective, LOIObjective) or not objective.has_default_scales:
            return (objective,)
        height, width = objective.size
        scales = objective.scales
        far_scales = ScaleSpace.far_to_near(
            height, width, beta=scales.beta[0], bounds=scales.bounds, boundary=scales.boundary
        )[:-1]
        return (*map(objective.with_scales, far_scales), objective)
    if isinstance(stages, str) or not isinstance(stages, Sequence):
        msg = f"`stages` must be 'auto', None, or a sequence of ScaleSpace or objectives, got {shown(stages)}"
        raise OptionError(msg)
    objectives: list[Objective] = []
    for stage in stages:
        if isinstance(stage, ScaleSpace) and isinstance(objective, LOIObjective):
            objectives.append(objective.with_scales(stage))
        elif isinstance(stage, Objective) and not isinstance(stage, ScaleSpace):
            objectives.append(stage)
        else:
            msg = f"`stages` must hold scales (for a LOIObjective) or objectives, got {shown(stage)}"
            raise OptionError(msg)
    return (*objectives, objective)


def polish_objectives(objective: Objective, polish: object) -> tuple[Objective, ...]:
    """Return the objectives after the main stage: none, or the pixels of `objective` compared.

    Raises
    ------
    OptionError
        If `polish` is not allowed, or the objective has no reference image.
    """
    if polish is None:
        return ()
    if not isinstance(polish, str) or polish not in get_args(get_args(Polish)[0]):
        msg = f"`polish` must be 'pixels' or None, got {shown(polish)}"
        raise OptionError(msg)
    if not isinstance(objective, ImageObjective):
        msg = f"`polish` needs an objective that has a reference image, got {type(objective).__name__}"
        raise OptionError(msg)
    return (
        PixelL2(
            objective.reference,
            channel_axis=objective.channel_axis,
            nan_policy=objective.nan_policy,
            tone=objective.tone,
            weights=objective.weights,
        ),
    )
