"""Remedies for the harder columns, one change at a time."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from examples.paper.table1.ablations import ABLATIONS
from examples.paper.table1.problem import HARDER, Column
from examples.paper.table1.settings import OURS, Setting

__all__ = ["CHECKED", "REMEDIES"]

_LOI: Final = OURS["loi"]
_ABLATED: Final = {setting.name: setting for setting in ABLATIONS}
_FOR_IMAGE: Final = _ABLATED["for_image"]
_WIDE_FIRST: Final = _ABLATED["wide extents first"]
_EVERY_SCALE_FIRST: Final = _ABLATED["every scale first"]

_LARGE, _RANDOM, _UNPARTED, _NOISY = HARDER


def _then_pixels(setting: Setting, noise: float) -> Setting:
    """Return `setting` with noise on the render, whose last 100 steps minimise pixel L2 without noise.

    The noisy stage returns its last iterate, since the smallest loss belongs to the luckiest noise rather than to the
    best iterate. Pixel L2 suffices at the end: by then every disk overlaps its target.
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
            _LOI,
            _FOR_IMAGE,
            replace(_LOI, name="no extent of 1", scales="wide"),
            _WIDE_FIRST,
            _EVERY_SCALE_FIRST,
        ),
        _RANDOM: (
            _LOI,
            paper,
            replace(paper, name="the paper's, 13 sums of channels", channels="sums"),
            replace(_LOI, name="twice the rate", rate=2.0 * _LOI.rate),
            _WIDE_FIRST,
        ),
        _UNPARTED: (
            _LOI,
            replace(_LOI, name="both orders", both_orders=True),
            _FOR_IMAGE,
            replace(_FOR_IMAGE, name="for_image, both orders", both_orders=True),
            _ABLATED["no extent of 1"],
            _ABLATED["p 2 (roots)"],
            _WIDE_FIRST,
            _EVERY_SCALE_FIRST,
        ),
        _NOISY: (
            _LOI,
            every_noisy,
            _FOR_IMAGE,
            *for_image_noisy.stages,
            _WIDE_FIRST,
            _then_pixels(_WIDE_FIRST, _NOISY.noise),
        ),
    }


REMEDIES: Final = _by_column()
# The remedies that succeed from the first starts run from all starts.
CHECKED: Final = frozenset({(_UNPARTED, _WIDE_FIRST), (_UNPARTED, _EVERY_SCALE_FIRST)})
