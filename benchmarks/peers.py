"""Rows of ``benchmarks.speed``: the loss on every framework, other image losses, and a render for scale.

Every row starts in two steps: its inputs are placed on its device, then it is prepared, so that the memory between
excludes the inputs. A row whose library is missing raises ImportError.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, TypeAlias

# Two frameworks share a GPU here; JAX would take three quarters of it to itself.
os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")

# isort: split
import jax
import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

import loi_jax
import loi_torch
from benchmarks.convolutions import ConvLOI
from examples.paper.lib.lpips import lpips
from loi_core import LOIObjective, ScaleSpace
from loi_core.errors import WeightsError

__all__ = ["PRESETS", "RENDERED", "Call", "Image", "Row", "all_rows", "images"]

PRESETS: Final = {
    "path": ScaleSpace.paper("path"),
    "released": ScaleSpace.released((1, 5), (1, 5, 15, 45), 8, 121),
}
ACCURACIES: Final = ("exact", "balanced", "fast")
LOCAL: Final = ", a sixteenth differs"  # of the pixels, all in one corner; the others are equal to the bit
RENDERED: Final = (192, 256)  # height and width of the one render
SAMPLES: Final = 16  # per pixel
MS_SSIM_MIN_SIDE_PX: Final = 176  # the coarsest of five scales has to hold a window of 11 pixels

Image: TypeAlias = np.ndarray[tuple[int, ...], np.dtype[np.float32]]
Call: TypeAlias = Callable[[], object]
Prepare: TypeAlias = Callable[[], Call]


@dataclass(frozen=True)
class Row:
    """A timed function.

    Attributes
    ----------
    library, what : str
        Its name in the tables.
    start : callable
        From the row, image and reference, both of shape (H, W, 3), to a function that prepares one evaluation.
    preset : str
        Key of :data:`PRESETS`; empty for losses without scales.
    device : str
        "cpu" or "cuda".
    smallest : int
        Smallest accepted side in pixels.
    size : (int, int), optional
        Height and width, if only one size is timed.
    """

    library: str
    what: str
    start: Callable[[Row, Image, Image], Prepare]
    preset: str = ""
    device: str = "cpu"
    smallest: int = 32
    size: tuple[int, int] | None = None

    @property
    def names(self) -> tuple[str, str, str, str]:
        """Library, what, preset and device, which identify the row."""
        return self.library, self.what, self.preset, self.device

    @property
    def key(self) -> str:
        """The names as one word, for command lines."""
        return "|".join(self.names)


def images(height: int, width: int) -> tuple[Image, Image]:
    """Return an image and a reference, shape (H, W, 3), similar enough for a positive SSIM."""
    noise, reference = np.random.default_rng(0).uniform(size=(2, height, width, 3)).astype(np.float32)
    return 0.3 * noise + 0.7 * reference, reference


def all_rows() -> list[Row]:
    """Return every row, including rows whose library is missing."""
    rows = []
    cuda = ["cuda"] if torch.cuda.is_available() else []
    for preset in PRESETS:
        for accuracy in ACCURACIES:
            rows += [Row("torch", accuracy, _torch_loi, preset, device) for device in ["cpu", *cuda]]
            rows += [Row("numpy", accuracy, _numpy_loi, preset)]
            rows += [Row("jax", accuracy, _jax_loi, preset, device) for device in _jax_devices()]
        rows += [
            Row("torch", f"balanced{LOCAL}", _torch_loi, preset),
            Row("numpy", f"balanced{LOCAL}", _numpy_loi, preset),
        ]
        rows += [Row("torch", "plain conv2d", _conv_loi, preset, device) for device in ["cpu", *cuda]]
    for device in ["cpu", *cuda]:
        rows += [
            Row("pytorch-msssim", "MS-SSIM", _msssim, device=device, smallest=MS_SSIM_MIN_SIDE_PX),
            Row("torchmetrics", "MS-SSIM", _torchmetrics, device=device, smallest=MS_SSIM_MIN_SIDE_PX),
            Row("kornia", "MS-SSIM", _kornia_msssim, device=device),
            Row("kornia", "pyramid, L2", _kornia_pyramid, device=device, smallest=64),
            Row("lpips", "LPIPS, AlexNet", _lpips, device=device),
        ]
    rows += [Row("mitsuba", f"render and backward, {SAMPLES} spp", _mitsuba, size=RENDERED)]
    return rows


def _jax_devices() -> list[str]:
    try:
        return ["cpu", "cuda"] if jax.devices("gpu") else ["cpu"]
    except RuntimeError:  # raised by JAX without a GPU
        return ["cpu"]


def _torch_step(leaf: Tensor, loss: Callable[[Tensor], Tensor]) -> Call:
    """Loss and gradient through autograd, waited for."""

    def step() -> None:
        leaf.grad = None
        loss(leaf).backward()  # type: ignore[no-untyped-call]  # untyped in torch
        if leaf.is_cuda:
            torch.cuda.synchronize()

    return step


def _inputs_of(row: Row, image: Image, reference: Image) -> tuple[Image, str]:
    """The image and the accuracy of a row."""
    accuracy, local, _ = row.what.partition(LOCAL)
    if local:
        inside = tuple(slice(size // 4) for size in image.shape[:2])
        changed, image = image, reference.copy()
        image[inside] = changed[inside]
    return image, accuracy


def _torch_loi(row: Row, image: Image, reference: Image) -> Prepare:
    image, accuracy = _inputs_of(row, image, reference)
    leaf = torch.tensor(image, device=row.device, requires_grad=True)
    target = torch.tensor(reference, device=row.device)
    loss = loi_torch.LOILoss(PRESETS[row.preset], accuracy)
    return lambda: _torch_step(leaf, lambda current: loss(current, target))


def _numpy_loi(row: Row, image: Image, reference: Image) -> Prepare:
    image, accuracy = _inputs_of(row, image, reference)

    def prepare() -> Call:
        objective = LOIObjective(reference, PRESETS[row.preset], accuracy)
        return lambda: objective.value_and_grad(image)

    return prepare


def _jax_loi(row: Row, image: Image, reference: Image) -> Prepare:
    device = jax.devices("gpu" if row.device == "cuda" else "cpu")[0]
    array, target = jax.device_put((image, reference), device)
    wait: Any = jax.block_until_ready

    def prepare() -> Call:
        loss = partial(loi_jax.loi_loss, scales=PRESETS[row.preset], accuracy=row.what)
        compiled = jax.jit(jax.value_and_grad(loss))
        return lambda: wait(compiled(array, target))

    return prepare


def _channels_first(row: Row, image: Image, reference: Image) -> tuple[Tensor, Tensor]:
    """Return image, with gradient, and reference in the layout of torch's libraries, (1, 3, H, W)."""
    leaf, target = (
        torch.tensor(np.ascontiguousarray(np.moveaxis(array, -1, 0))[None], device=row.device)
        for array in (image, reference)
    )
    return leaf.requires_grad_(), target


def _against(row: Row, image: Image, reference: Image, loss: Callable[[Tensor, Tensor], Tensor]) -> Prepare:
    leaf, target = _channels_first(row, image, reference)
    return lambda: _torch_step(leaf, lambda current: loss(current, target))


def _msssim(row: Row, image: Image, reference: Image) -> Prepare:
    from pytorch_msssim import ms_ssim

    return _against(row, image, reference, lambda x, y: 1.0 - ms_ssim(x, y, data_range=1.0))


def _torchmetrics(row: Row, image: Image, reference: Image) -> Prepare:
    from torchmetrics.functional.image import multiscale_structural_similarity_index_measure as ms_ssim

    return _against(row, image, reference, lambda x, y: 1.0 - ms_ssim(x, y, data_range=1.0))


def _kornia_msssim(row: Row, image: Image, reference: Image) -> Prepare:
    from kornia.losses import MS_SSIMLoss

    return _against(row, image, reference, MS_SSIMLoss().to(row.device))


def _kornia_pyramid(row: Row, image: Image, reference: Image) -> Prepare:
    from kornia.geometry.transform import build_pyramid

    levels = int(math.log2(min(image.shape[:2]))) - 3  # down to a shorter side of 8 to 16 pixels

    def loss(x: Tensor, y: Tensor) -> Tensor:
        pairs = zip(build_pyramid(x, levels), build_pyramid(y, levels), strict=True)
        return torch.stack([functional.mse_loss(a, b) for a, b in pairs]).sum()

    return _against(row, image, reference, loss)


def _lpips(row: Row, image: Image, reference: Image) -> Prepare:
    leaf = torch.tensor(image, device=row.device)
    try:
        lpips(reference)  # raises if the weights are missing
    except WeightsError as error:
        raise ImportError(str(error)) from error

    def prepare() -> Call:
        objective = lpips(reference)

        def step() -> None:
            objective.value_and_grad(leaf)
            if leaf.is_cuda:
                torch.cuda.synchronize()

        return step

    return prepare


def _conv_loi(row: Row, image: Image, reference: Image) -> Prepare:
    leaf = torch.tensor(image, device=row.device, requires_grad=True)
    target = torch.tensor(reference, device=row.device)
    return lambda: _torch_step(leaf, ConvLOI(target, PRESETS[row.preset]))


def _mitsuba(row: Row, image: Image, reference: Image) -> Prepare:  # noqa: ARG001  # a render starts from no image
    import loi_mitsuba  # before mitsuba, so that Dr.Jit gets an LLVM that works

    # isort: split
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    mi.set_log_level(mi.LogLevel.Error)  # a warning would appear within the tables
    height, width, _ = image.shape
    transform = mi.ScalarTransform4f
    scene = {
        "type": "scene",
        "sensor": {
            "type": "perspective",
            "fov": 45,
            "to_world": transform().look_at([0, 6, 6], [0, 0, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"}},
        },
        "floor": {"type": "rectangle", "to_world": transform().rotate([1, 0, 0], -90).scale(8)},
        "ball": {"type": "sphere", "to_world": transform().translate([0, 5, 0]).scale(0.4)},  # above the view
        "light": {
            "type": "sphere",
            "to_world": transform().translate([0, 12, 0]).scale(0.7),
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 100.0}},
        },
    }

    def prepare() -> Call:
        integrator = {"type": "direct_projective", "guiding": "none", "sppp": 0}  # the ball is out of view
        handles = {"place": loi_mitsuba.Translate("ball")}
        renderer = loi_mitsuba.MitsubaRenderer(scene, handles, integrator=integrator, spp=SAMPLES)
        return lambda: renderer.render_vjp(renderer.parameters())[1](image)

    return prepare
