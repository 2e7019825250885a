"""A report in a real browser: what moves moves, nothing is fetched, and everybody can read it."""

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
    """A page that is open, what it has logged, and what it has asked for."""

    def __init__(self, browser: Any, address: str, *, width: int = 1600, scheme: str = "light", script: bool = True):
        self.context = browser.new_context(
            viewport={"width": width, "height": 1000}, color_scheme=scheme, java_script_enabled=script
        )
        self.tab = self.context.new_page()
        self.logged: list[str] = []
        self.asked: list[str] = []
        self.tab.on("console", lambda message: self.logged.append(message.text))
        self.tab.on("pageerror", lambda error: self.logged.append(str(error)))
        self.tab.on("request", lambda request: self.asked.append(request.url))
        self.tab.goto(address)

    def source(self, selector: str) -> str:
        return str(self.tab.locator(selector).first.get_attribute("src"))


@pytest.fixture(scope="module")
def address(fitted: Path) -> str:
    return (fitted / "report.html").as_uri()


@pytest.fixture
def visit(browser: Any, address: str) -> Iterator[Visit]:
    one = Visit(browser, address)
    yield one
    assert one.logged == []
    assert [url for url in one.asked if not url.startswith("data:")] == [address]
    one.context.close()


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
    assert visit.tab.locator(".said").text_content().startswith("step ")


def test_the_scrubber_moves_the_line_of_every_chart_and_what_they_read(visit: Visit) -> None:
    def read() -> tuple[list[str], list[str]]:
        lines = visit.tab.locator("line.now").evaluate_all("each => each.map(one => one.getAttribute('x1'))")
        return lines, visit.tab.locator(".legend .at").all_text_contents()

    at_end = read()
    visit.tab.get_by_label("Step", exact=True).fill("0")
    at_start = read()
    assert len(set(at_start[0])) == 1
    assert len(at_start[0]) >= 4
    assert all(one != other for one, other in zip(at_start[0], at_end[0], strict=True))
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
    held = scrubber.input_value()
    assert 2 < int(held) < int(last)
    visit.tab.wait_for_timeout(300)
    assert scrubber.input_value() == held
    scrubber.focus()
    scrubber.press(" ")
    expect(scrubber).to_have_value(last)
    expect(visit.tab.get_by_role("button", name="Play")).to_have_count(1)


def test_any_two_pictures_lie_under_a_divider_that_moves_by_pointer_and_by_keyboard(visit: Visit) -> None:
    assert visit.source(".compare img.left") == visit.source("img[data-picture='final-0']")
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


def test_what_a_page_hands_out_is_what_the_folder_holds(visit: Visit, fitted: Path, tmp_path: Path) -> None:
    for name in ("history.csv", "scales.csv", "parameters.json", "final.png", "target.png"):
        with visit.tab.expect_download() as waiting:
            visit.tab.get_by_role("link", name=name).click()
        waiting.value.save_as(tmp_path / name)
        assert waiting.value.suggested_filename == f"one-disk-{name}"
        assert (tmp_path / name).read_bytes() == (fitted / name).read_bytes()
    assert visit.tab.get_by_role("link", name="fit.webp").count() == 1


def barriers(visit: Visit) -> list[str]:
    """What keeps somebody from reading a page, as axe finds it, with the first place of each."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright")
    return [f"{one['id']}: {one['nodes'][0]['html']}" for one in axe.Axe().run(visit.tab).response["violations"]]


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_everybody_can_read_it_and_nothing_overflows(browser: Any, address: str, scheme: str) -> None:
    visit = Visit(browser, address, width=390, scheme=scheme)
    visit.tab.evaluate("document.querySelectorAll('details').forEach(one => { one.open = true; })")
    assert barriers(visit) == []
    for width in (390, 1600):
        visit.tab.set_viewport_size({"width": width, "height": 1000})
        assert visit.tab.evaluate("document.documentElement.scrollWidth") <= width
    assert visit.logged == []
    visit.context.close()


def test_pictures_charts_and_tables_are_there_without_scripts(browser: Any, address: str) -> None:
    visit = Visit(browser, address, width=390, script=False)
    for one in ("initial", "target", "final-0", "error-0", "final-1"):
        assert visit.tab.locator(f"img[data-picture='{one}']").is_visible()
    assert visit.tab.locator("figure.chart svg").count() >= 4
    assert visit.tab.get_by_role("table").first.is_visible()
    assert not visit.tab.locator(".tools").is_visible()
    visit.context.close()


def test_a_page_of_several_runs_has_its_controls_apart(browser: Any, fitted: Path, tmp_path: Path) -> None:
    page = tmp_path / "both.html"
    assert main(["report", str(fitted), str(fitted), "--output", str(page)]) == 0
    visit = Visit(browser, page.as_uri(), width=390)
    second = visit.tab.locator("section.run").nth(1)
    before = visit.source("section.run >> nth=0 >> img.shown")
    second.get_by_label("Step", exact=True).fill("0")
    assert second.locator("img.shown").get_attribute("src") != before
    assert visit.source("section.run >> nth=0 >> img.shown") == before
    assert barriers(visit) == []
    assert visit.tab.evaluate("document.documentElement.scrollWidth") <= 390
    assert visit.logged == []
    visit.context.close()


def test_what_files_say_is_shown_and_not_obeyed(browser: Any, copied: Path) -> None:
    bad = "</script><script>document.title = 'obeyed'</script><img src=x onerror=\"document.title='obeyed'\">"
    told = json.loads((copied / "result.json").read_text())
    told |= {"title": bad, "scene": bad, "command": bad, "notes": [bad], "views": [bad], "plan": bad}
    told |= {"environment": {"python": bad, "packages": {bad: bad}}, "effects": {"a": True}, "truth": {bad: [1]}}
    told["accuracy"] = {"name": bad, "tolerance": 0.5, "plan": bad}
    told["trials"][0] |= {"error": bad, "parameter_errors": {bad: 1.0}, "learning_rates": {bad: 1.0}}
    (copied / "result.json").write_text(json.dumps(told))
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


def test_the_page_of_a_fit_follows_it_and_becomes_its_report(browser: Any, scene: Path, tmp_path: Path) -> None:
    code, said = [], tmp_path / "said.txt"
    own = scene.parent / "watched.toml"
    own.write_text(scene.read_text().replace('"result"', '"watched"').replace('["pixel_l2"]', "[]"))
    with pytest.MonkeyPatch.context() as patch, said.open("w") as stream:
        patch.setattr("sys.stderr", stream)
        fit = threading.Thread(
            target=lambda: code.append(main(["fit", str(own), "--steps", "1000", "--watch", "--json"])), daemon=True
        )
        fit.start()
        while not (found := re.search(r"http://127\.0\.0\.1:[0-9]+/", said.read_text())):
            fit.join(0.05)
            assert fit.is_alive()
        visit = Visit(browser, found[0], width=390)
        visit.tab.wait_for_selector("#newest", state="visible")
        assert "PSNR" in visit.tab.locator(".now").text_content()
        assert visit.tab.evaluate("document.documentElement.scrollWidth") <= 390
        assert barriers(visit) == []
        visit.tab.wait_for_selector("section.run", timeout=60_000)
        fit.join(30.0)
    assert code[0] in FINISHED
    assert visit.tab.title() == "One disk"
    assert visit.logged == []
    assert all(url.startswith((found[0], "data:")) for url in visit.asked)
    visit.context.close()
    shutil.rmtree(scene.parent / "watched")
