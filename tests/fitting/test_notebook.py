"""Results and objectives as HTML for notebooks, without a style sheet."""

from __future__ import annotations

import base64
import io
import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from loi_core import MSSSIM, FitResult, FitStep, GaussianPyramid, LOIObjective, PixelL2
from loi_core.fitting.notebook import convergence_points
from loi_core.pixels.psnr import psnr
from loi_core.pixels.thumbnail import thumbnail
from tests.fitting.fits import REFERENCE, SCALES, SCENE, Bowl, run

OBJECTIVE = LOIObjective(REFERENCE, SCALES)
NASTY = "<script>alert('&')</script>"


@pytest.fixture(scope="module")
def result() -> FitResult:
    fitted: FitResult = run(steps=60)
    return fitted


def parsed(shown: Any) -> ET.Element:
    """Parse the HTML of an object strictly, as XML except for <br> and <img>."""
    html = shown if isinstance(shown, str) else shown._repr_html_()
    return ET.fromstring(re.sub(r"(<(?:br|img)\b[^>]*)>", r"\1/>", html))  # noqa: S314  # our own


def texts(shown: Any) -> str:
    return " ".join(parsed(shown).itertext())


def pictures(shown: Any) -> list[Image.Image]:
    data = [str(element.get("src")).removeprefix("data:image/png;base64,") for element in parsed(shown).iter("img")]
    return [Image.open(io.BytesIO(base64.b64decode(png))) for png in data]


def test_a_result_shows_its_verdict_value_psnr_parameters_picture_and_curve(result: FitResult) -> None:
    text = texts(result)
    assert str(result.diagnosis) in text
    assert f"{result.best_value:.4g}" in text
    assert f"{result.psnr:.2f} dB" in text
    assert "positions" in text
    assert "8 23" in text  # the start
    assert " ".join(f"{number:.5g}" for number in result.best_params["positions"].ravel()) in text
    assert [picture.size for picture in pictures(result)] == [(32, 32)]
    assert len(list(parsed(result).iter("polyline"))) == 1


def test_the_psnr_of_a_result_is_the_psnr_of_its_image(result: FitResult) -> None:
    assert result.psnr == pytest.approx(psnr(result.image, REFERENCE), rel=1e-12)


def test_the_psnr_of_a_result_uses_weights_and_the_channel_axis() -> None:
    class ChannelsFirst:
        def parameters(self) -> Any:
            return SCENE.parameters()

        def render(self, params: Any, *, seed: int = 0) -> Any:
            return np.moveaxis(SCENE.render(params), -1, 0)

        def render_vjp(self, params: Any, *, seed: int = 0) -> Any:
            image, pullback = SCENE.render_vjp(params)
            return np.moveaxis(image, -1, 0), lambda cotangent: pullback(np.moveaxis(cotangent, 0, -1))

    import loi_core

    upper_half = np.zeros((32, 32))
    upper_half[:16] = 1.0
    target = np.moveaxis(REFERENCE, -1, 0)
    for weights in (None, upper_half):
        objective = LOIObjective(target, SCALES, channel_axis=0, weights=weights)
        result = loi_core.fit(ChannelsFirst(), objective, steps=2, optimise=["positions"], learning_rate=1.0)
        expected = psnr(np.moveaxis(result.image, 0, -1), REFERENCE, weights)
        assert result.psnr == pytest.approx(expected, rel=1e-12)


def test_a_result_of_an_objective_without_a_reference_has_no_psnr() -> None:
    class SumOfSquares:
        def value(self, image: Any) -> Any:
            return np.sum(image**2)

        def value_and_grad(self, image: Any) -> Any:
            return np.sum(image**2), 2.0 * image

    import loi_core

    result = loi_core.fit(Bowl(), SumOfSquares(), steps=2, optimise=["pixels"], learning_rate=0.1)
    assert result.psnr is None
    assert "PSNR" not in texts(result)


def test_each_stage_has_a_separate_curve_and_long_fits_have_few_points() -> None:
    history = [FitStep(step, 1e-3 * 0.999**step, 0.0, 1.0, 0.0, stage=step // 4000) for step in range(12000)]
    curves = convergence_points(history)
    assert len(curves) == 3
    assert sum(map(len, curves)) <= 120
    assert all(curve[0][1] == 0.0 for curve in curves)
    assert curves[-1][-1] == pytest.approx((11999, np.log10(0.999) * (11999 - curves[-1][0][0])))


@pytest.mark.parametrize("steps", [0, 1])
def test_a_fit_of_no_or_one_step_is_shown_without_a_curve(result: FitResult, steps: int) -> None:
    short = replace(result, history=result.history[:steps], diagnosis=None)
    assert not list(parsed(short).iter("polyline"))
    assert "cut short" in repr(short)


def test_a_curve_leaves_out_values_that_are_not_finite() -> None:
    values = [1.0, np.nan, np.inf, 0.0, 0.5]
    history = [FitStep(step, value, 0.0, 1.0, 0.0) for step, value in enumerate(values)]
    result = replace(run(steps=2), history=history)
    (line,) = parsed(result).iter("polyline")
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
def test_an_objective_shows_its_reference_and_its_options(objective: Any) -> None:
    assert [picture.size for picture in pictures(objective)] == [(32, 32)]
    assert "32" in texts(objective)
    assert type(objective).__name__ in texts(objective)
    assert len(repr(objective)) < 160


def test_the_repr_of_an_objective_lists_options_that_differ_from_the_defaults() -> None:
    plain, masked = repr(OBJECTIVE), repr(OBJECTIVES[4])
    assert plain == "<LOIObjective: reference 32x32x3 float64, sigma 1, alpha 3 9, beta 0.125, accuracy exact>"
    assert "accuracy balanced, channel_axis 0, nan_policy mask" in masked


def test_the_printed_columns_of_a_plan_are_aligned() -> None:
    _, heads, *rows, _ = (line for line in str(OBJECTIVE.plan()).splitlines() if "Numba" not in line)
    assert {len(line) for line in [heads, *rows]} == {len(heads)}


def test_names_of_parameters_and_views_cannot_be_html(result: FitResult) -> None:
    params = {NASTY: np.zeros(2), "many": np.zeros(100)}
    hostile = replace(result, best_params=params, rates=dict.fromkeys(params, 1.0), image={NASTY: result.image})
    assert "<script" not in hostile._repr_html_()
    assert texts(hostile).count(NASTY) == 2
    assert "100 from 0 to 0" in texts(hostile)


def test_the_html_of_a_large_result_is_small(result: FitResult) -> None:
    views = {f"view {index}": np.random.default_rng(index).random((700, 400, 3)) for index in range(5)}
    params = {f"parameter {index}": np.zeros(10**5) for index in range(40)}
    large = replace(result, best_params=params, image=views, rates=dict.fromkeys(params, 1.0))
    assert [max(picture.size) for picture in pictures(large)] == [160] * 4
    assert "and 28 more" in texts(large)
    assert len(large._repr_html_()) < 400_000
    assert len(repr(large)) < 160


def test_the_only_colours_are_the_page_s_own_and_a_translucent_grey(result: FitResult) -> None:
    for shown in (result, OBJECTIVE):
        html = re.sub(r"base64,[^\"]*", "", shown._repr_html_())
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
def test_a_thumbnail_finds_the_channel_axis(shape: tuple[int, ...]) -> None:
    html = thumbnail(np.zeros(shape), "")
    sizes = [picture.size[::-1] for picture in pictures(html)] if html else [None]
    assert sizes == [SHAPES[shape]]


def test_a_thumbnail_shows_bytes_as_fractions_and_nan_as_black() -> None:
    image = np.full((4, 4, 3), 0.5)
    image[0, 0] = np.nan
    for array in (image, np.rint(255 * np.nan_to_num(image)).astype(np.uint8)):
        (picture,) = pictures(thumbnail(array, ""))
        pixels = np.asarray(picture)
        assert pixels[0, 0].tolist() == [0, 0, 0]
        assert np.all(np.abs(pixels[1:].astype(int) - 128) <= 1)


def test_a_fit_with_progress_shows_its_last_step_in_the_notebook_that_runs_it() -> None:
    nbclient, nbformat = pytest.importorskip("nbclient"), pytest.importorskip("nbformat")
    cell = nbformat.v4.new_code_cell("from tests.fitting.fits import run\nrun(steps=3, progress=True)\nNone")
    kernel_folder = {"metadata": {"path": str(Path(__file__).parents[2])}}
    nbclient.NotebookClient(nbformat.v4.new_notebook(cells=[cell]), timeout=300, resources=kernel_folder).execute()
    (live,) = [output.data["text/html"] for output in cell.outputs if output.output_type == "display_data"]
    assert "step 2" in texts(live)
    assert [picture.size for picture in pictures(live)] == [(32, 32)]
    assert len(list(parsed(live).iter("polyline"))) == 1


def test_a_fit_with_progress_displays_nothing_in_a_shell_without_a_kernel(monkeypatch: pytest.MonkeyPatch) -> None:
    ipython = pytest.importorskip("IPython")
    shell = ipython.core.interactiveshell.InteractiveShell()
    monkeypatch.setattr(ipython, "get_ipython", lambda: shell)
    with ipython.utils.capture.capture_output() as captured:
        run(steps=3, progress=True)
    assert captured.outputs == []
