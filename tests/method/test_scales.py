"""A ScaleSpace describes the compared scales and rejects invalid values by name."""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from loi_core import LOIObjective, ScaleSpace, loi_loss
from loi_core.errors import LoiError, ScaleError
from loi_core.objectives import RangeWarning


def test_presets_are_those_of_the_paper() -> None:
    vector, path, raster = (ScaleSpace.paper(name) for name in ("vector", "path", "raster"))
    assert (vector.alpha, vector.sigma, vector.beta) == ((1, 5, 15), (1, 5, 15, 45), (0.125,))
    assert (path.alpha, path.sigma, path.beta) == ((1, 5, 15, 45), (1, 5), (0.125,))
    assert (raster.alpha, raster.sigma, raster.beta) == ((1, 5, 15, 45), (0, 5), (0.03125,))
    assert {scales.boundary for scales in (vector, path, raster)} == {"reflect"}


@given(st.floats(1e-3, 5.0), st.floats(-3.0, 3.0), st.floats(0.1, 5.0))
def test_levels_are_spaced_by_beta_and_cover_the_bounds_with_tails(beta: float, low: float, width: float) -> None:
    scales = ScaleSpace(1, 1, beta, bounds=(low, low + width))
    levels = scales.levels(beta)
    assert levels.dtype == np.float64
    assert scales.spacing(beta) == beta
    np.testing.assert_allclose(np.diff(levels), beta, rtol=1e-9, atol=1e-12)
    assert levels[0] <= low - 4 * beta + 1e-8 * beta
    assert levels[-1] >= low + width + 4 * beta - 1e-8 * beta
    np.testing.assert_allclose(0.5 * (levels[0] + levels[-1]), low + 0.5 * width, atol=1e-9)


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (3, 3), (96, 128), (1080, 1920)])
def test_for_image_reaches_across_the_image(size: tuple[int, int]) -> None:
    scales = ScaleSpace.for_image(*size)
    assert max(scales.alpha) == pytest.approx(max(1.0, 0.35 * max(size)), abs=0.01)
    assert list(scales.alpha) == sorted(scales.alpha)


def test_scales_are_frozen_hashable_and_replaceable() -> None:
    scales = ScaleSpace([0, 5], np.float64(3.0), 0.25)
    assert scales == ScaleSpace((0.0, 5.0), (3.0,), (0.25,))
    assert hash(scales) == hash(ScaleSpace((0, 5), 3, 0.25))
    with pytest.raises(dataclasses.FrozenInstanceError):
        scales.sigma = (1.0,)  # type: ignore[misc]  # the point of the test
    assert dataclasses.replace(scales, boundary="zero").boundary == "zero"
    assert scales.keys == [(3.0, 0.25, 0.0), (3.0, 0.25, 5.0)]


BAD: list[tuple[str, dict[str, Any]]] = [
    ("sigma", {"sigma": -1}),
    ("sigma", {"sigma": ()}),
    ("sigma", {"sigma": "5"}),
    ("sigma", {"sigma": [1, None]}),
    ("sigma", {"sigma": (1, 1)}),
    ("sigma", {"sigma": float("nan")}),
    ("alpha", {"alpha": float("inf")}),
    ("alpha", {"alpha": True}),
    ("beta", {"beta": 0}),
    ("beta", {"beta": [0.1, -0.1]}),
    ("bounds", {"bounds": (1, 0)}),
    ("bounds", {"bounds": (0, 1, 2)}),
    ("bounds", {"bounds": 1}),
    ("bounds", {"bounds": (0, float("inf"))}),
    ("boundary", {"boundary": "mirror"}),
    ("p", {"p": 0}),
    ("tails", {"tails": -1}),
    ("convention", {"convention": "other"}),
    ("kernel_size", {"kernel_size": 5}),
    ("kernel_size", {"convention": "released", "kernel_size": 0}),
    ("beta", {"convention": "released", "kernel_size": 5, "beta": (0.1, 0.2)}),
]


@pytest.mark.parametrize(("name", "change"), BAD)
def test_every_wrong_value_is_named(name: str, change: dict[str, Any]) -> None:
    with pytest.raises(ScaleError, match=f"^`{name}` ") as caught:
        ScaleSpace(**({"sigma": 1, "alpha": 1, "beta": 0.1} | change))
    assert isinstance(caught.value, ValueError)
    assert isinstance(caught.value, LoiError)
    assert "\n" not in str(caught.value)


def test_a_beta_wider_than_the_bounds_raises_a_warning() -> None:
    image, scales = np.zeros((8, 8, 1)), ScaleSpace(1.0, 5.0, 2)
    message = r"`beta` 2 is wider than the scales' `bounds` \(0, 1\).* pass a smaller beta, such as 0\.125"
    for call in (LOIObjective, partial(loi_loss, image)):
        with pytest.warns(RangeWarning, match=message):
            call(image, scales)
    assert "compares little more than local means" in scales.describe(32, 32)
    for beta, bounds in ((2, (0, 2)), ((0.125, 2), (0, 1)), (0.3, (0.4, 0.7))):
        LOIObjective(image, ScaleSpace(1.0, 5.0, beta, bounds))  # warnings are errors


def chessboard_contrast(beta: float) -> float:
    """Return the distance of a chessboard from its mean, a grey, in units of the distance of black from that grey."""
    objective = LOIObjective(np.full((16, 16, 1), 0.5), ScaleSpace(0.0, 6.0, beta))
    chessboard = np.indices((16, 16)).sum(axis=0)[..., None] % 2.0
    return float(objective.value(chessboard) / objective.value(np.zeros((16, 16, 1))))


def test_a_beta_as_wide_as_the_bounds_hardly_distinguishes_a_pattern_from_its_mean() -> None:
    assert chessboard_contrast(0.125) > 0.8
    assert chessboard_contrast(1.0) < 0.2


def test_wrong_arguments_of_the_presets_are_named() -> None:
    with pytest.raises(ScaleError, match="`preset` must be one of 'vector', 'path', 'raster', got 'photo'"):
        ScaleSpace.paper("photo")  # type: ignore[arg-type]  # the point of the test
    with pytest.raises(ScaleError, match="`height`"):
        ScaleSpace.for_image(0, 5)
    with pytest.raises(ScaleError, match="`width`"):
        ScaleSpace.for_image(5, 2.5)  # type: ignore[arg-type]  # the point of the test
    with pytest.raises(ScaleError, match="`bins`"):
        ScaleSpace.released(1, 1, 0, 5)


def test_for_image_divides_other_bounds_into_eight_as_well() -> None:
    wide = ScaleSpace.for_image(64, 48, bounds=(-1.0, 3.0))
    assert (wide.bounds, wide.beta) == ((-1.0, 3.0), (0.5,))
    assert wide.alpha == ScaleSpace.for_image(64, 48).alpha
    assert all(
        (scales.bounds, scales.beta) == (wide.bounds, wide.beta)
        for scales in ScaleSpace.far_to_near(64, 48, bounds=wide.bounds)
    )
    with pytest.raises(ScaleError, match="`bounds`"):
        ScaleSpace.for_image(64, 48, bounds=(1.0, 0.0))


def test_the_description_of_scales_names_their_origin_and_effect() -> None:
    lines = ScaleSpace.for_image(480, 640).describe(480, 640).splitlines()
    assert lines[0].startswith("ScaleSpace.for_image(480, 640): ")
    assert [line.split()[0] for line in lines[1:]] == ["sigma", "beta", *["alpha"] * 3, "bounds", "boundary"]
    assert "an eighth of the bounds" in lines[2]
    assert "17 levels from -0.5 to 1.5" in lines[2]
    assert lines[5].startswith("alpha 224 px, 0.35 of the longer side: ")
    assert lines[5].endswith("has a gradient everywhere in the image")
    assert lines[3].endswith("has a gradient up to about 151 px away")
    assert ScaleSpace.for_image(480, 640).describe(64, 64).startswith("scales of your own, for 64 x 64 pixels")
    assert ScaleSpace.for_image(9, 9, beta=0.3, boundary="zero").describe(9, 9).startswith("ScaleSpace.for_image(9, 9)")
    assert ScaleSpace.paper("path").describe(64, 64).startswith("ScaleSpace.paper('path')")


def test_every_scale_and_every_unusual_rule_has_its_line() -> None:
    scales = ScaleSpace((0, 30), (0, 7), (0.1, 0.3), bounds=(-1.0, 2.0), boundary="zero", p=2.0)
    lines = scales.describe(40, 40).splitlines()
    for start in ("sigma 0 px", "sigma 30 px", "beta 0.1:", "beta 0.3:", "alpha 0 px", "alpha 7 px", "bounds -1 to 2"):
        assert sum(line.startswith(start) for line in lines) == 1
    assert "hardly depends on position" in ScaleSpace.paper("path").describe(40, 40).splitlines()[-3]
    assert lines[-2].startswith("boundary zero: ")
    assert lines[-1].startswith("p 2: ")
    released = ScaleSpace.released((1, 5), 15, 8, 61).describe(400, 400)
    assert released.splitlines()[-1].startswith("released: ")
    assert "has a gradient up to about 80 px away" in released
    with pytest.raises(ScaleError, match=r"^`width` must be a whole number"):
        scales.describe(4, 0)


def test_describing_scales_changes_neither_their_repr_nor_their_equality() -> None:
    scales = ScaleSpace.for_image(48, 64)
    identity = repr(scales), hash(scales)
    scales.describe(48, 64)
    assert (repr(scales), hash(scales)) == identity
    assert scales == ScaleSpace.for_image(48, 64)
