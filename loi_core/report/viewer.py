"""The pictures of a run: side by side, under a divider, step by step, and what scales and effects do to them."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any, Final

from loi_core.io.result_folder import FRAME_NAME, HISTORY_FILE
from loi_core.report.kept import Pictures
from loi_core.report.output import FRAMES_FOLDER, effect_file
from loi_core.report.plots import LABELS
from loi_core.report.records import read_columns
from loi_core.report.scales import MOMENTS, gradient_file, scale_name
from loi_core.support.values import real_number

__all__ = ["MOST_TABLE", "effects", "frame_files", "gradients", "viewer"]

MOST_FRAMES: Final = 1000
MOST_FRAME_BYTES: Final = 2**25  # of all frames on a page: of larger ones some are left out
MOST_GRADIENT_BYTES: Final = 2**25
MOST_TABLE: Final = 2**26  # bytes of a CSV file that is read
EFFECT_NAME: Final = re.compile(r"[\w -]{1,80}")


def viewer(pictures: Pictures, folder: Path, trials: Sequence[Mapping[str, Any]], run: int) -> str:
    """Start, target, result and error of every objective, and the frames of the first, with what compares them.

    Without scripts the pictures stand side by side.
    """
    named = {"initial": "start", "target": "target"}
    shown = [pictures.figure(f"{key}.png", label, key=key) for key, label in named.items()]
    for index, trial in enumerate(trials):
        name = trial["objective"]
        label = LABELS.get(name, name)
        own, ours = ("", ' class="ours"') if index == 0 else (f"compare/{name}/", "")
        for kind, text in (("final", f"result of {label}"), ("error", f"error of {label}")):
            key = f"{kind}-{index}"
            alt = f"|final - target| of {label}, brighter where they differ more" if kind == "error" else ""
            named[key] = text
            shown.append(pictures.figure(f"{own}{kind}.png", text, ours, key=key, alt=alt))
    there = [key for key, figure in zip(named, shown, strict=True) if figure]
    frames = _frames(pictures, folder)
    steps = [step for step, _ in frames]
    gallery = f'<h2>Pictures</h2><div class="row gallery">{"".join(shown)}</div>' if there else ""
    film = "".join(figure for _, figure in frames)
    summary = f"<summary>{len(frames)} recorded steps</summary>"
    strip = f'<details class="steps">{summary}<div class="row film">{film}</div></details>'
    options = [(key, named[key]) for key in there]
    tools = _divider(options, steps, run) + _scrubber(steps, run)
    return f'<div class="tools" hidden>{tools}</div>{gallery}{strip if frames else ""}'


def frame_files(pictures: Pictures, folder: Path) -> dict[int, str]:
    """The pictures of the way, by step: as many as a page can hold, evenly."""
    names = sorted(path.name for path in (folder / FRAMES_FOLDER).glob("*.png") if FRAME_NAME.fullmatch(path.name))
    files = {int(Path(name).stem): f"{FRAMES_FOLDER}/{name}" for name in names[:MOST_FRAMES]}
    total = sum(map(pictures.size, files.values()))
    every = max(1, math.ceil(total / MOST_FRAME_BYTES))
    return dict(sorted(files.items())[::every])


def _frames(pictures: Pictures, folder: Path) -> list[tuple[int, str]]:
    """Each frame as a figure that says its step, its value and its PSNR."""
    columns = read_columns(pictures.text(HISTORY_FILE, MOST_TABLE))
    values = dict(zip(columns.get("step", ()), columns.get("value", ()), strict=False))
    quality = dict(zip(columns.get("step", ()), columns.get("psnr", ()), strict=False))
    found = []
    for step, name in frame_files(pictures, folder).items():
        psnr, value = quality.get(step, math.nan), values.get(step, math.nan)
        told = [f"step {step}", *([f"{psnr:.1f} dB"] if math.isfinite(psnr) else [])]
        more = f' data-step="{step}" data-value="{value:.4g}"'
        figure = pictures.figure(name, ", ".join(told), f' class="frame"{more}', key=f"step-{step}")
        if figure:
            found.append((step, figure))
    return found


def _divider(options: Sequence[tuple[str, str]], steps: Sequence[int], run: int) -> str:
    """What puts one picture over another, up to a line."""
    if len(options) < 2:
        return ""
    keys = [key for key, _ in options]
    left = "final-0" if "final-0" in keys else keys[0]
    right = "target" if "target" in keys and left != "target" else next(key for key in keys if key != left)
    return (
        '<figure class="compare panel"><h2>Compare two pictures</h2><div class="choice">'
        f"{_choice('left', left, options, steps, run)}{_choice('right', right, options, steps, run)}</div>"
        '<div class="over"><img class="right" alt=""><img class="left" alt="">'
        '<span class="bar" aria-hidden="true"></span></div>'
        f'<label class="wide" for="divider-{run}">Divider</label>'
        f'<input class="divider" id="divider-{run}" type="range" min="0" max="100" value="50"></figure>'
    )


def _choice(side: str, chosen: str, options: Sequence[tuple[str, str]], steps: Sequence[int], run: int) -> str:
    def listed(key: str, label: str) -> str:
        return f'<option value="{escape(key)}"{" selected" if key == chosen else ""}>{escape(label)}</option>'

    inner = "".join(listed(key, label) for key, label in options)
    if steps:
        moving = listed("scrubber", "the step that is shown")
        each = "".join(listed(f"step-{step}", f"step {step}") for step in steps)
        inner += f'<optgroup label="steps">{moving}{each}</optgroup>'
    name = f"{side}-{run}"
    return f'<div><label for="{name}">{side.title()}</label><select class="{side}" id="{name}">{inner}</select></div>'


def _scrubber(steps: Sequence[int], run: int) -> str:
    """What shows the frames one after another."""
    if not steps:
        return ""
    return (
        '<figure class="player panel"><h2>Follow the fit</h2><p class="choice said"></p>'
        '<div class="over"><img class="shown" alt=""></div>'
        f'<label class="wide" for="scrubber-{run}">Step</label><div class="play"><button type="button">Play</button>'
        f'<input class="scrubber" id="scrubber-{run}" type="range" min="0" max="{len(steps) - 1}" value="0">'
        "</div></figure>"
    )


def gradients(pictures: Pictures, result: Mapping[str, Any]) -> list[str]:
    """What each scale pulls at, at the start and at the end; nothing if that was not written."""
    scales = result.get("scales")
    if not isinstance(scales, list):
        return []
    rows, left = [], MOST_GRADIENT_BYTES
    for scale in scales:
        given = scale if isinstance(scale, Mapping) else {}
        sigma, alpha, beta = (real_number(given.get(name)) for name in ("sigma", "alpha", "beta"))
        if not all(map(math.isfinite, (sigma, alpha, beta))):
            continue
        pull = given.get("pull")
        strengths = [real_number(pull.get(moment)) if isinstance(pull, Mapping) else math.nan for moment in MOMENTS]
        figures = []
        for moment, strength in zip(MOMENTS, strengths, strict=True):
            file = gradient_file(moment, sigma, alpha, beta)
            left -= pictures.size(file)
            if left < 0:
                break
            told = f"at the {moment}"
            if moment == "end" and strengths[0] > 0.0 and math.isfinite(strength / strengths[0]):
                told += f", {strength / strengths[0]:.2g} times as strong"
            name = scale_name(sigma, alpha, beta)
            figures.append(pictures.figure(file, told, alt=f"what {name} pulls at, {told}"))
        head = f"<h3>{scale_name(sigma, alpha, beta)}</h3>"
        if any(figures):
            rows.append(f'<div class="pull">{head}<div class="row">{"".join(figures)}</div></div>')
    if not rows:
        return []
    told = (
        "The gradient of each scale alone by the image, against its sign: brighter where the scale wants the image "
        "brighter, darker where darker, mid grey where it wants nothing. The strongest pull of each picture is black "
        "or white."
    )
    return [f'<h2>What each scale pulls at</h2><p class="soft">{told}</p><div class="row pulls">{"".join(rows)}</div>']


def effects(pictures: Pictures, result: Mapping[str, Any]) -> list[str]:
    """What each effect changes in the image at the start, and the plan; nothing if the renderer plans nothing."""
    plan, switched = result.get("plan"), result.get("effects")
    if not isinstance(plan, str) or not isinstance(switched, Mapping):
        return []
    shown = [
        pictures.figure(effect_file(name), f"{name}: {'on' if on else 'off'}")
        for name, on in switched.items()
        if EFFECT_NAME.fullmatch(name)
    ]
    row = f'<div class="row">{"".join(shown)}</div>'
    said = f'<pre class="scroll" role="group" tabindex="0" aria-label="Plan of effects">{escape(plan)}</pre>'
    return [f"<h2>Effects: how each changes the image along the first descent</h2>{row}{said}"]
