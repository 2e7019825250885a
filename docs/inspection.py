"""Draw the pictures of docs/inspect.md: ``python docs/inspection.py``; needs a Chromium and playwright.

Takes screenshots of `loi inspect` for Matplotlib's portrait and the disks of the demo.
"""

from __future__ import annotations

import io
import shutil
import tempfile
from pathlib import Path
from typing import Final

from matplotlib import get_data_path
from PIL import Image
from playwright.sync_api import Page, sync_playwright

from loi_core.cli.bundled import copy_scene
from loi_core.cli.main import main
from loi_core.io.images import write_png
from loi_core.scenes.experiment import Start
from loi_core.scenes.reading import load_scene

PICTURES: Final = Path(__file__).parent / "images" / "inspect"
SIZE: Final = (1100, 760)


def portrait(folder: Path) -> tuple[Path, Path]:
    """Write Grace Hopper (James S. Davis, U.S. Navy, public domain), and a shifted, rotated and darker copy."""
    source = Path(get_data_path()) / "sample_data" / "grace_hopper.jpg"
    photo, render = folder / "photo.jpg", folder / "render.png"
    shutil.copyfile(source, photo)
    with Image.open(photo) as picture:
        Image.eval(picture.rotate(-12, translate=(60, 20)), lambda value: int(0.8 * value)).save(render)
    return render, photo


def disks(folder: Path) -> tuple[Path, Path]:
    """Write the disks of the demo at their start, and their target."""
    write_png(folder / "render.png", Start.of(load_scene(copy_scene("disks", folder))).host)
    return folder / "render.png", folder / "target.png"


def inspected(image: Path, reference: Path) -> Path:
    """Inspect two images and return the page."""
    page = image.parent / "inspect.html"
    assert main(["inspect", str(image), str(reference), "--output", str(page)]) == 0
    return page


def photograph(page: Page, name: str, *, selector: str | None = None) -> None:
    """Write the window or one element as a PNG of few colours."""
    shot = page.locator(selector).screenshot() if selector else page.screenshot()
    picture = Image.open(io.BytesIO(shot)).convert("RGB").quantize(255, dither=Image.Dither.NONE)
    picture.save(PICTURES / name, optimize=True)


def point(page: Page, x: float, y: float) -> None:
    """Click a point of the picture, in fractions of its size."""
    page.wait_for_selector("#stage[data-ready]")
    box = page.locator("#backdrop").bounding_box()
    assert box is not None
    page.mouse.click(box["x"] + x * box["width"], box["y"] + y * box["height"])


def draw() -> None:
    """Draw all pictures."""
    PICTURES.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": SIZE[0], "height": SIZE[1]}, color_scheme="dark")
        page.goto(inspected(*portrait(Path(folder))).as_uri())
        point(page, 0.48, 0.42)
        page.locator("#look").evaluate("one => one.scrollIntoView()")
        photograph(page, "histograms.png")
        photograph(page, "isophotes.png", selector="#image-lines-0-0")
        page = browser.new_page(viewport={"width": SIZE[0], "height": SIZE[1]}, color_scheme="light")
        page.goto(inspected(*disks(Path(folder) / "disks")).as_uri())
        point(page, 0.2, 0.2)
        photograph(page, "scale.png", selector=".card >> nth=0")
        photograph(page, "strip.png", selector=".strip >> nth=0")
        browser.close()


if __name__ == "__main__":
    draw()
