"""Write the tables and pictures of stability.md: ``python docs/results/stability.py [BACKEND ...]``, all by default.

It runs what ``loi doctor --stability`` runs, and draws every case that has something to look at: the image, its
reference, and the gradient that the image gets.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any, Final

import numpy as np
from PIL import Image
from tqdm import tqdm

from loi_core import LOIObjective
from loi_core.plugins.registry import BACKENDS
from loi_core.stability import HardCase, StabilityRow, hard_cases, stability_rows

FOLDER: Final = Path(__file__).parent
PAGE: Final = FOLDER / "stability.md"
PICTURES: Final = FOLDER / "images" / "stability"
ZOOM: Final = 6
GAP: Final = 4
BETWEEN: Final = re.compile(r"(<!-- cases: begin -->\n).*?(<!-- cases: end -->)", re.DOTALL)

Host = np.ndarray[Any, Any]


def main(names: list[str]) -> None:
    """Run, draw and write."""
    backends = {name: BACKENDS.load(name)() for name in names}
    bar = tqdm(disable=None)
    rows: dict[str, list[StabilityRow]] = {}

    def progress(total: int, what: str) -> None:
        bar.total = total
        bar.set_postfix_str(what)
        bar.update()

    for row in stability_rows(hard_cases(), backends, progress):
        rows.setdefault(row.case, []).append(row)
    bar.close()
    sections = [_counts(rows)]
    for case in hard_cases():
        sections.append(f"### {case.name[0].upper()}{case.name[1:]}\n")
        if strip := _draw(case):
            sections.append(f"![{case.name}: image, reference, gradient](images/stability/{strip})\n")
        sections.append(f"*Danger:* {case.danger}.\n\n*Answer:* {case.answer}.\n")
        sections.append(_table(rows[case.name]))
    page = PAGE.read_text()
    if not BETWEEN.search(page):
        msg = f"{PAGE} has no place for the cases"
        raise ValueError(msg)
    PAGE.write_text(BETWEEN.sub(lambda found: found[1] + "\n" + "\n".join(sections) + "\n" + found[2], page))


def _counts(rows: dict[str, list[StabilityRow]]) -> str:
    everything = [row for some in rows.values() for row in some]
    verdicts = {
        verdict: sum(row.verdict == verdict for row in everything)
        for verdict in ("ok", "loose", "refused", "unsupported", "FAILED")
    }
    counts = ", ".join(f"{count} {verdict}" for verdict, count in verdicts.items())
    answered = [row for row in everything if row.verdict in ("ok", "loose")]
    names = ", ".join(dict.fromkeys(row.backend for row in everything))
    worst = max((row.gradient_error / row.gradient_bound for row in answered if row.gradient_bound > 0.0), default=0.0)
    loss = max((row.loss_error / row.loss_bound for row in answered if row.loss_bound > 0.0), default=0.0)
    return (
        f"{len(rows)} cases, {len(everything)} rows on {names}: {counts}.\n"
        f"The worst error is {loss:.2f} of its bound for a loss, and {worst:.2f} for a gradient.\n"
    )


def _table(rows: list[StabilityRow]) -> str:
    refusals = [row for row in rows if row.verdict in ("refused", "unsupported")]
    answers = [row for row in rows if row not in refusals]
    lines = []
    if answers:
        lines += [
            "| backend | dtype | loss | error | bound | gradient | error | bound | |",
            "|---|---|---|---|---|---|---|---|---|",
        ]
        for row in answers:
            numbers = (
                row.loss,
                row.loss_error,
                row.loss_bound,
                row.gradient_size,
                row.gradient_error,
                row.gradient_bound,
            )
            verdict = row.verdict if row.verdict != "FAILED" else f"FAILED: {row.detail}"
            lines.append(
                f"| {row.backend} | {row.dtype} | "
                + " | ".join(f"{number:.1e}" for number in numbers)
                + f" | {verdict} |"
            )
        lines.append("")
    texts: dict[tuple[str, str], list[str]] = {}
    for row in refusals:
        texts.setdefault((row.verdict, row.detail), []).append(f"{row.backend} {row.dtype}")
    for (verdict, detail), where in texts.items():
        lines.append(f"- {verdict} by {', '.join(where)}: `{detail}`")
    return "\n".join(lines) + "\n"


def _draw(case: HardCase) -> str:
    """Write the strip of a case; its name, or nothing if there is nothing to see."""
    image, reference = case.make()
    while image.ndim > 3:
        image, reference = image[-1], reference[-1] if reference.ndim > 3 else reference
    if case.layout is not None or min(image.shape[:2]) < 4 or image.shape[0] > 64 or image.shape[1] > 64:
        return ""
    _, gradient = LOIObjective(reference, case.scales, nan_policy="mask").value_and_grad(image)
    strip = [_shown(image, case), _shown(reference, case), _signed(gradient)]
    gap = np.full((strip[0].shape[0] * ZOOM, GAP, 3), 255, np.uint8)
    tiles = [tile for panel in strip for tile in (np.kron(panel, np.ones((ZOOM, ZOOM, 1), np.uint8)), gap)][:-1]
    PICTURES.mkdir(parents=True, exist_ok=True)
    name = re.sub(r"[^a-z0-9]+", "-", case.name.lower()).strip("-") + ".png"
    Image.fromarray(np.concatenate(tiles, axis=1)).save(PICTURES / name, optimize=True)
    return name


def _shown(image: Host, case: HardCase) -> Host:
    """Return the image within the bounds, with magenta for pixels that are not finite."""
    lower, upper = case.scales.bounds
    colours = _three(np.clip((np.nan_to_num(image) - lower) / (upper - lower), 0.0, 1.0))
    bad = ~np.all(np.isfinite(image), axis=-1)
    colours[bad] = (1.0, 0.0, 1.0)
    return np.asarray(np.round(255.0 * colours), dtype=np.uint8)


def _signed(gradient: Host) -> Host:
    """Grey is 0; brighter wants to be brighter."""
    largest = float(np.abs(gradient).max())
    return np.asarray(np.round(127.5 - 127.5 * _three(gradient) / (largest or 1.0)), dtype=np.uint8)


def _three(image: Host) -> Host:
    """The first three channels; the last one again where there are fewer."""
    channels = [image[..., min(index, image.shape[-1] - 1)] for index in range(3)]
    return np.stack(channels, axis=-1)


if __name__ == "__main__":
    main(sys.argv[1:] or [info.name for info in BACKENDS.available() if info.state == "ready"])
