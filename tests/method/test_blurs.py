"""Blurs equal an independent implementation, conserve mass, and have exact adjoints."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from loi_core.method.blurs import gaussian_blur
from loi_core.method.gaussian import blur_matrix
from loi_core.method.scales import Boundary
from tests.strategies import THOROUGH

SIZES = st.integers(1, 40)
SCALE = st.one_of(st.just(0.0), st.floats(1e-3, 400.0))
BOUNDARIES = st.sampled_from(["reflect", "zero"])


@given(SIZES, SIZES, st.floats(0.3, 30.0), BOUNDARIES)
def test_blur_equals_scipy(height: int, width: int, scale: float, boundary: Boundary) -> None:
    image = np.random.default_rng(height).uniform(0, 1, (height, width))
    mode = {"reflect": "reflect", "zero": "constant"}[boundary]
    expected = ndimage.gaussian_filter(image, scale, mode=mode, truncate=9.0)  # type: ignore[arg-type]  # a plain str
    np.testing.assert_allclose(
        gaussian_blur(height, width, scale, boundary, like=image).apply(image), expected, rtol=0, atol=1e-13
    )


@given(SIZES, SCALE)
def test_reflection_conserves_mass_and_constants(size: int, scale: float) -> None:
    matrix = blur_matrix(size, scale, "reflect")
    np.testing.assert_allclose(matrix.sum(axis=0), 1.0, rtol=1e-13)
    np.testing.assert_allclose(matrix.sum(axis=1), 1.0, rtol=1e-13)
    assert np.all(matrix >= 0.0)


@given(SIZES, SCALE)
def test_zero_padding_never_gains_mass(size: int, scale: float) -> None:
    matrix = blur_matrix(size, scale, "zero")
    assert np.all(matrix >= 0.0)
    assert matrix.sum(axis=1).max() <= 1.0 + 1e-13


@given(SIZES, SIZES, SCALE, BOUNDARIES, st.sampled_from([None, 1, 3, 31, 121]))
def test_adjoint_is_the_transpose(height: int, width: int, scale: float, boundary: Boundary, taps: int | None) -> None:
    rng = np.random.default_rng(width)
    planes, cotangent = rng.standard_normal((2, 3, height, width))
    blur = gaussian_blur(height, width, scale, boundary, like=planes, taps=taps)
    forward, backward = np.sum(cotangent * blur.apply(planes)), np.sum(blur.adjoint(cotangent) * planes)
    assert forward == pytest.approx(backward, abs=1e-12 * planes.size)


@given(SIZES, st.floats(0.3, 3e4 if THOROUGH else 3e3), BOUNDARIES)
def test_kernels_of_any_length_fold_to_the_same_matrix(size: int, scale: float, boundary: Boundary) -> None:
    # The series for kernels wider than the axis must equal the direct sum where both exist.
    taps = 2 * int(np.ceil(9.0 * scale)) + 1
    direct = blur_matrix(size, scale, boundary, taps)
    rounding = taps * np.finfo(np.float64).eps  # of the direct sum over all taps
    np.testing.assert_allclose(blur_matrix(size, scale, boundary), direct, rtol=0, atol=rounding)


def test_a_blur_much_wider_than_the_axis_takes_the_mean() -> None:
    np.testing.assert_allclose(blur_matrix(7, 1e9, "reflect"), 1.0 / 7.0, rtol=1e-13)


def test_scale_zero_is_the_identity() -> None:
    assert blur_matrix(3, 0.0, "reflect").tolist() == np.eye(3).tolist()


@pytest.mark.parametrize("scale", [1e-300, 1e-8, 1e-3])
def test_tiny_scales_give_the_identity(scale: float) -> None:
    np.testing.assert_array_equal(blur_matrix(4, scale, "reflect"), np.eye(4))
