"""The objectives of the stages of a fit: far ones, the main one, and one that finishes its result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias, get_args

from loi_core.errors import OptionError
from loi_core.method.scales import ScaleSpace
from loi_core.objectives import ImageObjective, LOIObjective, Objective, PixelL2
from loi_core.support.wording import shown

__all__ = ["Polish", "StagedObjectives", "Stages", "staged_objectives"]

Stages: TypeAlias = Literal["auto"] | Sequence[ScaleSpace | Objective] | None
Polish: TypeAlias = Literal["pixels"] | None


@dataclass(frozen=True)
class StagedObjectives:
    """The objectives of one view.

    Attributes
    ----------
    far : tuple of Objective
        From far to near.
    main : Objective
    finish : Objective, optional
        Finishes the result of the main stage.
    """

    far: tuple[Objective, ...]
    main: Objective
    finish: Objective | None = None


def staged_objectives(
    objective: Objective, stages: object, polish: object, *, exposure_is_free: bool = False
) -> StagedObjectives:
    """Return the objectives of the stages of a fit.

    Parameters
    ----------
    objective : Objective
    stages : "auto", None, or a sequence of ScaleSpace or Objective
        "auto" chooses the stages of a :class:`LOIObjective` with default scales, and none for others; None compares
        with `objective` alone; a sequence lists the stages before `objective`.
    polish : "pixels" or None
        "pixels" finishes by a comparison of pixels.
    exposure_is_free : bool
        Whether a free parameter is a brightness; stages that "auto" chooses compare it from the beginning then.

    Raises
    ------
    OptionError
        If `stages` or `polish` is not allowed, or a polish has no reference image.
    """
    if polish is not None and (not isinstance(polish, str) or polish not in get_args(get_args(Polish)[0])):
        msg = f"`polish` must be 'pixels' or None, got {shown(polish)}"
        raise OptionError(msg)
    staged = _unpolished(objective, stages, exposure_is_free=exposure_is_free)
    return staged if polish is None else replace(staged, finish=_pixels_of(objective))


def _unpolished(objective: Objective, stages: object, *, exposure_is_free: bool) -> StagedObjectives:
    if stages is None:
        return StagedObjectives((), objective)
    if isinstance(stages, str) and stages == "auto":
        if isinstance(objective, LOIObjective) and objective.has_default_scales:
            return _far_to_near(objective, exposure_is_free=exposure_is_free)
        return StagedObjectives((), objective)
    if isinstance(stages, str) or not isinstance(stages, Sequence):
        msg = f"`stages` must be 'auto', None, or a sequence of ScaleSpace or objectives, got {shown(stages)}"
        raise OptionError(msg)
    far: list[Objective] = []
    for stage in stages:
        if isinstance(stage, ScaleSpace) and isinstance(objective, LOIObjective):
            far.append(objective.with_scales(stage))
        elif isinstance(stage, Objective) and not isinstance(stage, ScaleSpace):
            far.append(stage)
        else:
            msg = f"`stages` must hold scales (for a LOIObjective) or objectives, got {shown(stage)}"
            raise OptionError(msg)
    return StagedObjectives(tuple(far), objective)


def _far_to_near(objective: LOIObjective, *, exposure_is_free: bool) -> StagedObjectives:
    """Return the stages of an objective with default scales.

    Photographs hardly ever have the exposure of their render, and a difference of some per cent outweighs the pull of a
    distant object. All but the last stage therefore match the exposure, and compare histograms without the global part.
    The last stage compares brightness again, but for an exposure that it detects there; all stages do
    if a free parameter is a brightness.
    """
    height, width = objective.size
    scales = objective.scales
    *far_scales, near_scales, _ = ScaleSpace.far_to_near(
        height, width, beta=scales.beta[0], bounds=scales.bounds, boundary=scales.boundary
    )
    if objective.exposure == "given" and exposure_is_free:
        return StagedObjectives(
            tuple(objective.with_scales(replace(stage, centred=False)) for stage in far_scales), objective
        )
    far = tuple(objective.with_exposure("matched").with_scales(stage) for stage in far_scales)
    if objective.exposure != "given":
        return StagedObjectives(far, objective.with_exposure("regressed"))
    main = objective.with_exposure("matched").with_scales(near_scales)
    return StagedObjectives(far, main, objective.with_exposure("detected"))


def _pixels_of(objective: Objective) -> PixelL2:
    """Return the comparison of pixels with the reference of an objective."""
    if not isinstance(objective, ImageObjective):
        msg = f"`polish` needs an objective that has a reference image, got {type(objective).__name__}"
        raise OptionError(msg)
    return PixelL2(
        objective.reference,
        channel_axis=objective.channel_axis,
        nan_policy=objective.nan_policy,
        tone=objective.tone,
        weights=objective.weights,
        exposure="given" if objective.exposure == "given" else "regressed",
    )
