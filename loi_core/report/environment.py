"""What a fit was computed with: versions and kinds of things, and nothing that tells whose machine it was."""

from __future__ import annotations

import importlib.metadata
import platform
import sys
from typing import Any, Final

from loi_core import __version__
from loi_core.scenes.scene import Scene
from loi_core.support.arrays import Array, device, library_name
from loi_core.support.processors import usable_processors

__all__ = ["environment"]

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
"""What numbers may depend on, by the names that it is imported and installed by."""


def environment(scene: Scene, image: Array | None) -> dict[str, Any]:
    """Python, platform and packages, and how the first view's image is held, as plain values for JSON.

    Parameters
    ----------
    scene : Scene
    image : array, optional
        As the renderer of the first view made it.
    """
    renderer = type(scene.renderer)
    owner = renderer.__module__.partition(".")[0]
    wanted = {name: project for name, project in PACKAGES.items() if name in sys.modules}
    if not owner.startswith("loi_"):
        wanted[owner] = owner
    processors = usable_processors()
    found: dict[str, Any] = {
        "python": f"{platform.python_implementation()} {platform.python_version()}",
        "platform": f"{platform.system()} {platform.machine()}, {processors} processor{'' if processors == 1 else 's'}",
        "packages": {"loi": __version__, **{project: _version(project) for project in sorted(wanted.values())}},
        "renderer": f"{renderer.__name__} of {owner}",
    }
    if image is not None:
        found |= {"backend": library_name(image), "dtype": str(image.dtype), "device": str(device(image))}
    return found


def _version(project: str) -> str:
    try:
        return importlib.metadata.version(project)
    except importlib.metadata.PackageNotFoundError:
        return "not installed as a package"
