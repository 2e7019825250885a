"""The pictures of a run: side by side, under a divider, by step, and the gradients of scales and effects."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any, Final

from loi_core.io.result_folder import FRAME_NAME, HISTORY_FILE
from loi_core.report.curves import MAX_TABLE_BYTES
from loi_core.report.document import scrollable
from loi_core.report.names import FRAMES_FOLDER, MOMENTS, effect_file, gradient_file, objective_label, scale_name
from loi_core.report.pictures import Pictures
from loi_core.report.tables import read_columns
from loi_core.support.values import real_number

__all__ = ["effects", "frame_files", "gradients", "viewer"]

MAX_FRAMES: Final = 1000
MAX_FRAME_BYTES: Final = 2**25  # of all frames on a page; larger frames are shown at fewer steps
MAX_GRADIENT_BYTES: Final = 2**25
EFFECT_NAME: Final = re.compile(r"[\w -]{1,80}")


def viewer(pictures: Pictures, folder: Path, trials: Sequence[Mapping[str, Any]], run: int) -> str:
    """Return start, target, results, errors and frames, and the tools to compare them.

    Without scripts the pictures stand side by side.
    """
    labels = {"initial": "start", "target": "target"}
    figures = [pictures.figure(f"{key}.png", label, key=key) for key, label in labels.items()]
    for index, trial in enumerate(trials):
        name = trial["objective"]
        label = objective_label(name)
        prefix, attributes = ("", ' class="ours"') if index == 0 else (f"compare/{name}/", "")
        labels |= {f"final-{index}": f"result of {label}", f"error-{index}": f"error of {label}"}
        figures.append(pictures.figure(f"{prefix}final.png", f"result of {label}", attributes, key=f"final-{index}"))
        alt = f"|final - target| of {label}, brighter where they differ more"
        figures.append(
            pictures.figure(f"{prefix}error.png", f"error of {label}", attributes, key=f"error-{index}", alt=alt)
        )
    options = [(key, label) for (key, label), figure in zip(labels.items(), figures, strict=True) if figure]
    frames = _frames(pictures, folder)
    steps = list(frames)
    tools = _divider(options, steps, run) + _player(steps, run)
    gallery = f'<h2>Pictures</h2><div class="row gallery">{"".join(figures)}</div>' if options else ""
    film = f'<div class="row film">{"".join(frames.values())}</div>'
    strip = f'<details class="steps"><summary>{len(frames)} recorded steps</summary>{film}</details>' if frames else ""
    return f'<div class="tools" hidden>{tools}</div>{gallery}{strip}'


def frame_files(pictures: Pictures, folder: Path) -> dict[int, str]:
    """Return the pictures of recorded steps, by step: evenly chosen, as many as a page holds."""
    names = sorted(path.name for path in (folder / FRAMES_FOLDER).glob("*.png") if FRAME_NAME.fullmatch(path.name))
    files = {int(Path(name).stem): f"{FRAMES_FOLDER}/{name}" for name in names[:MAX_FRAMES]}
    total = sum(map(pictures.size, files.values()))
    stride = max(1, math.ceil(total / MAX_FRAME_BYTES))
    return dict(sorted(files.items())[::stride])


def _frames(pictures: Pictures, folder: Path) -> dict[int, str]:
    """Return each frame as a figure with its step, objective and PSNR, by step."""
    columns = read_columns(pictures.text(HISTORY_FILE, MAX_TABLE_BYTES))
    values = dict(zip(columns.get("step", ()), columns.get("value", ()), strict=False))
    quality = dict(zip(columns.get("step", ()), columns.get("psnr", ()), strict=False))
    figures = {}
    for step, name in frame_files(pictures, folder).items():
        psnr, value = quality.get(step, math.nan), values.get(step, math.nan)
        caption = f"step {step}" + (f", {psnr:.1f} dB" if math.isfinite(psnr) else "")
        attributes = f' class="frame" data-step="{step}" data-value="{value:.4g}"'
        figure = pictures.figure(name, caption, attributes, key=f"step-{step}")
        if figure:
            figures[step] = figure
    return figures


def _divider(options: Sequence[tuple[str, str]], steps: Sequence[int], run: int) -> str:
    """Return the tool that shows one picture over another, up to a line."""
    if len(options) < 2:
        return ""
    keys = [key for key, _ in options]
    left = keys[0]  # the start, if the folder contains a picture of the start
    right = "final-0" if "final-0" in keys[1:] else keys[1]
    return (
        '<figure class="compare panel"><h2>Compare two pictures</h2><div class="choice">'
        f"{_choice('left', left, options, steps, run)}{_choice('right', right, options, steps, run)}</div>"
        '<div class="over"><img class="right" alt=""><img class="left" alt="">'
        '<span class="bar" aria-hidden="true"></span></div>'
        f'<label class="wide" for="divider-{run}">Divider</label>'
        f'<input class="divider" id="divider-{run}" type="range" min="0" max="100" value="50"></figure>'
    )


def _choice(position: str, chosen: str, options: Sequence[tuple[str, str]], steps: Sequence[int], run: int) -> str:
    def option(key: str, label: str) -> str:
        return f'<option value="{escape(key)}"{" selected" if key == chosen else ""}>{escape(label)}</option>'

    items = "".join(option(key, label) for key, label in options)
    if steps:
        frames = "".join(option(f"step-{step}", f"step {step}") for step in steps)
        items += f'<optgroup label="steps">{option("scrubber", "the current step")}{frames}</optgroup>'
    name = f"{position}-{run}"
    label = f'<label for="{name}">{position.title()}</label>'
    return f'<div>{label}<select class="{position}" id="{name}">{items}</select></div>'


def _player(steps: Sequence[int], run: int) -> str:
    """Return the tool that shows the frames one after another."""
    if not steps:
        return ""
    return (
        '<figure class="player panel"><h2>Follow the fit</h2><p class="choice caption"></p>'
        '<div class="over"><img class="shown" alt=""></div>'
        f'<label class="wide" for="scrubber-{run}">Step</label><div class="play"><button type="button">Play</button>'
        f'<input class="scrubber" id="scrubber-{run}" type="range" min="0" max="{len(steps) - 1}" value="0">'
        "</div></figure>"
    )


def gradients(pictures: Pictures, result: Mapping[str, Any]) -> list[str]:
    """Return the section of each scale's gradient at the start and at the end, if the folder has their pictures."""
    scales = result.get("scales")
    if not isinstance(scales, list):
        return []
    rows, remaining = [], MAX_GRADIENT_BYTES
    for scale in scales:
        entry = scale if isinstance(scale, Mapping) else {}
        sigma, alpha, beta = (real_number(entry.get(name)) for name in ("sigma", "alpha", "beta"))
        if not all(map(math.isfinite, (sigma, alpha, beta))):
            continue
        name, norms = scale_name(sigma, alpha, beta), entry.get("gradient_norm")
        first, last = (real_number(norms.get(m)) if isinstance(norms, Mapping) else math.nan for m in MOMENTS)
        growth = f", {last / first:.2g} times as strong" if first > 0.0 and math.isfinite(last / first) else ""
        figures = []
        for moment, caption in zip(MOMENTS, ("at the start", f"at the end{growth}"), strict=True):
            file = gradient_file(moment, sigma, alpha, beta)
            remaining -= pictures.size(file)
            if remaining < 0:
                break
            figures.append(pictures.figure(file, caption, alt=f"gradient of {name} {caption}"))
        if any(figures):
            rows.append(f'<div class="pull"><h3>{name}</h3><div class="row">{"".join(figures)}</div></div>')
    if not rows:
        return []
    note = (
        "The negative gradient of each scale with respect to the image: bright where the scale wants the image "
        "brighter, dark where darker, mid grey where it wants no change. Each picture has its own range."
    )
    return [f'<h2>Gradient of each scale</h2><p class="soft">{note}</p><div class="row pulls">{"".join(rows)}</div>']


def effects(pictures: Pictures, result: Mapping[str, Any]) -> list[str]:
    """Return the section of the changes by each effect and the plan, if the renderer plans its effects."""
    plan, switches = result.get("plan"), result.get("effects")
    if not isinstance(plan, str) or not isinstance(switches, Mapping):
        return []
    figures = [
        pictures.figure(effect_file(name), f"{name}: {'on' if on else 'off'}")
        for name, on in switches.items()
        if EFFECT_NAME.fullmatch(name)
    ]
    row = f'<div class="row">{"".join(figures)}</div>'
    listing = scrollable("Plan of effects", escape(plan), "pre")
    return [f"<h2>Effects: how each changes the image along the first descent</h2>{row}{listing}"]
