"""The share of each pixel in a point of light is the film's own, with any reconstruction filter."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from loi_mitsuba.sensing.film import Film
from tests.helpers import Host

WIDTH, HEIGHT = 9, 6
FILTERS = ("box", "tent", "gaussian", "lanczos")
LOOKUP = 1e-3  # of a filter that Mitsuba has as a table, by its place: half of what two entries of it differ by

filters = pytest.mark.parametrize("kind", FILTERS)


def film_of(kind: str, *, border: bool = False, pixel_format: str = "rgb") -> Any:
    return mi.load_dict(
        {
            "type": "hdrfilm",
            "width": WIDTH,
            "height": HEIGHT,
            "pixel_format": pixel_format,
            "sample_border": border,
            "rfilter": {"type": kind},
        }
    )


def splat(film: Any, x: Host, y: Host, value: float = 1.0) -> Host:
    """Points of one brightness at places in pixels, as an image: shape (H, W, 3)."""
    place = mi.Point2f(mi.Float((x / WIDTH).astype(np.float32)), mi.Float((y / HEIGHT).astype(np.float32)))
    return Film(film).splat(dr.full(mi.Color3f, value, len(x)), place)


@filters
@pytest.mark.parametrize(("x", "y"), [(4.3, 2.8), (5.0, 3.1), (4.999, 3.5), (0.2, 5.9), (8.7, 0.4)])
def test_pixels_show_a_point_as_an_image_block_does(kind: str, x: float, y: float) -> None:
    film = film_of(kind)
    block = mi.ImageBlock([WIDTH, HEIGHT], [0, 0], 1, film.rfilter(), border=False, normalize=False, coalesce=False)
    block.put(mi.Point2f(x, y), [mi.Float(1.0)])
    theirs = np.array(block.tensor())[..., 0]
    # Each pixel is divided by the integral of the filter around it, for a block only collects.
    radius = float(film.rfilter().radius())
    steps = np.linspace(-radius, radius, 20001)
    value = np.array(film.rfilter().eval(mi.Float(steps.astype(np.float32))), dtype=np.float64)
    totals = []
    for side in (WIDTH, HEIGHT):
        within = np.abs(np.arange(side)[:, None] + 0.5 + steps - side / 2) <= side / 2
        totals.append((within * value).mean(axis=1) * 2.0 * radius)
    wanted = theirs / np.outer(totals[1], totals[0])
    np.testing.assert_allclose(splat(film, np.array([x]), np.array([y]))[..., 0], wanted, rtol=0.0, atol=5 * LOOKUP)


@filters
@pytest.mark.parametrize("border", [False, True])
def test_light_that_is_the_same_everywhere_is_so_in_every_pixel(kind: str, border: bool) -> None:
    """At the rim of the image as well, whether or not the film samples what is beyond."""
    film = film_of(kind, border=border)
    beyond = float(film.rfilter().border_size()) if border else 0.0
    per_pixel = 40
    across, down = (
        -beyond + (np.arange(round((side + 2 * beyond) * per_pixel)) + 0.5) / per_pixel for side in (WIDTH, HEIGHT)
    )
    x, y = (each.ravel() for each in np.meshgrid(across, down))
    np.testing.assert_allclose(splat(film, x, y, per_pixel**-2), 1.0, rtol=0.0, atol=5 * LOOKUP)


@filters
def test_what_the_film_does_not_sample_shows_nowhere(kind: str) -> None:
    outside = np.array([-0.1, WIDTH + 0.1, 3.0, 3.0]), np.array([2.0, 2.0, -0.1, HEIGHT + 0.1])
    assert np.all(splat(film_of(kind), *outside) == 0.0)


@pytest.mark.parametrize("pixel_format", ["rgb", "rgba", "xyz", "luminance"])
def test_looking_up_is_the_transpose_of_splatting(pixel_format: str) -> None:
    rng = np.random.default_rng(5)
    film = Film(film_of("gaussian", border=True, pixel_format=pixel_format))
    count = 64
    place = mi.Point2f(*(mi.Float(rng.uniform(-0.3, 1.3, count).astype(np.float32)) for _ in range(2)))
    value = mi.Color3f(*(mi.Float(rng.normal(size=count).astype(np.float32)) for _ in range(3)))
    cotangent = rng.normal(size=(HEIGHT, WIDTH, film.channels)).astype(np.float32)
    one = float(np.sum(film.splat(value, place) * cotangent))
    other = float(np.sum(np.array(value) * np.array(film.gather(cotangent, place))))
    size = float(np.sum(np.abs(film.splat(value, place) * cotangent)))
    assert abs(one - other) < 1e-5 * size  # float32, over some hundred terms
