"""The page in a real browser: histograms follow pointer, keys and touch, nothing overflows, and axe finds nothing."""

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
    """A page of two disks that overlap nowhere, at two inner scales."""
    path = tmp_path_factory.mktemp("inspect") / "page.html"
    write_inspection(path, inspect_pair(make_pair(*disks(), ScaleSpace((0, 2), (2, 8), 0.125), names=("a", "b"))))
    return path


class Opened:
    """The page, with what it said and asked for."""

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
        """Where the point is, and the first histogram of every chart."""
        shapes = self.page.eval_on_selector_all(".ours[d]", "all => all.map(one => one.getAttribute('d'))")
        return self.page.inner_text("#place"), shapes

    def place(self, across: float, down: float) -> tuple[float, float]:
        """A place on the picture, in pixels of the window."""
        box = self.page.locator("#backdrop").bounding_box()
        assert box
        return box["x"] + across * box["width"], box["y"] + down * box["height"]


def test_the_page_loads_without_errors_and_asks_the_network_for_nothing(browser: Browser, written: Path) -> None:
    opened = Opened(browser, written)
    assert opened.errors == []
    assert [url for url in opened.requests if not url.startswith("data:")] == [written.as_uri()]
    assert opened.page.locator("img").count() > 20
    assert opened.page.evaluate("[...document.images].every(one => one.naturalWidth > 0)")


def test_histograms_follow_the_pointer_until_a_click_holds_them(browser: Browser, written: Path) -> None:
    opened = Opened(browser, written)
    opened.page.mouse.move(*opened.place(0.2, 0.51))
    there = opened.shown
    assert there[0] == "column 12, row 24"
    opened.page.mouse.move(*opened.place(0.7, 0.31))
    assert opened.shown[0] == "column 44, row 14"
    assert opened.shown[1] != there[1]
    opened.page.mouse.down()
    opened.page.mouse.up()
    held = opened.shown
    opened.page.mouse.move(*opened.place(0.2, 0.51))
    assert opened.shown == held
    opened.page.mouse.down()
    assert opened.shown == there


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
    opened.page.wait_for_selector("#told:has-text('column 33, row 0; extent 2: distance 0')", state="attached")


def test_histograms_follow_a_touch(browser: Browser, written: Path) -> None:
    opened = Opened(browser, written, width=390, touch=True)
    before = opened.shown
    opened.page.locator("#stage").scroll_into_view_if_needed()
    opened.page.touchscreen.tap(*opened.place(0.2, 0.51))
    assert opened.shown[0] == "column 12, row 24"
    assert opened.shown[1] != before[1]


def test_the_distance_that_is_shown_is_that_of_the_loss_map(browser: Browser, written: Path) -> None:
    scales = ScaleSpace((0, 2), (2, 8), 0.125)
    found = {one.key: one for one in inspect_pair(make_pair(*disks(), scales)).scales}
    opened = Opened(browser, written)
    opened.page.mouse.move(*opened.place(0.2, 0.51))
    for index, sigma in enumerate(scales.sigma):
        opened.page.select_option("#group", index=index)
        said = opened.page.locator(".distance").all_inner_texts()
        wanted = [float(found[alpha, 0.125, sigma].loss[24, 12]) for alpha in scales.alpha]
        assert [float(one.removeprefix("distance ")) for one in said] == pytest.approx(wanted, abs=0.01)


def test_every_chart_has_a_name_from_the_moment_it_is_drawn(browser: Browser, written: Path) -> None:
    opened = Opened(browser, written)
    named = """index => {
        const group = document.getElementById("group");
        group.selectedIndex = index;
        group.dispatchEvent(new Event("change"));
        return [...document.querySelectorAll("svg[role=img]")].map(one => one.getAttribute("aria-label"));
    }"""
    for index in (1, 0):
        names = opened.page.evaluate(named, index)
        assert [one for extent in (2, 8) for one in names if one.endswith(f"extent {extent} px")] == names
        assert len(set(names)) == 6
    opened.page.wait_for_selector("svg[aria-label*='extent 8 px: histograms']")


def test_every_map_can_lie_behind_the_point(browser: Browser, written: Path) -> None:
    opened = Opened(browser, written)
    own, *names = opened.page.eval_on_selector_all("#view option", "all => all.map(one => one.value)")
    first = opened.page.get_attribute("#backdrop", "src")
    assert len(names) > 10
    for name in (*names[:2], names[-1]):
        opened.page.select_option("#view", value=name)
        assert opened.page.get_attribute("#backdrop", "src") == opened.page.get_attribute(f"#{name}", "src") != first
    opened.page.select_option("#view", value=own)
    assert opened.page.get_attribute("#backdrop", "src") == first


def test_nothing_is_wider_than_the_window_and_axe_finds_nothing(browser: Browser, written: Path) -> None:
    axe = pytest.importorskip("axe_playwright_python.sync_playwright").Axe()
    page = Opened(browser, written, width=390).page
    for width, scheme in ((390, "light"), (1600, "dark")):
        page.set_viewport_size({"width": width, "height": 900})
        page.emulate_media(color_scheme=scheme)
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        found = axe.run(page)
        assert found.violations_count == 0, found.generate_report()
