"""What holds for all images and scales: symmetry, invariances, order, and how the loss grows.

Both sides of an equation are computed, so they differ by rounding, as two libraries do: bounds are those that backends
are held to.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from loi_core import LOIObjective, ScaleSpace
from loi_core.renderers import Disks
from tests.helpers import Host
from tests.strategies import Problem, apart, problems

# Problems are drawn with values beyond the bounds as well.
pytestmark = pytest.mark.filterwarnings("ignore::loi_core.objectives.RangeWarning")

MOVES: Final[dict[str, Callable[[Host], Host]]] = {
    "batch axis": lambda image: image[None],
    "rows reversed": lambda image: image[..., ::-1, :, :],
    "columns reversed": lambda image: image[..., ::-1, :],
    "channels reversed": lambda image: image[..., ::-1],
    "rows as columns": lambda image: np.swapaxes(image, -3, -2),
}

ROUNDINGS: Final = 32.0
"""By how many eps of its total a difference of two CDFs is off, blurred, as long as axes have few pixels."""

FLATNESS: Final = 5e-9
"""How far a sum over levels is from the integral, as a share of it; so far two pixels' distance is from linear."""


def typed(problem: Problem) -> tuple[Host, Host, ScaleSpace]:
    image, reference, scales, dtype = problem
    return image.astype(dtype), reference.astype(dtype), scales


def distance(image: Host, reference: Host, scales: ScaleSpace) -> float:
    return float(LOIObjective(reference, scales).value(image))


@given(problems())
def test_the_two_images_may_change_places(problem: Problem) -> None:
    image, reference, scales = typed(problem)
    there, back = distance(image, reference, scales), distance(reference, image, scales)
    assert abs(there - back) <= apart(image, reference, scales)[0]


@given(problems(), st.lists(st.sampled_from(list(MOVES)), min_size=1, max_size=3))
def test_the_gradient_moves_along_with_flips_transposes_channel_order_and_a_batch_axis(
    problem: Problem, names: list[str]
) -> None:
    image, reference, scales = typed(problem)
    value, gradient = LOIObjective(reference, scales).value_and_grad(image)
    moved, goal, expected = image, reference, gradient
    for name in names:
        moved, goal, expected = (MOVES[name](one) for one in (moved, goal, expected))
    other, slopes = LOIObjective(goal, scales).value_and_grad(moved)
    loss_bound, gradient_bound = apart(image, reference, scales)
    assert abs(float(other) - float(value)) <= loss_bound
    assert float(np.abs(slopes - expected).sum()) <= gradient_bound


@given(problems())
def test_terms_sum_to_the_value_with_and_without_the_gradient(problem: Problem) -> None:
    image, reference, scales = typed(problem)
    objective = LOIObjective(reference, scales)
    terms = objective.terms(image)
    assert list(terms) == scales.keys
    value, bound = float(objective.value(image)), apart(image, reference, scales)[0]
    assert abs(sum(map(float, terms.values())) - value) <= bound
    assert abs(float(objective.value_and_grad(image)[0]) - value) <= bound


@given(problems(), st.floats(1e-3, 1e3))
def test_if_intensities_bounds_and_beta_are_multiplied_so_is_the_loss_and_the_gradient_stays(
    problem: Problem, factor: float
) -> None:
    image, reference, scales = typed(problem)
    if scales.convention == "released":
        return  # its levels are those of [0, 1]
    value, gradient = LOIObjective(reference, scales).value_and_grad(image)
    low, high = scales.bounds
    beta = [factor * one for one in scales.beta]
    multiplied = ScaleSpace(scales.sigma, scales.alpha, beta, (factor * low, factor * high), scales.boundary)
    brighter, goal = (np.asarray(factor * one, dtype=image.dtype) for one in (image, reference))
    other, slopes = LOIObjective(goal, multiplied).value_and_grad(brighter)
    # The products are rounded, which shifts an intensity by half an eps of the greater bound.
    loss_bound, gradient_bound = apart(image, reference, scales, 0.5 * max(map(abs, scales.bounds)))
    assert abs(float(other) - factor * float(value)) <= factor * loss_bound
    assert float(np.abs(slopes - gradient).sum()) <= gradient_bound


@given(problems(), st.integers(0, 2**31), st.sampled_from([1.0, 2.0, 3.0]))
def test_for_p_of_1_and_more_a_detour_is_never_shorter(problem: Problem, seed: int, p: float) -> None:
    # |x|^(1/p) is concave for x > 0 if p >= 1, and with that subadditive.
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
def test_an_extent_of_three_sides_forgets_where_pixels_are(problem: Problem, seed: int) -> None:
    # Mirrored at its ends, an axis of n pixels is one of period 2 n, on which a Gaussian of alpha = 3 n differs from a
    # constant by 2 exp(-(3 pi)^2 / 2) = 1e-19.
    image, reference, scales = typed(problem)
    wide = ScaleSpace(0, 3 * max(image.shape[-3:-1]), scales.beta, scales.bounds)
    pixels = image.reshape(*image.shape[:-3], -1, image.shape[-1])
    shuffled = np.random.default_rng(seed).permutation(pixels, axis=-2).reshape(image.shape)
    there, again = (distance(one, reference, wide) for one in (image, shuffled))
    assert abs(there - again) <= apart(image, reference, wide)[0]


@dataclass(frozen=True)
class Journey:
    """A blob on a flat ground that moves along its row, pixel by pixel, away from the column of another of its kind."""

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
        return np.array([float(objective.value(self.picture(self.row, one))) for one in self.columns])


def blobs(size: int) -> list[Host]:
    """Disk, dome and square of this many pixels: each row and column is symmetric and falls from its middle."""
    rows, columns = np.mgrid[:size, :size] - (size - 1) / 2
    away = np.hypot(rows, columns)
    return [np.clip(size / 2 - away, 0, 1), np.maximum(1 - (away / (size / 2 + 0.5)) ** 2, 0), np.ones((size, size))]


@st.composite
def journeys(draw: st.DrawFn, margin: int) -> Journey:
    """Both blobs stay `margin` pixels off the frame."""
    size = draw(st.integers(1, 9))
    room, across = draw(st.integers(0, 20)), draw(st.integers(1, 20))  # how far they may be apart
    rows, columns = st.integers(margin, margin + room), st.integers(margin, margin + across)
    goal, row = (draw(rows), draw(columns)), draw(rows)
    way = draw(st.sampled_from([range(goal[1], margin + across + 1), range(goal[1], margin - 1, -1)]))
    shape, level = draw(st.sampled_from(blobs(size))), st.floats(0.0, 1.0)
    span = size + 2 * margin
    return Journey(span + room, span + across, shape, draw(level), draw(level), goal, row, way)


def assert_never_falls(values: Host, scales: ScaleSpace) -> None:
    (beta,) = scales.beta
    rounding = ROUNDINGS * float(np.finfo(values.dtype).eps) * scales.level_count(beta) * beta
    assert np.all(np.diff(values) >= -rounding - FLATNESS * values.max())


ALPHAS = st.sampled_from([0.0, 1.0, 3.0, 8.0, 20.0, 60.0])
BETAS = st.sampled_from([0.05, 0.125, 0.4])


@given(journeys(0), ALPHAS, BETAS)
def test_without_inner_blur_the_loss_never_falls_as_a_blob_moves_off_by_whole_pixels_in_a_reflecting_frame(
    journey: Journey, alpha: float, beta: float
) -> None:
    # Mirrored Gaussians along an axis are totally positive, so the distance of two places grows with their distance.
    scales = ScaleSpace(0, alpha, beta)
    assert_never_falls(journey.values(scales), scales)


@given(st.data(), st.sampled_from([0.5, 1.0, 2.0]), ALPHAS, BETAS)
def test_nor_does_it_with_inner_blur_while_the_blurred_blob_stays_inside_the_frame(
    data: st.DataObject, sigma: float, alpha: float, beta: float
) -> None:
    scales = ScaleSpace(sigma, alpha, beta)
    assert_never_falls(data.draw(journeys(math.ceil(8 * sigma))).values(scales), scales)


def test_beside_the_frame_an_inner_blur_makes_a_blob_brighter_and_the_loss_may_fall() -> None:
    # What is blurred across the edge comes back: the same blob has another histogram there, and that is a difference
    # which does not depend on the distance. Extents as wide as the image see little else.
    journey = Journey(25, 14, blobs(3)[2], 0.0, 0.7, (1, 0), 5, range(12))
    assert np.diff(journey.values(ScaleSpace(0.5, 20, 0.125))).min() < -1e-4
    assert np.all(np.diff(journey.values(ScaleSpace(0, 20, 0.125))) > 0.0)
    assert np.all(np.diff(journey.values(ScaleSpace(0.5, 8, 0.125))) > 0.0)


def test_between_pixels_a_blob_s_edge_has_another_histogram_and_the_loss_may_fall() -> None:
    # A disk's edge covers other shares of pixels at every place between them. Under an extent far wider than the image
    # that is all there is to see; under one that tells places apart, it is not.
    disks = Disks(17, 32, [[8.0, 8.0]], 4.0, [[0.8] * 3])
    params = disks.parameters()
    places = np.arange(8.0, 24.0, 0.25)
    images = [disks.render(params | {"positions": np.array([[x, 8.0]])}) for x in places]
    for alpha, falls in ((60, True), (8, False)):
        objective = LOIObjective(images[0], ScaleSpace(0, alpha, 0.125))
        steps = np.diff([float(objective.value(one)) for one in images])
        assert (steps.min() < 0.0) == falls
        assert np.all(np.diff([float(objective.value(one)) for one in images[::4]]) > 0.0)
