"""What else was tried on the harder columns, one change at a time."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from examples.paper.table1.ablations import ABLATIONS
from examples.paper.table1.problem import HARDER, Column
from examples.paper.table1.settings import OURS, PROTOCOLS, Setting

__all__ = ["REMEDIES"]

_OURS: Final = OURS["loi"]
_ABLATED: Final = {one.name: one for one in ABLATIONS}
_FOR_IMAGE: Final = _ABLATED["for_image"]
_FIRST: Final = _ABLATED["wide extents first"]

_LARGE, _RANDOM, _UNPARTED, _NOISY = HARDER


def _then_pixels(setting: Setting, noise: float) -> Setting:
    """`setting` with noise on the render, then pixel L2 without.

    Of iterates with different noise the one with the least loss is the one with the luckiest noise: the last counts.
    Pixel L2 reaches no further than a disk, and needs no more.
    """
    noisy = replace(setting, name=f"{setting.name}, noise on the render", steps=400, noise=noise, kept="last")
    return replace(PROTOCOLS["ours"]["pixel_l2"], name=f"{noisy.name}, then pixels", rate=0.5, steps=100, before=noisy)


def _by_column() -> dict[Column, tuple[Setting, ...]]:
    for_image_noisy = _then_pixels(_FOR_IMAGE, _NOISY.noise)
    every_noisy = _then_pixels(_ABLATED["every scale"], _NOISY.noise)
    paper = _ABLATED["the paper's"]
    return {
        _LARGE: (_OURS, _FOR_IMAGE, replace(_OURS, name="no extent of 1", scales="wide"), _FIRST),
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
            _FIRST,
        ),
        _NOISY: (
            _OURS,
            every_noisy,
            _FOR_IMAGE,
            *for_image_noisy.stages,
            _FIRST,
        ),
    }


REMEDIES: Final = _by_column()
