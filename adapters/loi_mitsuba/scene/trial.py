"""Loads one Mitsuba scene in a process of its own, so that a damaged mesh or image ends this one and no other.

``python trial.py VARIANT FILE``, or ``-`` for a dict in JSON on standard input. See
:mod:`loi_mitsuba.scene.safety`, which has looked at the plugins' names.
Exit code 1 and a last line on standard error say that the scene cannot be loaded.
"""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Collection
from typing import Any

resource: Any = None
with contextlib.suppress(ImportError):  # on Windows
    import resource

MOST_MEMORY = 16 * 2**30  # bytes of addresses, of which Dr.Jit reserves many and uses few


def main(variant: str, path: str) -> int:
    """Load the scene; make sure that its meshes refer to vertices that they have."""
    if resource:
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    from loi_mitsuba.drjit.llvm import prepare

    prepare()
    import drjit as dr
    import mitsuba as mi

    from loi_mitsuba.scene.safety import SceneLoadError, load_own_plugins

    variant = on_processor(variant, mi.variants())
    mi.set_variant(variant)
    if resource and not variant.startswith("cuda"):  # which reserves more addresses than there is memory
        resource.setrlimit(resource.RLIMIT_AS, (MOST_MEMORY, MOST_MEMORY))
    try:
        load_own_plugins()
        described = path == "-"
        scene = mi.load_dict(json.load(sys.stdin), optimize=False) if described else mi.load_file(path, optimize=False)
        for shape in scene.shapes() if isinstance(scene, mi.Scene) else ():
            # Mitsuba's own rectangles are meshes too, whose faces are not listed.
            if isinstance(shape, mi.Mesh) and shape.face_count() and "faces" in mi.traverse(shape):
                last = dr.max(dr.ravel(mi.traverse(shape)["faces"]))[0]
                if last >= shape.vertex_count():
                    msg = f"a mesh refers to vertex {last} and has {shape.vertex_count()}"
                    raise SceneLoadError(msg)
    except (RuntimeError, MemoryError, SceneLoadError) as error:
        sys.stderr.write(f"{' '.join(str(error).split()) or type(error).__name__}\n")
        return 1
    return 0


def on_processor(variant: str, known: Collection[str]) -> str:
    """The variant that does on the processor what another does on a GPU; that itself if Mitsuba was built without."""
    sibling = f"llvm{variant.removeprefix('cuda')}"
    return sibling if variant.startswith("cuda") and sibling in known else variant


if __name__ == "__main__":
    code = main(*sys.argv[1:])
    sys.stderr.flush()
    sys.exit(code)
