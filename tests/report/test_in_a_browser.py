"""A report in a real browser: its tools work, it fetches nothing, and it is accessible."""

from __future__ import annotations

import importlib
import json
import re
import shutil
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from loi_core.cli import main
from tests.helpers import FINISHED


class Visit:
    """An open page, its log messages and its requests."""

    def __init__(
        self,
        browser: Any,
        address: str,
        *,
        width: int = 1600,
        scheme: str = "light",
        script: bool = True,
        motion: str = "reduce",
    ):
        self.context = browser.new_context(
            viewport={"width": width, "height": 1000},
            color_scheme=scheme,
            java_script_enabled=script,
            reduced_motion=motion,
        )
        self.tab = self.context.new_page()
        self.logged: list[str] = []
        self.requests: list[str] = []
        self.tab.on("console", lambda message: self.logged.append(message.text))
        self.tab.on("pageerror", lambda error: self.logged.append(str(error)))
        self.tab.on("request", lambda request: self.requests.append(request.url))
        self.tab.goto(address)

    def source(self, selector: str) -> str:
        return str(self.tab.locator(selector).first.get_attribute("src"))


@pytest.fixture(scope="module")
def address(fitted: Path) -> str:
    return (fitted / "report.html").as_uri()


@pytest.fixture
def visit(browser: Any, address: str) -> Iterator[Visit]:
    page = Visit(browser, address)
    yield page
    assert page.logged == []
    assert [url for url in page.requests if not url.startswith("data:")] == [address]
    page.context.close()


def test_the_scrubber_moves_the_picture_by_pointer_and_by_keyboard(visit: Visit) -> None:
    scrubber = visit.tab.get_by_label("Step", exact=True)
    last = visit.source("img.shown")
    scrubber.fill("0")
    first = visit.source("img.shown")
    assert first != last
    assert first == visit.source("figure.frame[data-step='0'] img")
    assert "step 0" in scrubber.get_attribute("aria-valuetext")
    scrubber.focus()
    scrubber.press("ArrowRight")
    assert visit.source("img.shown") != first
    assert visit.tab.locator(".player .caption").text_content().startswith("step ")


def test_the_scrubber_moves_the_line_of_every_chart_and_its_readings(visit: Visit) -> None:
    def read() -> tuple[list[str], list[str]]:
        lines = visit.tab.locator("line.now").evaluate_all("lines => lines.map(line => line.getAttribute('x1'))")
        return lines, visit.tab.locator(".legend .at").all_text_contents()

    at_end = read()
    visit.tab.get_by_label("Step", exact=True).fill("0")
    at_start = read()
    assert len(set(at_start[0])) == 1
    assert len(at_start[0]) >= 4
    assert all(first != last for first, last in zip(at_start[0], at_end[0], strict=True))
    assert at_start[1] != at_end[1]
    assert at_start[1][0] == "1"  # the objective, relative to its start


def test_play_goes_through_the_steps_to_the_last_and_pauses(visit: Visit) -> None:
    scrubber = visit.tab.get_by_label("Step", exact=True)
    last = scrubber.get_attribute("max")
    visit.tab.get_by_role("button", name="Play").click()
    pause = visit.tab.get_by_role("button", name="Pause")
    expect = importlib.import_module("playwright.sync_api").expect
    expect(scrubber).to_have_value(re.compile("[3-9]|1."))
    pause.click()
    paused = scrubber.input_value()
    assert 2 < int(paused) < int(last)
    visit.tab.wait_for_timeout(300)
    assert scrubber.input_value() == paused
    scrubber.focus()
    scrubber.press(" ")
    expect(scrubber).to_have_value(last)
    expect(visit.tab.get_by_role("button", name="Play")).to_have_count(1)


def test_a_page_plays_once_when_it_opens_unless_motion_is_to_be_reduced(browser: Any, address: str) -> None:
    expect = importlib.import_module("playwright.sync_api").expect
    page = Visit(browser, address, motion="no-preference")
    expect(page.tab.get_by_role("button", name="Pause")).to_have_count(1)
    expect(page.tab.get_by_role("button", name="Play")).to_have_count(1)
    scrubber = page.tab.get_by_label("Step", exact=True)
    assert scrubber.input_value() == scrubber.get_attribute("max")
    page.context.close()


def test_any_two_pictures_lie_under_a_divider_that_moves_by_pointer_and_by_keyboard(visit: Visit) -> None:
    assert visit.source(".compare img.left") == visit.source("img[data-picture='initial']")
    assert visit.source(".compare img.right") == visit.source("img[data-picture='final-0']")
    visit.tab.get_by_label("Left", exact=True).select_option(label="result of pixel L2")
    assert visit.source(".compare img.left") == visit.source("img[data-picture='final-1']")
    visit.tab.get_by_label("Right", exact=True).select_option(label="error of loi (ours)")
    assert visit.source(".compare img.right") == visit.source("img[data-picture='error-0']")
    visit.tab.get_by_label("Right", exact=True).select_option("scrubber")
    visit.tab.get_by_label("Step", exact=True).fill("1")
    assert visit.source(".compare img.right") == visit.source("img.shown")
    divider = visit.tab.get_by_label("Divider")
    clip = "getComputedStyle(document.querySelector('.compare img.left')).clipPath"
    divider.fill("25")
    assert "75%" in visit.tab.evaluate(clip)
    divider.press("ArrowRight")
    assert "74%" in visit.tab.evaluate(clip)
    box = visit.tab.locator(".compare .over").bounding_box()
    visit.tab.mouse.click(box["x"] + 0.9 * box["width"], box["y"] + 0.5 * box["height"])
    assert divider.input_value() == "90"


def test_downloads_are_the_files_of_the_folder(visit: Visit, fitted: Path, tmp_path: Path) -> None:
    for name in ("history.csv", "scales.csv", "parameters.json", "final.png", "target.png"):
        with visit.tab.expect_download() as waiting:
            visit.tab.get_by_role("link", name=name).click()
        waiting.value.save_as(tmp_path / name)
        assert waiting.value.suggested_filename == f"one-disk-{name}"
        assert (tmp_path / name).read_bytes() == (fitted / name).read_bytes()
    assert visit.tab.get_by_role("link", name="fit.webp").count() == 1


def barriers(visit: Visit) -> list[str]:
    """Return the accessibility violations that axe finds, each with its first element."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright")
    violations = axe.Axe().run(visit.tab).response["violations"]
    return [f"{violation['id']}: {violation['nodes'][0]['html']}" for violation in violations]


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_report_is_accessible_and_nothing_overflows(browser: Any, address: str, scheme: str) -> None:
    visit = Visit(browser, address, width=390, scheme=scheme)
    visit.tab.evaluate("document.querySelectorAll('details').forEach(details => { details.open = true; })")
    assert barriers(visit) == []
    for width in (390, 1600):
        visit.tab.set_viewport_size({"width": width, "height": 1000})
        assert visit.tab.evaluate("document.documentElement.scrollWidth") <= width
    assert visit.logged == []
    visit.context.close()


def test_pictures_charts_and_tables_are_there_without_scripts(browser: Any, address: str) -> None:
    visit = Visit(browser, address, width=390, script=False)
    for key in ("initial", "target", "final-0", "error-0", "final-1"):
        assert visit.tab.locator(f"img[data-picture='{key}']").is_visible()
    assert visit.tab.locator("figure.chart svg").count() >= 4
    assert visit.tab.get_by_role("table").first.is_visible()
    assert not visit.tab.locator(".tools").is_visible()
    visit.context.close()


def test_the_tools_of_each_run_on_a_page_of_several_are_independent(browser: Any, fitted: Path, tmp_path: Path) -> None:
    page = tmp_path / "both.html"
    assert main(["report", str(fitted), str(fitted), "--output", str(page)]) == 0
    visit = Visit(browser, page.as_uri(), width=390)
    second = visit.tab.locator("section.run").nth(1)
    first = visit.source("section.run >> nth=0 >> img.shown")
    second.get_by_label("Step", exact=True).fill("0")
    assert second.locator("img.shown").get_attribute("src") != first
    assert visit.source("section.run >> nth=0 >> img.shown") == first
    assert barriers(visit) == []
    assert visit.tab.evaluate("document.documentElement.scrollWidth") <= 390
    assert visit.logged == []
    visit.context.close()


def test_scripts_in_the_texts_of_files_are_shown_and_not_run(browser: Any, copied: Path) -> None:
    bad = "</script><script>document.title = 'run'</script><img src=x onerror=\"document.title='run'\">"
    result = json.loads((copied / "result.json").read_text())
    result |= {"title": bad, "scene": bad, "command": bad, "notes": [bad], "views": [bad], "plan": bad}
    result |= {"environment": {"python": bad, "packages": {bad: bad}}, "effects": {"a": True}, "truth": {bad: [1]}}
    result["accuracy"] = {"name": bad, "tolerance": 0.5, "plan": bad}
    result["trials"][0] |= {"error": bad, "parameter_errors": {bad: 1.0}, "learning_rates": {bad: 1.0}}
    (copied / "result.json").write_text(json.dumps(result))
    history = (copied / "history.csv").read_text()
    (copied / "history.csv").write_text(history.replace("positions[0]", '"' + bad.replace('"', '""') + '"'))
    assert main(["report", str(copied)]) == 0
    visit = Visit(browser, (copied / "report.html").as_uri())
    assert visit.tab.title() == bad
    assert visit.tab.locator("h1").text_content() == bad
    assert visit.tab.locator("figure.chart h3", has_text=bad).count() == 1
    assert visit.tab.locator("img[src=x]").count() == 0
    assert visit.logged == []
    visit.context.close()


def test_the_page_of_a_watched_fit_reloads_itself_until_it_is_the_report(
    browser: Any, scene: Path, tmp_path: Path
) -> None:
    codes, log = [], tmp_path / "log.txt"
    copy = scene.parent / "watched.toml"
    copy.write_text(scene.read_text().replace('"result"', '"watched"').replace('["pixel_l2"]', "[]"))
    arguments = ["fit", str(copy), "--steps", "1500", "--watch", "--json"]
    with pytest.MonkeyPatch.context() as patch, log.open("w") as stream:
        patch.setattr("sys.stderr", stream)
        fit = threading.Thread(target=lambda: codes.append(main(arguments)), daemon=True)
        fit.start()
        while not (address := re.search(r"file://\S+", log.read_text())):
            fit.join(0.05)
            assert fit.is_alive()
        visit = Visit(browser, address[0], width=390)
        assert "PSNR" in visit.tab.locator(".verdict").text_content()
        assert visit.tab.locator("img").count() == 2
        assert visit.tab.evaluate("document.documentElement.scrollWidth") <= 390
        assert barriers(visit) == []
        visit.tab.wait_for_selector("section.run", timeout=60_000)
        fit.join(30.0)
    assert codes[0] in FINISHED
    assert visit.tab.title() == "One disk"
    assert visit.logged == []
    assert all(url.startswith((address[0], "data:")) for url in visit.requests)
    visit.context.close()
    shutil.rmtree(scene.parent / "watched")
