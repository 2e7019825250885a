"""The interactive figure of the page "Why it works" computes the loss of the library, and works by keyboard."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from loi_core import LOIObjective, ScaleSpace
from tests.environments import ROOT

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A page with the figure only."""
    playwright = pytest.importorskip("playwright.sync_api")
    if CHROMIUM is None:
        pytest.skip("there is no Chromium")
    static = ROOT / "docs" / "_static"
    html = tmp_path_factory.mktemp("page") / "page.html"
    style, script = ((static / name).read_text() for name in ("site.css", "play.js"))
    html.write_text(f"<!doctype html><style>{style}</style><body><div id=loi-play></div><script>{script}</script>")
    with playwright.sync_playwright() as running:
        browser = running.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        tab = browser.new_page(reduced_motion="reduce")
        tab.goto(Path(html).as_uri())
        yield tab
        browser.close()


@pytest.mark.parametrize(("sigma", "beta", "alpha"), [(0, 0.125, 0), (1, 0.125, 45), (4, 0.05, 15), (12, 0.4, 60)])
@pytest.mark.parametrize("textured", [False, True])
def test_the_page_computes_the_loss_of_the_library(
    page: Any, sigma: float, beta: float, alpha: float, textured: bool
) -> None:
    code = f"""() => {{
        const [a, b] = [loiPlay.picture(24.3, 0.7, {str(textured).lower()}), loiPlay.picture(96, 0.9, false)];
        return [[...a], [...b], loiPlay.localLoss(a, b, {sigma}, {beta}, {alpha})];
    }}"""
    image, reference, loss = page.evaluate(code)
    planes = [np.array(plane)[None, :, None] for plane in (image, reference)]
    expected = float(LOIObjective(planes[1], ScaleSpace(sigma, alpha, beta)).value(planes[0]))
    assert loss == pytest.approx(expected, rel=1e-6)


def test_a_slider_moves_by_the_keyboard_and_the_page_reports_the_change(page: Any) -> None:
    slider = page.get_by_role("slider", name="Place of your bar")
    slider.focus()
    status = page.locator(".loi-play-status").inner_text()
    page.keyboard.press("ArrowRight")
    page.wait_for_function("old => document.querySelector('.loi-play-status').innerText !== old", arg=status)
    assert slider.input_value() == "25"
    assert "is at 25 px" in page.locator(".loi-play-status").inner_text()


def test_descent_on_histograms_arrives_and_descent_on_pixels_does_not_start(page: Any) -> None:
    page.reload()
    for name, position in (("Descend on pixels", 24), ("Descend on histograms", 96)):
        page.get_by_role("button", name=name).focus()
        page.keyboard.press("Enter")
        page.wait_for_timeout(100)
        assert float(page.get_by_role("slider", name="Place of your bar").input_value()) == pytest.approx(
            position, abs=1
        )
