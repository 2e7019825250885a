"""What each scale of a scene's objective says of an image: its part of the value, and what it pulls at."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from loi_core.errors import LoiError
from loi_core.method.comparison import ScaleKey
from loi_core.objectives import LOIObjective
from loi_core.objectives.loi import gradients_by_scale
from loi_core.scenes.scene import Scene
from loi_core.support.arrays import Host

__all__ = ["scale_objectives", "scale_pulls", "scale_terms"]


def scale_objectives(scene: Scene, name: str) -> dict[str, LOIObjective]:
    """The objectives of this name by view, if all of them compare at scales; none otherwise."""
    found = {view: one.objectives[name] for view, one in scene.views.items()}
    loi = {view: one for view, one in found.items() if isinstance(one, LOIObjective)}
    return loi if len(loi) == len(found) else {}


def scale_terms(scene: Scene, name: str, images: Mapping[str, Host]) -> dict[ScaleKey, float]:
    """What each scale adds to an objective of a scene, the mean over views; they sum to its value.

    Parameters
    ----------
    scene : Scene
    name : str
        Of the objective.
    images : dict of arrays, shape (H, W, C)
        Of all views.

    Returns
    -------
    dict of float
        By (alpha, beta, sigma); empty if the objective has no scales, or an image has no value.
    """
    terms: dict[ScaleKey, float] = {}
    for view, objective in scale_objectives(scene, name).items():
        try:
            found = objective.terms(images[view])
        except LoiError:  # of a view that has not been rendered yet; the fit judges what it renders itself
            return {}
        for key, value in found.items():
            terms[key] = terms.get(key, 0.0) + float(value) / len(scene.views)
    return terms


def scale_pulls(scene: Scene, name: str, images: Mapping[str, Host]) -> dict[ScaleKey, Host]:
    """Where each scale alone wants an image brighter or darker: its gradient by the image, with the sign of descent.

    Parameters and keys as in :func:`scale_terms`; the values are of the shape of ``scene.strip(images)``, 0 in views
    that do not have the scale.
    """
    each: dict[ScaleKey, dict[str, Host]] = {}
    for view, objective in scale_objectives(scene, name).items():
        try:
            for key, gradient in gradients_by_scale(objective, images[view]):
                each.setdefault(key, {})[view] = -np.asarray(gradient) / len(scene.views)
        except LoiError:
            return {}
    blank = {view: np.zeros_like(image) for view, image in images.items()}
    return {key: scene.strip({**blank, **found}) for key, found in each.items()}
