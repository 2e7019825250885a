"""``loi demo``: recover the bundled scenes from their images; two of them need more than NumPy."""

from __future__ import annotations

import argparse
import json
import sys
from typing import Any, Final

from loi_core.cli.bundled import copy_scene
from loi_core.cli.codes import DONE, FAILED
from loi_core.cli.fit import print_summary, run_and_write
from loi_core.errors import RendererNotFoundError
from loi_core.io.files import check_writable
from loi_core.report import write_index, write_page
from loi_core.scenes.reading import load_scene
from loi_core.support.wording import printable

__all__ = ["run"]

REQUIREMENTS: Final = {"disks": "NumPy", "photograph": "NumPy", "ball": "Mitsuba", "crate": "torch"}
"""The package that renders each bundled scene."""


def run(options: argparse.Namespace) -> int:
    """Fit the bundled scenes and write one page of their reports; FAILED if a fit ended early.

    A scene whose renderer is not installed is left out, and one line on standard error says how to install it.
    """
    output = options.output
    check_writable("--output", output)
    scene_files = []
    for name, package in REQUIREMENTS.items():
        try:
            scene_files.append(copy_scene(name, output / name))
        except RendererNotFoundError as error:
            print(f"loi: the scene with {package} is left out; {printable(str(error))}", file=sys.stderr)
    results: list[dict[str, Any]] = []
    for path in scene_files:
        scene = load_scene(path)
        result = run_and_write(scene, command="loi demo")
        write_page(scene.output)
        results.append(result)
        if not options.json:
            print_summary(result)
            print()
    page = write_index(output / "index.html", [path.parent / "result" for path in scene_files], "loi demo")
    if options.json:
        print(json.dumps({"scenes": results, "report": str(page)}, indent=2))
    else:
        print(f"open {page} in a browser; change and rerun a scene with `loi fit {scene_files[0]}`")
    return FAILED if any(trial["error"] for result in results for trial in result["trials"]) else DONE
