"""Splatting reproduces the film's own reconstruction filter, and gathering is its adjoint."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from mitsuba_boundaries.sensing.film import Film
from tests.helpers import Host

WIDTH, HEIGHT = 9, 6
FILTERS = ("box", "tent", "gaussian", "lanczos")
TABLE_ERROR = 1e-3  # Mitsuba tabulates filters: half the difference of neighbouring entries

filters = pytest.mark.parametrize("filter_name", FILTERS)


def load_film(filter_name: str, *, border: bool = False, pixel_format: str = "rgb") -> Any:
    return mi.load_dict(
        {
            "type": "hdrfilm",
            "width": WIDTH,
            "height": HEIGHT,
            "pixel_format": pixel_format,
            "sample_border": border,
            "rfilter": {"type": filter_name},
        }
    )


def splat(film: Any, x: Host, y: Host, value: float = 1.0) -> Host:
    """Splat points of equal value at positions in pixels: an image, shape (H, W, 3)."""
    uv = mi.Point2f(mi.Float((x / WIDTH).astype(np.float32)), mi.Float((y / HEIGHT).astype(np.float32)))
    return Film(film).splat(dr.full(mi.Color3f, value, len(x)), uv)


@filters
@pytest.mark.parametrize(("x", "y"), [(4.3, 2.8), (5.0, 3.1), (4.999, 3.5), (0.2, 5.9), (8.7, 0.4)])
def test_a_splatted_point_equals_that_of_an_image_block(filter_name: str, x: float, y: float) -> None:
    film = load_film(filter_name)
    block = mi.ImageBlock([WIDTH, HEIGHT], [0, 0], 1, film.rfilter(), border=False, normalize=False, coalesce=False)
    block.put(mi.Point2f(x, y), [mi.Float(1.0)])
    block_image = np.array(block.tensor())[..., 0]
    # The block accumulates only; divide each pixel by the integral of the filter around it.
    radius = float(film.rfilter().radius())
    offset = np.linspace(-radius, radius, 20001)
    value = np.array(film.rfilter().eval(mi.Float(offset.astype(np.float32))), dtype=np.float64)
    integrals = []
    for length in (WIDTH, HEIGHT):
        is_inside = np.abs(np.arange(length)[:, None] + 0.5 + offset - length / 2) <= length / 2
        integrals.append((is_inside * value).mean(axis=1) * 2.0 * radius)
    expected = block_image / np.outer(integrals[1], integrals[0])
    actual = splat(film, np.array([x]), np.array([y]))[..., 0]
    np.testing.assert_allclose(actual, expected, rtol=0.0, atol=5 * TABLE_ERROR)


@filters
@pytest.mark.parametrize("border", [False, True])
def test_constant_light_gives_a_constant_image(filter_name: str, border: bool) -> None:
    """Also at the border of the image, whether or not the film samples beyond it."""
    film = load_film(filter_name, border=border)
    margin = float(film.rfilter().border_size()) if border else 0.0
    per_pixel = 40
    columns, rows = (
        -margin + (np.arange(round((length + 2 * margin) * per_pixel)) + 0.5) / per_pixel for length in (WIDTH, HEIGHT)
    )
    x, y = (grid.ravel() for grid in np.meshgrid(columns, rows))
    np.testing.assert_allclose(splat(film, x, y, per_pixel**-2), 1.0, rtol=0.0, atol=5 * TABLE_ERROR)


@filters
def test_points_outside_the_sampled_region_do_not_appear(filter_name: str) -> None:
    outside = np.array([-0.1, WIDTH + 0.1, 3.0, 3.0]), np.array([2.0, 2.0, -0.1, HEIGHT + 0.1])
    assert np.all(splat(load_film(filter_name), *outside) == 0.0)


@pytest.mark.parametrize("pixel_format", ["rgb", "rgba", "xyz", "luminance"])
def test_gathering_is_the_adjoint_of_splatting(pixel_format: str) -> None:
    rng = np.random.default_rng(5)
    film = Film(load_film("gaussian", border=True, pixel_format=pixel_format))
    count = 64
    uv = mi.Point2f(*(mi.Float(rng.uniform(-0.3, 1.3, count).astype(np.float32)) for _ in range(2)))
    value = mi.Color3f(*(mi.Float(rng.normal(size=count).astype(np.float32)) for _ in range(3)))
    cotangent = rng.normal(size=(HEIGHT, WIDTH, film.channels)).astype(np.float32)
    products = film.splat(value, uv) * cotangent
    gathered = float(np.sum(np.array(value) * np.array(film.gather(cotangent, uv))))
    assert abs(float(np.sum(products)) - gathered) < 1e-5 * float(np.sum(np.abs(products)))  # float32, ~100 terms
