"""Looks at every page of the built site in a browser: ``python docs/site_pictures.py``, which ``make docs`` calls.

A picture of each, on a phone and on a wide screen, light and dark, goes to ``docs/_build/pictures``. Pages that are
wider than the window, or in which a script fails, are named, and the exit status is 1. Needs playwright and a Chromium.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from typing import Final, Literal

BUILT: Final = Path(__file__).parent / "_build"
BROWSERS: Final = ("chromium", "chromium-browser", "google-chrome")
SCHEMES: Final[tuple[Literal["light", "dark"], ...]] = ("light", "dark")
WIDTHS: Final = (390, 1600)
MADE: Final = ("genindex.html", "search.html", "py-modindex.html")  # by Sphinx, with nothing of ours in them


def main() -> int:
    """Look at all pages; 1 if one of them is at fault."""
    try:
        from playwright.sync_api import sync_playwright
    except ModuleNotFoundError:
        print("no playwright: nobody looked at the pages in a browser")
        return 0
    browser_path = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser_path is None:
        print(f"none of {', '.join(BROWSERS)} is installed: nobody looked at the pages in a browser")
        return 0
    pages = [one for one in sorted((BUILT / "html").rglob("*.html")) if one.name not in MADE]
    faults = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=browser_path, args=["--no-sandbox"])
        for scheme in SCHEMES:
            for width in WIDTHS:
                context = browser.new_context(viewport={"width": width, "height": 1000}, color_scheme=scheme)
                tab = context.new_page()
                failed: list[str] = []
                tab.on("pageerror", lambda error, failed=failed: failed.append(str(error)))
                for page in pages:
                    name = page.relative_to(BUILT / "html").with_suffix("")
                    tab.goto(page.as_uri())
                    wide = int(tab.evaluate("document.documentElement.scrollWidth"))
                    tab.screenshot(path=BUILT / "pictures" / f"{width}-{scheme}" / f"{name}.png")
                    found = [f"{wide} pixels wide"] if wide > width else []
                    faults += [f"{name}, at {width} pixels, {scheme}: {one}" for one in (*found, *failed)]
                    failed.clear()
                context.close()
        browser.close()
    print("\n".join(faults) or f"{len(pages)} pages fit {' and '.join(map(str, WIDTHS))} pixels, light and dark")
    return int(bool(faults))


if __name__ == "__main__":
    sys.exit(main())
