"""``loi demo``: scenes that are made here and recovered from their image files; two of them need more than NumPy."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

from loi_core.cli.bundled import make_ball, make_crate, make_disks, make_photograph
from loi_core.cli.fit import print_summary, run_and_write
from loi_core.errors import RendererNotFoundError
from loi_core.io.files import check_writable
from loi_core.report import write_index, write_page
from loi_core.scenes.reading import load_scene
from loi_core.support.wording import printable

__all__ = ["run_demo"]

OTHERS: Final[Mapping[str, tuple[str, Callable[[Path], None]]]] = {
    "Mitsuba": ("ball", make_ball),
    "torch": ("crate", make_crate),
}
"""By what it needs, the folder of a scene and what makes it."""


def run_demo(output: Path, *, as_json: bool) -> bool:
    """Make the scenes in `output`, fit them, and write one page of pictures; False if a fit ended early.

    Where Mitsuba or torch is not installed, its scene is left out, and a line says so.
    """
    check_writable("--output", output)
    folders = [output / "disks", output / "photograph"]
    make_disks(folders[0])
    make_photograph(folders[1])
    for needed, (name, make) in OTHERS.items():
        try:
            make(output / name)
        except RendererNotFoundError as error:
            print(f"loi: the scene with {needed} is left out; {printable(str(error))}", file=sys.stderr)
        else:
            folders.append(output / name)
    results: list[dict[str, Any]] = []
    for folder in folders:
        scene = load_scene(folder / "scene.toml")
        result = run_and_write(scene, command="loi demo")
        write_page(scene.output)
        results.append(result)
        if not as_json:
            print_summary(result)
            print()
    page = write_index(output / "index.html", [folder / "result" for folder in folders], "loi demo")
    if as_json:
        print(json.dumps({"scenes": results, "report": str(page)}, indent=2))
    else:
        print(f"open {page} in a browser; change and rerun a scene with `loi fit {folders[0] / 'scene.toml'}`")
    return not any(trial["error"] for result in results for trial in result["trials"])
