"""The command, seed, settings and versions behind a fit, without the name of a user, machine or folder."""

from __future__ import annotations

import importlib.metadata
import math
import platform
import sys
from collections.abc import Mapping
from html import escape
from typing import Any, Final

from loi_core import __version__
from loi_core.report.document import scrollable
from loi_core.scenes.scene import Scene
from loi_core.support.arrays import Array, device, library_name
from loi_core.support.processors import usable_processors
from loi_core.support.values import real_number

__all__ = ["environment", "provenance"]

PACKAGES: Final = {
    "numpy": "numpy",
    "array_api_compat": "array-api-compat",
    "PIL": "pillow",
    "numba": "numba",
    "torch": "torch",
    "kornia": "kornia",
    "jax": "jax",
    "jaxlib": "jaxlib",
    "mitsuba": "mitsuba",
    "drjit": "drjit",
}
"""Packages that the numbers may depend on: import name and distribution name."""

MAX_ENTRIES: Final = 32  # packages, or learning rates
MAX_TEXT_LENGTH: Final = 500
HOST_KEYS: Final = ("python", "platform", "renderer")
IMAGE_KEYS: Final = ("backend", "dtype", "device")


def environment(scene: Scene, image: Array | None) -> dict[str, Any]:
    """Return Python, platform, packages and the kind of image arrays, as plain values for JSON.

    Parameters
    ----------
    scene : Scene
    image : array, optional
        An image by the renderer of the first view.
    """
    renderer = type(scene.renderer)
    owner = renderer.__module__.partition(".")[0]
    projects = {project for name, project in PACKAGES.items() if name in sys.modules}
    if not owner.startswith("loi_"):
        projects.add(owner)
    processors = usable_processors()
    values: dict[str, Any] = {
        "python": f"{platform.python_implementation()} {platform.python_version()}",
        "platform": f"{platform.system()} {platform.machine()}, {processors} processor{'' if processors == 1 else 's'}",
        "packages": {"loi": __version__, **{project: _version(project) for project in sorted(projects)}},
        "renderer": f"{renderer.__name__} of {owner}",
    }
    if image is not None:
        values |= {"backend": library_name(image), "dtype": str(image.dtype), "device": str(device(image))}
    return values


def provenance(result: Mapping[str, Any]) -> str:
    """Return the section "How it was made" of a page, with the entries that `result` has."""
    rows: dict[str, str] = {}
    command = result.get("command")
    if isinstance(command, str):
        rows["command"] = f"<code>{escape(command[:MAX_TEXT_LENGTH])}</code>"
    seed = result.get("seed")
    if isinstance(seed, int) and not isinstance(seed, bool):
        rows["seed"] = str(seed)[:MAX_TEXT_LENGTH]
    rates = result["trials"][0].get("learning_rates")
    if isinstance(rates, Mapping) and rates:
        pairs = list(rates.items())[:MAX_ENTRIES]
        rows["learning rates"] = escape(", ".join(f"{name} {real_number(rate):.4g}" for name, rate in pairs))
    accuracy = result.get("accuracy")
    if isinstance(accuracy, Mapping):
        rows["accuracy"] = escape(_accuracy_sentence(accuracy))
    values = result.get("environment")
    if isinstance(values, Mapping):
        rows |= _environment_rows(values)
    if not rows:
        return ""
    terms = "".join(f"<div><dt>{term}</dt><dd>{html}</dd></div>" for term, html in rows.items())
    plan = accuracy.get("plan") if isinstance(accuracy, Mapping) else None
    details = ""
    if isinstance(plan, str) and plan:
        listing = scrollable("Plan of the comparison", escape(plan), "pre")
        details = f"<details><summary>Computation of each scale</summary>{listing}</details>"
    return f'<h2>How it was made</h2><dl class="terms">{terms}</dl>{details}'


def _environment_rows(values: Mapping[str, Any]) -> dict[str, str]:
    texts = {key: value[:MAX_TEXT_LENGTH] for key, value in values.items() if isinstance(value, str)}
    rows = {"Python" if key == "python" else key: escape(texts[key]) for key in HOST_KEYS if key in texts}
    if all(key in texts for key in IMAGE_KEYS):
        rows["images"] = escape("{} arrays of {}, on {}".format(*(texts[key] for key in IMAGE_KEYS)))
    packages = values.get("packages")
    if isinstance(packages, Mapping):
        versions = [f"{name} {version}" for name, version in packages.items() if isinstance(version, str)]
        rows["packages"] = escape(", ".join(versions[:MAX_ENTRIES]))
    return rows


def _accuracy_sentence(accuracy: Mapping[str, Any]) -> str:
    tolerance = real_number(accuracy.get("tolerance"))
    name = accuracy.get("name")
    prefix = f"{name}: " if isinstance(name, str) else ""
    if tolerance == 0.0:
        return f"{prefix}value and gradient equal the definition, up to rounding"
    if not math.isfinite(tolerance):
        return f"{prefix}unknown"
    return f"{prefix}the gradient may be off by {tolerance:.3g} of its size, in exchange for time"


def _version(project: str) -> str:
    try:
        return importlib.metadata.version(project)
    except importlib.metadata.PackageNotFoundError:
        return "not installed as a package"
