"""Properties for all images and scales: symmetry, invariances, the triangle inequality, and growth with distance.

Both sides of an equation are computed, so they differ by rounding, as two libraries do. The bounds are the same as
between two backends.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from loi_core import LOIObjective, ScaleSpace
from loi_core.renderers import Disks
from tests.helpers import Host
from tests.strategies import Problem, max_differences, problems

# Problems are drawn with values beyond the bounds as well.
pytestmark = pytest.mark.filterwarnings("ignore::loi_core.objectives.RangeWarning")

TRANSFORMS: Final[dict[str, Callable[[Host], Host]]] = {
    "batch axis": lambda image: image[None],
    "rows reversed": lambda image: image[..., ::-1, :, :],
    "columns reversed": lambda image: image[..., ::-1, :],
    "channels reversed": lambda image: image[..., ::-1],
    "rows as columns": lambda image: np.swapaxes(image, -3, -2),
}

ROUNDINGS: Final = 32.0
"""Error of a blurred difference of two CDFs, in units of eps times its total, while axes have few pixels."""

FLATNESS: Final = 5e-9
"""Relative error of the sum over levels against the integral, and so of the distance of two pixels against a line."""


def typed(problem: Problem) -> tuple[Host, Host, ScaleSpace]:
    image, reference, scales, dtype = problem
    return image.astype(dtype), reference.astype(dtype), scales


def distance(image: Host, reference: Host, scales: ScaleSpace) -> float:
    return float(LOIObjective(reference, scales).value(image))


@given(problems())
def test_the_loss_is_symmetric_in_its_two_images(problem: Problem) -> None:
    image, reference, scales = typed(problem)
    forward, backward = distance(image, reference, scales), distance(reference, image, scales)
    assert abs(forward - backward) <= max_differences(image, reference, scales)[0]


@given(problems(), st.lists(st.sampled_from(list(TRANSFORMS)), min_size=1, max_size=3))
def test_the_gradient_is_equivariant_under_flips_transposes_and_channel_order(
    problem: Problem, names: list[str]
) -> None:
    image, reference, scales = typed(problem)
    value, gradient = LOIObjective(reference, scales).value_and_grad(image)
    moved, goal, expected = image, reference, gradient
    for name in names:
        moved, goal, expected = (TRANSFORMS[name](array) for array in (moved, goal, expected))
    moved_value, slopes = LOIObjective(goal, scales).value_and_grad(moved)
    loss_bound, gradient_bound = max_differences(image, reference, scales)
    assert abs(float(moved_value) - float(value)) <= loss_bound
    assert float(np.abs(slopes - expected).sum()) <= gradient_bound


@given(problems())
def test_terms_sum_to_the_value_with_and_without_the_gradient(problem: Problem) -> None:
    image, reference, scales = typed(problem)
    objective = LOIObjective(reference, scales)
    terms = objective.terms(image)
    assert list(terms) == scales.keys
    value, bound = float(objective.value(image)), max_differences(image, reference, scales)[0]
    assert abs(sum(map(float, terms.values())) - value) <= bound
    assert abs(float(objective.value_and_grad(image)[0]) - value) <= bound


@given(problems(), st.floats(1e-3, 1e3))
def test_scaling_intensities_bounds_and_beta_scales_the_loss_and_keeps_the_gradient(
    problem: Problem, factor: float
) -> None:
    image, reference, scales = typed(problem)
    assume(scales.convention != "released")  # its levels always cover [0, 1]
    value, gradient = LOIObjective(reference, scales).value_and_grad(image)
    low, high = scales.bounds
    beta = [factor * beta for beta in scales.beta]
    multiplied = ScaleSpace(
        scales.sigma, scales.alpha, beta, (factor * low, factor * high), scales.boundary, centred=scales.centred
    )
    brighter, goal = (np.asarray(factor * array, dtype=image.dtype) for array in (image, reference))
    scaled, slopes = LOIObjective(goal, multiplied).value_and_grad(brighter)
    # The products are rounded, which shifts an intensity by half an eps of the greater bound.
    loss_bound, gradient_bound = max_differences(image, reference, scales, 0.5 * max(map(abs, scales.bounds)))
    assert abs(float(scaled) - factor * float(value)) <= factor * loss_bound
    assert float(np.abs(slopes - gradient).sum()) <= gradient_bound


@given(problems(), st.integers(0, 2**31), st.sampled_from([1.0, 2.0, 3.0]))
def test_the_triangle_inequality_holds_for_p_of_1_and_more(problem: Problem, seed: int, p: float) -> None:
    # |x|^(1/p) is concave for x > 0 if p >= 1, hence subadditive.
    image, reference, scales = typed(problem)
    if scales.convention == "paper":
        scales = ScaleSpace(scales.sigma, scales.alpha, scales.beta, scales.bounds, scales.boundary, p=p)
    between = np.asarray(np.random.default_rng(seed).uniform(-0.5, 1.5, image.shape), dtype=image.dtype)
    direct = distance(image, reference, scales)
    detour = distance(image, between, scales) + distance(between, reference, scales)
    eps = float(np.finfo(image.dtype).eps)
    slack = 0.0
    for _, beta, _ in scales.keys:
        # A rounding of r in a difference of CDFs is one of up to r^(1/p) in its root; there are three distances.
        rounding = (ROUNDINGS * eps * scales.mass(beta) / scales.spacing(beta)) ** (1.0 / scales.p)
        slack += 3.0 * rounding * scales.level_count(beta) * scales.level_weight(beta) * scales.scale_weight
    assert direct <= detour + slack


@given(problems(), st.integers(0, 2**31))
def test_an_extent_of_three_image_sides_ignores_the_order_of_pixels(problem: Problem, seed: int) -> None:
    # With reflection, an axis of n pixels has the period 2 n. A Gaussian of alpha = 3 n with this period differs from a
    # constant by 2 exp(-(3 pi)^2 / 2) = 1e-19.
    image, reference, scales = typed(problem)
    wide = ScaleSpace(0, 3 * max(image.shape[-3:-1]), scales.beta, scales.bounds)
    pixels = image.reshape(*image.shape[:-3], -1, image.shape[-1])
    shuffled = np.random.default_rng(seed).permutation(pixels, axis=-2).reshape(image.shape)
    ordered, permuted = (distance(array, reference, wide) for array in (image, shuffled))
    assert abs(ordered - permuted) <= max_differences(image, reference, wide)[0]


@dataclass(frozen=True)
class Journey:
    """A blob on a flat ground that moves along its row, pixel by pixel, away from the column of an equal blob."""

    height: int
    width: int
    shape: Host
    low: float
    high: float
    goal: tuple[int, int]
    row: int
    columns: range

    def picture(self, row: int, column: int) -> Host:
        image = np.full((self.height, self.width, 1), self.low)
        height, width = self.shape.shape
        image[row : row + height, column : column + width, 0] += (self.high - self.low) * self.shape
        return image

    def values(self, scales: ScaleSpace) -> Host:
        objective = LOIObjective(self.picture(*self.goal), scales)
        return np.array([float(objective.value(self.picture(self.row, column))) for column in self.columns])


def blobs(size: int) -> list[Host]:
    """Return a disk, a dome and a square of this many pixels, symmetric and falling from the centre."""
    rows, columns = np.mgrid[:size, :size] - (size - 1) / 2
    radius = np.hypot(rows, columns)
    dome = np.maximum(1 - (radius / (size / 2 + 0.5)) ** 2, 0)
    return [np.clip(size / 2 - radius, 0, 1), dome, np.ones((size, size))]


@st.composite
def journeys(draw: st.DrawFn, margin: int) -> Journey:
    """Draw a journey whose blobs stay `margin` pixels away from the frame."""
    size = draw(st.integers(1, 9))
    max_rows, max_columns = draw(st.integers(0, 20)), draw(st.integers(1, 20))  # distance of the blobs
    rows, columns = st.integers(margin, margin + max_rows), st.integers(margin, margin + max_columns)
    goal, row = (draw(rows), draw(columns)), draw(rows)
    path = draw(st.sampled_from([range(goal[1], margin + max_columns + 1), range(goal[1], margin - 1, -1)]))
    shape, level = draw(st.sampled_from(blobs(size))), st.floats(0.0, 1.0)
    span = size + 2 * margin
    return Journey(span + max_rows, span + max_columns, shape, draw(level), draw(level), goal, row, path)


def assert_never_falls(values: Host, scales: ScaleSpace) -> None:
    (beta,) = scales.beta
    rounding = ROUNDINGS * float(np.finfo(values.dtype).eps) * scales.level_count(beta) * beta
    assert np.all(np.diff(values) >= -rounding - FLATNESS * values.max())


ALPHAS = st.sampled_from([0.0, 1.0, 3.0, 8.0, 20.0, 60.0])
BETAS = st.sampled_from([0.05, 0.125, 0.4])


@given(journeys(0), ALPHAS, BETAS)
def test_the_loss_never_falls_as_a_blob_moves_away_by_whole_pixels(journey: Journey, alpha: float, beta: float) -> None:
    # Without inner blur. Reflected Gaussians along an axis are totally positive, so the loss grows with the distance.
    scales = ScaleSpace(0, alpha, beta)
    assert_never_falls(journey.values(scales), scales)


@given(st.data(), st.sampled_from([0.5, 1.0, 2.0]), ALPHAS, BETAS)
def test_the_loss_with_inner_blur_never_falls_while_the_blob_stays_inside_the_frame(
    data: st.DataObject, sigma: float, alpha: float, beta: float
) -> None:
    scales = ScaleSpace(sigma, alpha, beta)
    assert_never_falls(data.draw(journeys(math.ceil(8 * sigma))).values(scales), scales)


def test_the_loss_may_fall_at_the_frame_where_reflection_brightens_a_blurred_blob() -> None:
    # Reflection returns the light that is blurred across the edge, so the same blob has another histogram there, and a
    # difference that does not depend on the distance. Extents as wide as the image see little else.
    journey = Journey(25, 14, blobs(3)[2], 0.0, 0.7, (1, 0), 5, range(12))
    assert np.diff(journey.values(ScaleSpace(0.5, 20, 0.125))).min() < -1e-4
    assert np.all(np.diff(journey.values(ScaleSpace(0, 20, 0.125))) > 0.0)
    assert np.all(np.diff(journey.values(ScaleSpace(0.5, 8, 0.125))) > 0.0)


def test_the_loss_may_fall_between_pixels_where_an_edge_has_another_histogram() -> None:
    # A disk's edge covers other fractions of pixels at every position between them. An extent far wider than the image
    # sees only this difference; a narrower one also sees the positions.
    disks = Disks(17, 32, [[8.0, 8.0]], 4.0, [[0.8] * 3])
    params = disks.parameters()
    positions = np.arange(8.0, 24.0, 0.25)
    images = [disks.render(params | {"positions": np.array([[x, 8.0]])}) for x in positions]
    for alpha, falls in ((60, True), (8, False)):
        objective = LOIObjective(images[0], ScaleSpace(0, alpha, 0.125))
        steps = np.diff([float(objective.value(image)) for image in images])
        assert (steps.min() < 0.0) == falls
        assert np.all(np.diff([float(objective.value(image)) for image in images[::4]]) > 0.0)
