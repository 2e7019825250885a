"""Draw the pictures of docs/report.md: ``python docs/screenshots.py REPORT.html``, a page written by `loi demo`.

Needs playwright and a Chromium.
"""

from __future__ import annotations

import io
import shutil
import sys
from pathlib import Path
from typing import Final, Literal

from PIL import Image
from playwright.sync_api import sync_playwright

IMAGES: Final = Path(__file__).parent / "images" / "report"
BROWSERS: Final = ("chromium", "chromium-browser", "google-chrome")
SCHEMES: Final[tuple[Literal["light", "dark"], ...]] = ("light", "dark")
HEIGHTS: Final = {390: 2300, 1600: 2000}
SHOWN_STEP: Final = 6  # index of a recorded step
MAX_COLOURS: Final = 256  # keeps files small


def main(page: Path, folder: Path) -> None:
    """Show the upper part of a report on a phone and on a wide screen, light and dark, a quarter of the way."""
    browser_path = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser_path is None:
        sys.exit(f"none of {', '.join(BROWSERS)} is installed")
    folder.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=browser_path, args=["--no-sandbox"])
        for scheme in SCHEMES:
            for width, height in HEIGHTS.items():
                context = browser.new_context(viewport={"width": width, "height": 1000}, color_scheme=scheme)
                tab = context.new_page()
                tab.goto(page.resolve().as_uri())
                tab.get_by_label("Left", exact=True).select_option("initial")
                tab.get_by_label("Right", exact=True).select_option("final-0")
                tab.get_by_label("Step", exact=True).fill(str(SHOWN_STEP))
                screenshot = tab.screenshot(full_page=True, clip={"x": 0, "y": 0, "width": width, "height": height})
                shown = Image.open(io.BytesIO(screenshot)).convert("RGB")
                small = shown.quantize(MAX_COLOURS, dither=Image.Dither.NONE)
                small.save(folder / f"{width}-{scheme}.png", optimize=True)
                context.close()
        browser.close()


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]) if len(sys.argv) > 2 else IMAGES)
