"""The loss tile by tile is the loss, whatever the tiles; images may lie in files, and none is copied whole."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.lib.format import open_memmap

from loi_core import LogTone, LOIObjective, NonFiniteImageError, ScaleSpace, TiledLOIObjective
from loi_core.errors import ImageError, ImageTypeError, OptionError, ScaleError
from loi_core.method.tiled.coarse import is_wide, tiles_of
from loi_core.objectives.loi import ACCURACIES
from tests.helpers import Host, by_arrays
from tests.strategies import Problem, apart, problems

pytestmark = pytest.mark.filterwarnings("ignore::loi_core.objectives.RangeWarning")

NARROW = ScaleSpace((0, 1), (0, 1, 5), 0.125)
BOTH = ScaleSpace((1, 40), (2, 30, 60, 300), 0.25)
CUT = ScaleSpace.released((1, 5), (1, 5), 8, 21)
ALLOWED: Final = 2.0 * 1024 / 64  # MiB for each megapixel: 2 GiB at 8192x8192


def pair(shape: tuple[int, ...], dtype: str = "float64", seed: int = 0) -> tuple[Host, Host]:
    rng = np.random.default_rng(seed)
    return rng.uniform(0.0, 1.0, shape).astype(dtype), rng.uniform(0.2, 0.9, shape).astype(dtype)


def assert_alike(
    tiled: tuple[Host, Host], whole: tuple[Host, Host], image: Host, reference: Host, scales: ScaleSpace
) -> None:
    """Two losses and gradients are as far apart as their roundings may be."""
    loss, norm = apart(image, reference, scales)
    assert tiled[0].dtype == whole[0].dtype
    assert tiled[1].dtype == whole[1].dtype
    assert tiled[1].shape == whole[1].shape
    assert abs(float(tiled[0]) - float(whole[0])) <= loss
    assert float(np.sum(np.abs(tiled[1] - whole[1]), dtype=np.float64)) <= norm


@given(problems(), st.integers(1, 14))
def test_tiles_of_any_side_give_the_loss_and_its_gradient(problem: Problem, tile: int) -> None:
    image, reference, scales, dtype = problem
    assume(image.ndim == 3)
    image, reference = image.astype(dtype), reference.astype(dtype)
    whole = LOIObjective(reference, scales).value_and_grad(image)
    tiled = TiledLOIObjective(reference, scales, tile=tile).value_and_grad(image)
    assert_alike(tiled, whole, image, reference, scales)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("boundary", ["reflect", "zero"])
@pytest.mark.parametrize("alpha", [0.3, 1.0, 1.7, 2.5, 5.0, 15.0])
@pytest.mark.parametrize("shape", [(1, 1, 1), (2, 1, 1), (1, 2, 1), (2, 3, 2), (5, 1, 1)])
def test_images_of_a_few_pixels_are_no_exception(
    shape: tuple[int, ...], alpha: float, boundary: Any, dtype: str
) -> None:
    image, reference = pair(shape, dtype)
    scales = ScaleSpace((0, 0.4), alpha, 0.1, boundary=boundary)
    whole = LOIObjective(reference, scales).value_and_grad(image)
    assert_alike(TiledLOIObjective(reference, scales).value_and_grad(image), whole, image, reference, scales)


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("boundary", ["reflect", "zero"])
@pytest.mark.parametrize(("shape", "tile"), [((36, 61, 1), 20), ((47, 20, 1), 16)])
def test_halos_and_shared_samplings_are_exact(
    shape: tuple[int, ...], tile: int, boundary: str, dtype: str, compiled: bool
) -> None:
    image, reference = pair(shape, dtype)
    scales = ScaleSpace(BOTH.sigma, BOTH.alpha, BOTH.beta, boundary=boundary)  # type: ignore[arg-type]  # one of two
    with contextlib.nullcontext() if compiled else by_arrays():
        whole = LOIObjective(reference, scales).value_and_grad(image)
        tiled = TiledLOIObjective(reference, scales, tile=tile).value_and_grad(image)
    assert_alike(tiled, whole, image, reference, scales)


def test_scales_are_as_narrow_and_as_wide_as_these_tests_mean() -> None:
    eps = float(np.finfo(np.float32).eps)
    assert [is_wide(alpha, None, 10**6, eps) for alpha in BOTH.alpha] == [False, True, True, True]
    assert not any(is_wide(alpha, None, 10**6, eps) for alpha in NARROW.alpha)


@pytest.mark.parametrize("scales", [NARROW, BOTH, CUT], ids=["narrow", "both", "cut"])
@pytest.mark.parametrize(
    "options", [{"weights": True}, {"nan_policy": "mask"}, {"tone": LogTone(2.0)}, {"channel_axis": 0}], ids=str
)
def test_options_mean_the_same(scales: ScaleSpace, options: dict[str, Any]) -> None:
    image, reference = pair((45, 57, 2))
    image[3:7, 30:33], image[20, 20] = 1.7, -0.4
    reference[40:, 50:] = image[40:, 50:]
    if "weights" in options:
        weights = np.random.default_rng(1).uniform(0.0, 3.0, image.shape[:2])
        weights[10:20, 5:40] = 0.0
        image[12, 7], options = np.nan, {"weights": weights}
    if "nan_policy" in options:
        image[8, 9, 0], reference[30, 2:9] = np.nan, np.inf
    if "channel_axis" in options:
        image, reference = np.moveaxis(image, -1, 0), np.moveaxis(reference, -1, 0)
    value, gradient = LOIObjective(reference, scales, **options).value_and_grad(image)
    tiled, slopes = TiledLOIObjective(reference, scales, tile=16, **options).value_and_grad(image)
    eps = np.finfo(np.float64).eps
    assert tiled == pytest.approx(value, rel=1e3 * eps)
    np.testing.assert_allclose(slopes, gradient, rtol=0, atol=1e5 * eps * float(np.abs(gradient).max()))


@pytest.mark.parametrize("accuracy", ["balanced", "fast"])
def test_samplings_keep_their_tolerance(accuracy: str) -> None:
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:256, :300] / 100.0
    image = np.stack([0.5 + 0.4 * np.sin(2.0 * y + x), np.hypot(y - 1.0, x - 1.0) < 0.5], axis=-1)
    reference = np.clip(image[::-1, ::-1] + 0.05 * rng.normal(size=image.shape), 0.0, 1.0)
    exact = LOIObjective(reference).value_and_grad(image)[1]
    objective = TiledLOIObjective(reference, accuracy=accuracy, tile=100)
    gradient = objective.value_and_grad(image)[1]
    error = float(np.linalg.norm(gradient - exact) / np.linalg.norm(exact))
    assert error <= ACCURACIES[accuracy]


def test_equal_images_cost_nothing() -> None:
    image, _ = pair((40, 50, 2))
    value, gradient = TiledLOIObjective(image, BOTH, tile=16).value_and_grad(image.copy())
    assert value == 0.0
    assert not np.any(gradient)


def test_terms_sum_to_the_value() -> None:
    image, reference = pair((40, 50, 2))
    objective = TiledLOIObjective(reference, BOTH, tile=16)
    terms = objective.terms(image)
    assert set(terms) == set(BOTH.keys)
    assert float(sum(terms.values())) == pytest.approx(float(objective.value(image)))


@pytest.mark.parametrize("kind", ["float32", "uint8", "uint16"])
def test_files_are_read_and_written_in_place(kind: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    shape = 40, 50, 3
    whole: list[Host] = []
    for name in ("image", "reference"):
        values = rng.uniform(0.0, 1.0, shape)
        stored = values.astype(kind) if kind == "float32" else (values * np.iinfo(kind).max).astype(kind)
        np.save(tmp_path / f"{name}.npy", stored)
        whole.append(stored.astype(np.float32) / np.float32(1.0 if kind == "float32" else np.iinfo(kind).max))
    image, reference = (np.load(tmp_path / f"{name}.npy", mmap_mode="r") for name in ("image", "reference"))
    out = open_memmap(tmp_path / "gradient.npy", "w+", np.float32, shape)
    objective = TiledLOIObjective(reference, NARROW, tile=32)
    assert np.shares_memory(objective.reference, reference)
    value, gradient = objective.value_and_grad(image, out=out)
    assert gradient is out
    out.flush()
    wanted = LOIObjective(whole[1], NARROW).value_and_grad(whole[0])
    written = np.load(tmp_path / "gradient.npy")
    assert_alike((value, written), wanted, whole[0], whole[1], NARROW)


@pytest.mark.parametrize("tile", [0, -3, 2.5, "8", None, True])
def test_a_tile_is_a_whole_number_of_pixels(tile: Any) -> None:
    with pytest.raises(OptionError, match="`tile` must be a whole number of pixels, 1 or more, got"):
        TiledLOIObjective(pair((8, 8, 1))[0], tile=tile)


def test_what_does_not_fit_is_refused() -> None:
    image, reference = pair((8, 9, 1))
    objective = TiledLOIObjective(reference, NARROW)
    with pytest.raises(ImageError, match="does not fit the reference's shape"):
        objective.value(image[:, :8])
    with pytest.raises(ImageError, match="large images come one at a time"):
        TiledLOIObjective(reference[None], NARROW)
    with pytest.raises(ImageTypeError, match="divide 8-bit images by 255"):
        objective.value(np.zeros((8, 9, 1), np.int16))
    with pytest.raises(ScaleError, match="must be a ScaleSpace"):
        TiledLOIObjective(reference, 3.0)  # type: ignore[arg-type]
    for out in (np.zeros((8, 9)), np.zeros((8, 9, 1), np.float32), np.broadcast_to(np.zeros(1), (8, 9, 1))):
        with pytest.raises(ImageError, match="`out` must be of shape"):
            objective.value_and_grad(image, out=out)
    for weights, why in ((np.ones(3), "shape"), (-np.ones((8, 9)), "not negative"), (np.zeros((8, 9)), "all be 0")):
        with pytest.raises(ImageError, match=why):
            TiledLOIObjective(reference, NARROW, weights=weights)


def test_the_first_value_that_is_not_finite_is_named_by_its_place_in_the_image() -> None:
    image, reference = pair((30, 40, 2))
    image[20, 33, 1], image[25, 35, 0] = np.nan, np.inf
    with pytest.raises(NonFiniteImageError, match=r"2 non-finite values of 2400 .* = \(20, 33, 1\)"):
        TiledLOIObjective(reference, NARROW, tile=16).value(image)


@given(st.integers(1, 40), st.integers(1, 40), st.integers(1, 50))
def test_tiles_cover_every_pixel_once(height: int, width: int, side: int) -> None:
    seen = np.zeros((height, width), int)
    for tile in tiles_of(height, width, side):
        tile.crop(seen)[...] += 1
        assert max(tile.shape) <= side
    assert np.all(seen == 1)


@pytest.mark.skipif(sys.platform != "linux", reason="Linux tells how much memory a process has had")
def test_memory_above_the_image_is_in_proportion_to_its_pixels() -> None:
    pytest.importorskip("numba")
    side = 1536
    arguments = ["--sizes", str(side), "--tile", "256", "--one"]
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.large", *arguments], capture_output=True, text=True, check=True
    )
    found = json.loads(done.stdout)
    assert found["MiB above the image"] <= ALLOWED * side**2 / 2**20
    assert (
        found["MiB above the image"] >= 2 * 12 * side**2 / 2**20
    )  # the reference and the gradient: it has been measured
