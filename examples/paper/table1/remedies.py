"""What else was tried on the harder columns, one change at a time."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from examples.paper.table1.ablations import ABLATIONS
from examples.paper.table1.problem import HARDER, Column
from examples.paper.table1.settings import OURS, Setting

__all__ = ["CHECKED", "REMEDIES"]

_OURS: Final = OURS["loi"]
_ABLATED: Final = {one.name: one for one in ABLATIONS}
_FOR_IMAGE: Final = _ABLATED["for_image"]
_FIRST: Final = _ABLATED["wide extents first"]
_AGAIN: Final = _ABLATED["every scale first"]

_LARGE, _RANDOM, _UNPARTED, _NOISY = HARDER


def _then_pixels(setting: Setting, noise: float) -> Setting:
    """`setting` with noise on the render, but for its last 100 steps, which are of pixel L2 and without.

    Of iterates with different noise the one with the least loss is the one with the luckiest noise: the last counts.
    Pixel L2 reaches no further than a disk, and needs no more.
    """
    noisy = replace(
        setting,
        name=f"{setting.name}, noise on the render",
        steps=setting.steps - 100,
        kept="last",
        before=replace(setting.before, noise=noise, kept="last") if setting.before else None,
        noise=noise,
    )
    return replace(OURS["pixel_l2"], name=f"{noisy.name}, then pixels", rate=0.5, steps=100, before=noisy)


def _by_column() -> dict[Column, tuple[Setting, ...]]:
    for_image_noisy = _then_pixels(_FOR_IMAGE, _NOISY.noise)
    every_noisy = _then_pixels(_ABLATED["every scale"], _NOISY.noise)
    paper = _ABLATED["the paper's"]
    pixels = OURS["pixel_l2"]
    return {
        _LARGE: (
            replace(pixels, name="pixel L2, half the rate", rate=0.5 * pixels.rate),
            _OURS,
            _FOR_IMAGE,
            replace(_OURS, name="no extent of 1", scales="wide"),
            _FIRST,
            _AGAIN,
        ),
        _RANDOM: (
            _OURS,
            paper,
            replace(paper, name="the paper's, 13 sums of channels", channels="sums"),
            replace(_OURS, name="twice the rate", rate=2.0 * _OURS.rate),
            _FIRST,
        ),
        _UNPARTED: (
            _OURS,
            replace(_OURS, name="both orders", both_orders=True),
            _FOR_IMAGE,
            replace(_FOR_IMAGE, name="for_image, both orders", both_orders=True),
            _ABLATED["no extent of 1"],
            _ABLATED["p 2 (roots)"],
            _FIRST,
            _AGAIN,
        ),
        _NOISY: (
            _OURS,
            every_noisy,
            _FOR_IMAGE,
            *for_image_noisy.stages,
            _FIRST,
            _then_pixels(_FIRST, _NOISY.noise),
        ),
    }


REMEDIES: Final = _by_column()
# What works from the few starts that it was found on, and so is checked on all of them.
CHECKED: Final = frozenset({(_UNPARTED, _FIRST), (_UNPARTED, _AGAIN)})
