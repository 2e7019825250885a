"""Whether a free parameter changes the image as another exposure would, and the exposure that a fit ends with."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from loi_core.errors import OptionError
from loi_core.fitting.parameters import MAX_MOVED_NUMBERS, Bounds, free_numbers, host_values, moved_numbers
from loi_core.fitting.views import View, Views
from loi_core.objectives import ImageObjective
from loi_core.renderers.contract import Parameters
from loi_core.renderers.units import first_step
from loi_core.support.arrays import Host, to_numpy
from loi_core.support.wording import listed

__all__ = ["exposure_is_free", "require_visible"]

FREE_SHARE: Final = 0.5
"""Share of a parameter's change of the image that is a gain and an offset, from which on the parameter is a brightness.

A motion has a share near 0, the size of an object at most a fifth, the height of a lamp 0.8, and an exposure, a
background, or the colour of the only object on a plain ground a share near 1.
"""

HIDDEN_SHARE: Final = 0.98
"""The same share from which on a matched exposure hides a parameter."""


def exposure_is_free(views: Views, params: Parameters, bounds: Bounds, seed: int) -> bool:
    """Return whether any free parameter changes an image mostly as another exposure would."""
    return any(max(entry) > FREE_SHARE for entry in _shares(views, params, bounds, seed).values())


def require_visible(views: Views, params: Parameters, bounds: Bounds, seed: int) -> None:
    """Raise :class:`OptionError` if all objectives estimate an exposure that hides all free parameters."""
    objectives = [view.requested for view in views.by_name.values()]
    if any(not isinstance(entry, ImageObjective) or entry.exposure == "given" for entry in objectives):
        return
    shares = _shares(views, params, bounds, seed)
    if shares and all(min(entry) > HIDDEN_SHARE for entry in shares.values()):
        msg = (
            f"`exposure` of the objective must be 'given' to fit {listed(list(shares))}: the brightness of a whole "
            f"image has no effect under an exposure that is estimated"
        )
        raise OptionError(msg)


def _shares(views: Views, params: Parameters, bounds: Bounds, seed: int) -> dict[str, list[float]]:
    """Return the share of each free number's change of the image that is a gain and an offset of each channel.

    The height of a lamp changes the image as an exposure does, and its other coordinates do not. With several views,
    the largest share counts. Of many numbers, all of a parameter change together.
    """
    images = {name: _planes(view, params, seed) for name, view in views.by_name.items()}
    steps = {name: first_step(*host_values(params, bounds, name)) for name in bounds.lower}
    shares: dict[str, list[float]] = {}
    for moved in moved_numbers(params, bounds, steps, together=free_numbers(bounds) > MAX_MOVED_NUMBERS):
        share = max(
            _explained(_planes(view, moved.params, seed) - images[key], images[key])
            for key, view in views.by_name.items()
            if moved.name in view.names
        )
        shares.setdefault(moved.name, []).append(share)
    return shares


def _planes(view: View, params: Parameters, seed: int) -> Host:
    """Return the channels of an image as rows, shape (C, H W)."""
    image = np.asarray(to_numpy(view.render(params, seed=seed)), dtype=np.float64)
    return image.reshape(-1, image.shape[-1]).T


def _explained(change: Host, image: Host) -> float:
    """Return the share of the squared change of planes, shape (C, P), that a gain and an offset of each explain."""
    energy = float(np.sum(change**2))
    if energy == 0.0 or not math.isfinite(energy):
        return 0.0
    centred = image - np.mean(image, axis=1, keepdims=True)
    variance = np.sum(centred**2, axis=1)
    offset = np.mean(change, axis=1) ** 2 * change.shape[1]
    gain = np.where(
        variance > 0.0, np.sum(change * centred, axis=1) ** 2 / np.where(variance > 0.0, variance, 1.0), 0.0
    )
    return float(np.sum(offset + gain)) / energy
