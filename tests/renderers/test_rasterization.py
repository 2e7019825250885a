"""Fragments are the covered pixels, and painting them equals painting every disk on the whole canvas."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from loi_core.renderers import Disks
from loi_core.renderers.coverage import canvas_coverage
from loi_core.renderers.rasterization import rasterize_disks
from tests.helpers import Host


@st.composite
def scenes(draw: st.DrawFn) -> tuple[tuple[int, int], Host, Host, Host]:
    """Draw a canvas and disks; some disks are outside, empty, or larger than the canvas."""
    size = draw(st.integers(1, 24)), draw(st.integers(1, 24))
    count = draw(st.integers(0, 12))
    rng = np.random.default_rng(draw(st.integers(0, 2**31)))
    positions = rng.uniform(-6.0, 30.0, (count, 2))
    radii = rng.choice([0.0, 0.1, 0.6, 2.5, 7.0, 40.0], count)
    if draw(st.booleans()):  # edges that touch pixel borders
        positions = np.round(2.0 * positions) / 2.0
        radii = np.round(2.0 * radii) / 2.0
    return size, positions, radii, rng.uniform(size=(count, 3))


@given(scenes())
def test_fragments_are_the_pixels_that_disks_cover(scene: tuple[tuple[int, int], Host, Host, Host]) -> None:
    (height, width), positions, radii, _ = scene
    fragments = rasterize_disks(positions, radii, (height, width))
    coverage, *derivatives = canvas_coverage(positions, radii, np.arange(width + 1.0), np.arange(height + 1.0))
    painted = np.zeros(coverage.shape, dtype=bool)
    painted[fragments.owner, fragments.rows, fragments.columns] = True
    assert painted.sum() == len(fragments.owner)
    tiny = 1e-12 * (1.0 + radii.max(initial=0.0) ** 2)
    assert np.all(coverage[~painted] <= tiny)
    inside = ~fragments.on_edge
    assert np.all(coverage[fragments.owner, fragments.rows, fragments.columns][inside] >= 1.0 - tiny)
    for derivative in derivatives:
        assert np.all(np.abs(derivative[fragments.owner, fragments.rows, fragments.columns][inside]) <= tiny)


@given(scenes())
def test_a_layer_has_each_pixel_at_most_once_and_later_disks_lie_higher(
    scene: tuple[tuple[int, int], Host, Host, Host],
) -> None:
    size, positions, radii, _ = scene
    fragments = rasterize_disks(positions, radii, size)
    pixels = fragments.rows * size[1] + fragments.columns
    top = np.full(size[0] * size[1], -1)
    for layer in fragments.layers:
        assert len(np.unique(pixels[layer])) == len(pixels[layer]) > 0
        assert np.all(fragments.owner[layer] > top[pixels[layer]])
        top[pixels[layer]] = fragments.owner[layer]
    assert sum(layer.stop - layer.start for layer in fragments.layers) == len(fragments.owner)


@given(scenes())
def test_painting_fragments_equals_painting_every_disk_on_the_canvas(
    scene: tuple[tuple[int, int], Host, Host, Host],
) -> None:
    (height, width), positions, radii, colours = scene
    coverage = canvas_coverage(positions, radii, np.arange(width + 1.0), np.arange(height + 1.0))[0]
    expected = np.full((height, width, 3), 0.25)
    for alpha, colour in zip(coverage[..., None], colours, strict=True):
        expected = expected + alpha * (colour - expected)
    disks = Disks(height, width, positions, radii, colours, (0.25, 0.25, 0.25))
    np.testing.assert_allclose(
        disks.render(disks.parameters()), expected, rtol=0, atol=1e-12 * (1.0 + radii.max(initial=0.0) ** 2)
    )
