"""How a run was made: command, seed, accuracy, rates, and what it was computed with."""

from __future__ import annotations

import math
from collections.abc import Mapping
from html import escape
from typing import Any, Final

from loi_core.support.values import real_number

__all__ = ["making"]

MOST_PACKAGES: Final = 32
LONGEST: Final = 500
HELD: Final = (
    ("python", "Python"),
    ("platform", "platform"),
    ("renderer", "renderer"),
)
IMAGES: Final = ("backend", "dtype", "device")


def making(result: Mapping[str, Any]) -> str:
    """What is known of the making of a run, as a list of terms; an older run says less."""
    rows: list[tuple[str, str]] = []
    command = result.get("command")
    if isinstance(command, str):
        rows.append(("command", f"<code>{escape(command[:LONGEST])}</code>"))
    if _is_plain(result.get("seed")):
        rows.append(("seed", escape(str(result["seed"])[:LONGEST])))
    rates = result["trials"][0].get("learning_rates")
    if isinstance(rates, Mapping) and rates:
        told = ", ".join(f"{name} {real_number(rate):.4g}" for name, rate in list(rates.items())[:MOST_PACKAGES])
        rows.append(("learning rates", escape(told)))
    plan = ""
    accuracy = result.get("accuracy")
    if isinstance(accuracy, Mapping):
        rows.append(("accuracy", escape(_allowed(accuracy))))
        plan = accuracy["plan"] if isinstance(accuracy.get("plan"), str) else ""
    environment = result.get("environment")
    if isinstance(environment, Mapping):
        rows += [
            (label, escape(environment[key][:LONGEST])) for key, label in HELD if isinstance(environment.get(key), str)
        ]
        images = [environment[key][:LONGEST] for key in IMAGES if isinstance(environment.get(key), str)]
        if len(images) == len(IMAGES):
            rows.append(("images", escape("{} arrays of {}, on {}".format(*images))))
        packages = environment.get("packages")
        if isinstance(packages, Mapping):
            listed = [f"{name} {version}" for name, version in packages.items() if isinstance(version, str)]
            rows.append(("packages", escape(", ".join(listed[:MOST_PACKAGES]))))
    if not rows:
        return ""
    terms = "".join(f"<div><dt>{term}</dt><dd>{told}</dd></div>" for term, told in rows)
    more = (
        "<details><summary>What is computed for each scale</summary>"
        '<pre class="scroll" role="group" tabindex="0" aria-label="Plan of the comparison">'
        f"{escape(plan)}</pre></details>"
        if plan
        else ""
    )
    return f'<h2>How it was made</h2><dl class="terms">{terms}</dl>{more}'


def _allowed(accuracy: Mapping[str, Any]) -> str:
    tolerance = real_number(accuracy.get("tolerance"))
    name = accuracy.get("name")
    begin = f"{name}: " if isinstance(name, str) else ""
    if tolerance == 0.0:
        return f"{begin}value and gradient are those of the definition, up to rounding"
    if not math.isfinite(tolerance):
        return f"{begin}unknown"
    return f"{begin}the gradient may be off by {tolerance:.3g} of its size, in exchange for time"


def _is_plain(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)
