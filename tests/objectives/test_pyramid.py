"""The Gaussian pyramid equals a pyramid of SciPy's filters, and is close to one of five binomial taps."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from loi_core import GaussianPyramid
from loi_core.errors import OptionError
from tests.contents import CONTENTS
from tests.frameworks import kornia, torch
from tests.helpers import Host

SIZES = [(64, 48), (57, 90)]  # even, odd at several levels
SCIPY_RTOL = 1e-10  # a Gaussian that is cut at nine deviations, in float64


def scipy_levels(image: Host, count: int) -> list[Host]:
    levels = [image]
    for _ in range(count - 1):
        levels.append(gaussian_filter(levels[-1], (1.0, 1.0, 0.0), mode="reflect", truncate=9.0)[::2, ::2])
    return levels


def kornia_levels(image: Host, count: int) -> list[Host]:
    levels = [torch.tensor(np.moveaxis(image, -1, 0)[None].copy())]
    binomial = torch.tensor([[1.0, 4.0, 6.0, 4.0, 1.0]], dtype=torch.float64) / 16.0
    for _ in range(count - 1):
        blurred = kornia.filters.filter2d_separable(levels[-1], binomial, binomial, border_type="reflect")
        levels.append(blurred[..., ::2, ::2])
    return [np.moveaxis(level[0].numpy(), 0, -1) for level in levels]


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("content", ["shifted", "photographs", "random"])
def test_pyramid_terms_are_mean_squares_between_the_levels_of_scipy(size: tuple[int, int], content: str) -> None:
    image, reference = CONTENTS[content]((*size, 3), np.random.default_rng(1))
    terms = GaussianPyramid(reference).terms(image)
    pairs = zip(scipy_levels(image, len(terms)), scipy_levels(reference, len(terms)), strict=True)
    expected = [float(np.mean((first - second) ** 2)) for first, second in pairs]
    assert [float(term) for term in terms.values()] == pytest.approx(expected, rel=SCIPY_RTOL)


@pytest.mark.parametrize("content", ["shifted", "photographs"])
def test_a_pyramid_of_five_binomial_taps_has_similar_terms(content: str) -> None:
    # The taps of Burt and Adelson, (1, 4, 6, 4, 1) / 16, have the same deviation, one pixel, but other tails. All
    # differences are 32 pixels, seven deviations of the fourth level, away from the borders, whose padding differs.
    inside = np.pad(np.ones((64, 64, 3)), ((32, 32), (32, 32), (0, 0)))
    image, reference = (inside * array for array in CONTENTS[content]((128, 128, 3), np.random.default_rng(2)))
    terms = GaussianPyramid(reference, 4).terms(image)
    pairs = zip(kornia_levels(image, 4), kornia_levels(reference, 4), strict=True)
    expected = [float(np.mean((first - second) ** 2)) for first, second in pairs]
    assert [float(term) for term in terms.values()] == pytest.approx(expected, rel=0.03)  # 0.02 measured


def test_the_coarsest_pyramid_level_has_two_pixels_by_default() -> None:
    for shape, levels in (((2, 9, 1), 1), ((4, 9, 1), 2), ((1, 9, 1), 1), ((63, 64, 1), 5), ((64, 64, 1), 6)):
        assert len(GaussianPyramid(np.zeros(shape)).terms(np.ones(shape))) == levels
        with pytest.raises(OptionError, match=f"from 1 to {levels} "):
            GaussianPyramid(np.zeros(shape), levels + 1)
