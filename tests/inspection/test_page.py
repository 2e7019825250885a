"""The page of an inspection in a real browser: histograms follow the point, nothing overflows, it is accessible."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from loi_core import ScaleSpace
from loi_core.inspection import inspect_pair, make_pair, write_inspection
from tests.inspection.pictures import disks

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A page of two disks that do not overlap, at two inner scales."""
    path = tmp_path_factory.mktemp("inspect") / "page.html"
    write_inspection(path, inspect_pair(make_pair(*disks(), ScaleSpace((0, 2), (2, 8), 0.125), names=("a", "b"))))
    return path


class Opened:
    """An open page, its log messages and its requests."""

    def __init__(self, browser: Browser, path: Path, *, width: int = 1200, touch: bool = False):
        context = browser.new_context(viewport={"width": width, "height": 900}, has_touch=touch)
        self.page: Page = context.new_page()
        self.errors: list[str] = []
        self.requests: list[str] = []
        self.page.on("console", lambda message: self.errors.append(message.text))
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.goto(path.as_uri())
        self.page.wait_for_selector("#stage[data-ready]")

    @property
    def shown(self) -> tuple[str, list[str]]:
        """The position of the point, and the first histogram of every chart."""
        shapes = self.page.eval_on_selector_all(".ours[d]", "paths => paths.map(path => path.getAttribute('d'))")
        return self.page.inner_text("#place"), shapes

    def position(self, x: float, y: float) -> tuple[float, float]:
        """Return a point of the image, given in fractions of it, in pixels of the window."""
        box = self.page.locator("#backdrop").bounding_box()
        assert box
        return box["x"] + x * box["width"], box["y"] + y * box["height"]


def test_the_page_loads_without_errors_and_without_requests(browser: Browser, written: Path) -> None:
    opened = Opened(browser, written)
    assert opened.errors == []
    assert [url for url in opened.requests if not url.startswith("data:")] == [written.as_uri()]
    assert opened.page.locator("img").count() > 20
    assert opened.page.evaluate("[...document.images].every(image => image.naturalWidth > 0)")


def test_histograms_follow_the_pointer_until_a_click_fixes_the_point(browser: Browser, written: Path) -> None:
    opened = Opened(browser, written)
    opened.page.mouse.move(*opened.position(0.2, 0.51))
    first = opened.shown
    assert first[0] == "column 12, row 24"
    opened.page.mouse.move(*opened.position(0.7, 0.31))
    assert opened.shown[0] == "column 44, row 14"
    assert opened.shown[1] != first[1]
    opened.page.mouse.down()
    opened.page.mouse.up()
    fixed = opened.shown
    opened.page.mouse.move(*opened.position(0.2, 0.51))
    assert opened.shown == fixed
    opened.page.mouse.down()
    assert opened.shown == first


def test_histograms_follow_the_arrow_keys_and_stop_at_the_edge(browser: Browser, written: Path) -> None:
    opened = Opened(browser, written)
    opened.page.focus("#stage")
    first = opened.shown
    opened.page.keyboard.press("ArrowRight")
    second = opened.shown
    assert (first[0], second[0]) == ("column 32, row 24", "column 33, row 24")
    assert first[1] != second[1]
    opened.page.keyboard.press("Shift+ArrowUp")
    assert opened.shown[0] == "column 33, row 19"
    for _ in range(8):
        opened.page.keyboard.press("Shift+ArrowUp")
    assert opened.shown[0] == "column 33, row 0"
    opened.page.wait_for_selector("#announced:has-text('column 33, row 0; extent 2: distance 0')", state="attached")


def test_histograms_follow_a_touch(browser: Browser, written: Path) -> None:
    opened = Opened(browser, written, width=390, touch=True)
    initial = opened.shown
    opened.page.locator("#stage").scroll_into_view_if_needed()
    opened.page.touchscreen.tap(*opened.position(0.2, 0.51))
    assert opened.shown[0] == "column 12, row 24"
    assert opened.shown[1] != initial[1]


def test_the_distance_under_the_pointer_agrees_with_the_loss_map(browser: Browser, written: Path) -> None:
    scales = ScaleSpace((0, 2), (2, 8), 0.125)
    findings = {scale.key: scale for scale in inspect_pair(make_pair(*disks(), scales)).scales}
    opened = Opened(browser, written)
    opened.page.mouse.move(*opened.position(0.2, 0.51))
    for index, sigma in enumerate(scales.sigma):
        opened.page.select_option("#group", index=index)
        texts = opened.page.locator(".distance").all_inner_texts()
        expected = [float(findings[alpha, 0.125, sigma].loss[24, 12]) for alpha in scales.alpha]
        assert [float(text.removeprefix("distance ")) for text in texts] == pytest.approx(expected, abs=0.01)


def test_every_chart_has_a_name_from_the_moment_it_is_drawn(browser: Browser, written: Path) -> None:
    opened = Opened(browser, written)
    script = """index => {
        const group = document.getElementById("group");
        group.selectedIndex = index;
        group.dispatchEvent(new Event("change"));
        return [...document.querySelectorAll("#charts svg[role=img]")].map(svg => svg.getAttribute("aria-label"));
    }"""
    for index in (1, 0):
        names = opened.page.evaluate(script, index)
        assert [name for extent in (2, 8) for name in names if name.endswith(f"extent {extent} px")] == names
        assert len(set(names)) == 6
    opened.page.wait_for_selector("svg[aria-label*='extent 8 px: histograms']")


def test_every_map_can_be_shown_behind_the_point(browser: Browser, written: Path) -> None:
    opened = Opened(browser, written)
    original, *names = opened.page.eval_on_selector_all("#view option", "all => all.map(option => option.value)")
    first = opened.page.get_attribute("#backdrop", "src")
    assert len(names) > 10
    for name in (*names[:2], names[-1]):
        opened.page.select_option("#view", value=name)
        assert opened.page.get_attribute("#backdrop", "src") == opened.page.get_attribute(f"#{name}", "src") != first
    opened.page.select_option("#view", value=original)
    assert opened.page.get_attribute("#backdrop", "src") == first


def test_an_inspection_is_accessible_and_nothing_overflows(browser: Browser, written: Path) -> None:
    axe = pytest.importorskip("axe_playwright_python.sync_playwright").Axe()
    page = Opened(browser, written, width=390).page
    for width, scheme in ((390, "light"), (1600, "dark")):
        page.set_viewport_size({"width": width, "height": 900})
        page.emulate_media(color_scheme=scheme)
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        result = axe.run(page)
        assert result.violations_count == 0, result.generate_report()
