"""Descriptions of objectives for ``print`` and for notebooks."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from loi_core.method.scales import ScaleSpace
from loi_core.pixels.thumbnail import thumbnail
from loi_core.support.arrays import Array
from loi_core.support.repr_html import card, row, table
from loi_core.support.wording import printable

__all__ = [
    "facts_of_options",
    "facts_of_reference",
    "facts_of_scales",
    "objective_html",
    "summary_line",
    "unusual_settings",
]

DEFAULTS: Final[Mapping[str, Any]] = {
    "bounds": (0.0, 1.0),
    "boundary": "reflect",
    "p": 1.0,
    "tails": 4.0,
    "convention": "paper",
    "kernel_size": None,
    "centred": False,
}


def facts_of_reference(shape: tuple[int, ...], dtype: object) -> dict[str, str]:
    """Return the reference's shape and dtype."""
    return {"reference": f"{'x'.join(map(str, shape))} {str(dtype).rpartition('.')[2]}"}


def facts_of_scales(scales: ScaleSpace) -> dict[str, str]:
    """Return the scales, and their settings that differ from the defaults."""
    facts = {name: " ".join(f"{scale:g}" for scale in getattr(scales, name)) for name in ("sigma", "alpha", "beta")}
    return facts | {name: str(value) for name, value in unusual_settings(scales).items()}


def unusual_settings(scales: ScaleSpace) -> dict[str, Any]:
    """Return the settings of a scale space that differ from the defaults."""
    return {name: getattr(scales, name) for name, default in DEFAULTS.items() if getattr(scales, name) != default}


def facts_of_options(
    channel_axis: int | None, nan_policy: str, tone: object, weights: tuple[int, ...] | None, exposure: str
) -> dict[str, str]:
    """Return the options of every objective that differ from the defaults, and the shape of the weights."""
    facts = {} if channel_axis == -1 else {"channel_axis": str(channel_axis)}
    facts |= {} if nan_policy == "raise" else {"nan_policy": nan_policy}
    facts |= {} if tone is None else {"tone": str(tone)}
    facts |= {} if exposure == "given" else {"exposure": exposure}
    return facts | ({} if weights is None else {"weights": "x".join(map(str, weights))})


def summary_line(name: str, facts: Mapping[str, str]) -> str:
    """Return the description of an objective in one line."""
    return printable(f"<{name}: {', '.join(f'{label} {fact}' for label, fact in facts.items())}>")


def objective_html(name: str, facts: Mapping[str, str], reference: Array, channel_axis: int | None) -> str:
    """Return the description of an objective as HTML: a thumbnail of the reference beside the facts."""
    return card(name, row([thumbnail(reference, "reference", channel_axis), table(facts.items())]))
