"""What the documentation prints can be printed again."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]


def test_every_promised_tolerance_is_kept() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "examples.checks"], capture_output=True, text=True, cwd=ROOT, check=True
    )
    rows = [line.split(" | ")[0].removeprefix("| ") for line in done.stdout.splitlines()[2:]]
    documented = (ROOT / "docs" / "mathematics.md").read_text()
    assert len(rows) == 10
    assert all(f"| {name} | " in documented for name in rows)


def test_the_numpy_snippet_of_the_readme_is_six_lines_and_runs() -> None:
    text = (ROOT / "README.md").read_text()
    snippet = text.split("```python\n")[1].split("```")[0]
    assert len([line for line in snippet.splitlines() if line]) == 6
    setup = (
        "from loi_core.renderers import Disks\n"
        "renderer = Disks(16, 16, [[5.0, 9.0]], 3.0, [[1.0, 0.5, 0.2]])\n"
        "params = renderer.parameters()\n"
        "photograph = renderer.render({**params, 'positions': params['positions'][:, ::-1]})\n"
        "height, width = 16, 16\n"
        "update = lambda params, gradient: {k: params[k] - 10.0 * gradient[k] for k in params}\n"
    )
    scope: dict[str, object] = {}
    exec(setup + snippet.replace("range(200)", "range(3)"), scope)  # noqa: S102 - the README's own code
    assert float(str(scope["value"])) > 0.0
