"""What notebooks show: results, objectives and plans as small pieces of HTML that need no style sheet."""

from __future__ import annotations

import base64
import io
import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from PIL import Image

from loi_core import MSSSIM, FitResult, FitStep, GaussianPyramid, LOIObjective, PixelL2
from loi_core.fitting.notebook import convergence_points
from loi_core.pixels.psnr import psnr
from loi_core.pixels.thumbnail import shown_pixels, thumbnail
from tests.fitting.fits import REFERENCE, SCALES, SCENE, Bowl, run

OBJECTIVE = LOIObjective(REFERENCE, SCALES)
NASTY = "<script>alert('&')</script>"


@pytest.fixture(scope="module")
def result() -> FitResult:
    found: FitResult = run(steps=60)
    return found


def parsed(thing: Any) -> ET.Element:
    """The HTML of an object, which has to be whole enough for a parser of XML that forgives nothing but <br>."""
    html = thing if isinstance(thing, str) else thing._repr_html_()
    return ET.fromstring(re.sub(r"(<(?:br|img)\b[^>]*)>", r"\1/>", html))  # noqa: S314  # it is our own


def texts(thing: Any) -> str:
    return " ".join(parsed(thing).itertext())


def pictures(thing: Any) -> list[Image.Image]:
    data = [str(one.get("src")).removeprefix("data:image/png;base64,") for one in parsed(thing).iter("img")]
    return [Image.open(io.BytesIO(base64.b64decode(one))) for one in data]


def test_a_result_shows_its_verdict_value_psnr_parameters_picture_and_curve(result: FitResult) -> None:
    said = texts(result)
    assert str(result.diagnosis) in said
    assert f"{result.best_value:.4g}" in said
    assert f"{result.psnr:.2f} dB" in said
    assert "positions" in said
    assert "8 23" in said  # where it began
    assert " ".join(f"{one:.5g}" for one in result.best_params["positions"].ravel()) in said
    assert [one.size for one in pictures(result)] == [(32, 32)]
    assert len(list(parsed(result).iter("polyline"))) == 1


def test_the_psnr_of_a_result_is_that_of_its_image(result: FitResult) -> None:
    assert result.psnr == pytest.approx(psnr(result.image, REFERENCE), rel=1e-12)


def test_the_psnr_counts_pixels_by_their_weights_and_knows_other_layouts() -> None:
    class First:
        """Channels first."""

        def parameters(self) -> Any:
            return SCENE.parameters()

        def render(self, params: Any, *, seed: int = 0) -> Any:
            return np.moveaxis(SCENE.render(params), -1, 0)

        def render_vjp(self, params: Any, *, seed: int = 0) -> Any:
            image, pull = SCENE.render_vjp(params)
            return np.moveaxis(image, -1, 0), lambda gradient: pull(np.moveaxis(gradient, 0, -1))

    import loi_core

    weights = np.zeros((32, 32))
    weights[:16] = 1.0
    target = np.moveaxis(REFERENCE, -1, 0)
    for one in (None, weights):
        objective = LOIObjective(target, SCALES, channel_axis=0, weights=one)
        found = loi_core.fit(First(), objective, steps=2, optimise=["positions"], learning_rate=1.0)
        assert found.psnr == pytest.approx(psnr(np.moveaxis(found.image, 0, -1), REFERENCE, one), rel=1e-12)


def test_of_an_objective_without_a_reference_no_psnr_is_known() -> None:
    class Far:
        def value(self, image: Any) -> Any:
            return np.sum(image**2)

        def value_and_grad(self, image: Any) -> Any:
            return np.sum(image**2), 2.0 * image

    import loi_core

    found = loi_core.fit(Bowl(), Far(), steps=2, optimise=["pixels"], learning_rate=0.1)
    assert found.psnr is None
    assert "PSNR" not in texts(found)


def test_each_stage_has_a_curve_of_its_own_and_long_fits_few_points() -> None:
    history = [FitStep(step, 1e-3 * 0.999**step, 0.0, 1.0, 0.0, stage=step // 4000) for step in range(12000)]
    drawn = convergence_points(history)
    assert len(drawn) == 3
    assert sum(map(len, drawn)) <= 120
    assert all(curve[0][1] == 0.0 for curve in drawn)
    assert drawn[-1][-1] == pytest.approx((11999, np.log10(0.999) * (11999 - drawn[-1][0][0])))


@pytest.mark.parametrize("steps", [0, 1])
def test_a_fit_of_no_or_one_step_is_shown_without_a_curve(result: FitResult, steps: int) -> None:
    short = replace(result, history=result.history[:steps], diagnosis=None)
    assert not list(parsed(short).iter("polyline"))
    assert "cut short" in repr(short)


def test_values_that_are_not_finite_leave_no_trace_in_a_curve() -> None:
    values = [1.0, np.nan, np.inf, 0.0, 0.5]
    history = [FitStep(step, value, 0.0, 1.0, 0.0) for step, value in enumerate(values)]
    show = replace(run(steps=2), history=history)
    (line,) = parsed(show).iter("polyline")
    assert len(str(line.get("points")).split()) == 3


OBJECTIVES = [
    OBJECTIVE,
    PixelL2(REFERENCE),
    GaussianPyramid(REFERENCE),
    MSSSIM(REFERENCE, levels=1),
    LOIObjective(np.moveaxis(REFERENCE, -1, 0), SCALES, "balanced", channel_axis=0, nan_policy="mask"),
    PixelL2(REFERENCE[..., 0], channel_axis=None, weights=np.ones((32, 32))),
]


@pytest.mark.parametrize("objective", OBJECTIVES, ids=repr)
def test_an_objective_shows_its_reference_and_what_it_compares(objective: Any) -> None:
    assert [one.size for one in pictures(objective)] == [(32, 32)]
    assert "32" in texts(objective)
    assert type(objective).__name__ in texts(objective)
    assert len(repr(objective)) < 160


def test_options_are_said_where_they_are_not_the_usual_ones() -> None:
    plain, other = repr(OBJECTIVE), repr(OBJECTIVES[5])
    assert plain == "<LOIObjective: reference 32x32x3 float64, sigma 1, alpha 3 9, beta 0.125, accuracy exact>"
    assert "accuracy balanced, channel_axis 0, nan_policy mask" in other


def test_what_a_plan_prints_is_aligned() -> None:
    _, heads, *rows, _ = (line for line in str(OBJECTIVE.plan()).splitlines() if "Numba" not in line)
    assert {len(line) for line in [heads, *rows]} == {len(heads)}


def test_names_of_parameters_and_views_cannot_be_html(result: FitResult) -> None:
    found = {NASTY: np.zeros(2), "many": np.zeros(100)}
    odd = replace(result, best_params=found, rates=dict.fromkeys(found, 1.0), image={NASTY: result.image})
    html = odd._repr_html_()
    assert "<script" not in html
    assert texts(odd).count(NASTY) == 2
    assert "100 from 0 to 0" in texts(odd)


def test_results_are_small_whatever_they_are_of(result: FitResult) -> None:
    views = {f"view {index}": np.random.default_rng(index).random((700, 400, 3)) for index in range(5)}
    params = {f"parameter {index}": np.zeros(10**5) for index in range(40)}
    large = replace(result, best_params=params, image=views, rates=dict.fromkeys(params, 1.0))
    assert [max(one.size) for one in pictures(large)] == [160] * 4
    assert "and 28 more" in texts(large)
    assert len(large._repr_html_()) < 400_000
    assert len(repr(large)) < 160


def test_no_colour_but_the_page_s_own_or_a_grey_that_shows_on_both(result: FitResult) -> None:
    for one in (result, OBJECTIVE):
        html = re.sub(r"base64,[^\"]*", "", one._repr_html_())
        assert not re.search(r"#[0-9a-f]{3,8}\b|\bwhite\b|\bblack\b|<style", html)
        assert "rgba(128,128,128" in html


SHAPES = {
    (8, 6): (8, 6),
    (8, 6, 3): (8, 6),
    (8, 6, 1): (8, 6),
    (3, 8, 6): (8, 6),
    (2, 8, 6, 4): (8, 6),
    (2, 3, 8, 6): (8, 6),
    (8,): None,
    (8, 6, 7): None,
    (0, 6, 3): None,
}


@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_channels_are_found_where_they_may_be(shape: tuple[int, ...]) -> None:
    pixels = shown_pixels(np.zeros(shape))
    assert (None if pixels is None else pixels.shape[:2]) == SHAPES[shape]
    assert bool(thumbnail(np.zeros(shape), "")) == (pixels is not None)


def test_pictures_show_bytes_as_fractions_and_what_is_not_finite_as_black() -> None:
    image = np.full((4, 4, 3), 0.5)
    image[0, 0] = np.nan
    for one in (image, np.rint(255 * np.nan_to_num(image)).astype(np.uint8)):
        (shown,) = pictures(thumbnail(one, ""))
        pixels = np.asarray(shown)
        assert pixels[0, 0].tolist() == [0, 0, 0]
        assert np.all(np.abs(pixels[1:].astype(int) - 128) <= 1)
