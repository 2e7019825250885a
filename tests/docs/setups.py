"""What the blocks of the detailed pages assume. Pages of the guide assume nothing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

__all__ = ["SETUPS", "Task", "carry_out"]

_IMAGES: Final = """
from pathlib import Path
import numpy as np
height, width = 16, 24
photograph = np.full((height, width, 3), 0.7)
"""

SETUPS: Final = {
    "convergence": _IMAGES
    + """
import optax, torch
import loi_jax, loi_torch
from loi_core import FarToNear, Free, LOIObjective, ScaleSpace, fit
from loi_core.renderers import Disks
renderer = front = side = Disks(height, width, [[5.0, 9.0]], 3.0, [[1.0, 0.5, 0.2]])
one = two = photograph
mask = np.ones((height, width))
params, update = renderer.parameters(), lambda params, gradient: params
start, low, high = [[5.0, 9.0]], 0.0, 24.0
objective = LOIObjective(photograph)
_fit = fit
def fit(renderer, *given, optimise=None, **options):  # three steps; the page's "place" is the renderer's "positions"
    return _fit(renderer, *given, steps=3, optimise=optimise and {"positions": optimise["place"]}, **options)
""",
    "habits": _IMAGES
    + """
import loi_core
from loi_core import Free, LOIObjective
from loi_core.renderers import Disks
renderer = Disks(height, width, [[5.0, 9.0]], 3.0, [[1.0, 0.5, 0.2]])
objective, free = LOIObjective(photograph), {"positions": Free([[9.0, 5.0]], 0.0, 24.0)}
""",
    "large": _IMAGES
    + """
photograph = photograph.astype(np.float32)
image = 0.5 * photograph
np.save("photograph.npy", photograph)
np.save("render.npy", image)
""",
    "mesh": _IMAGES
    + """
import trimesh
trimesh.creation.box().export("crate.glb")
""",
    "vector": _IMAGES
    + """
text = '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 24 16"><circle cx="6" cy="6" r="3" fill="red"/></svg>'
Path("start.svg").write_text(text)
""",
    "sweeps": """
from pathlib import Path
from tests.docs.setups import Task, carry_out
folder = Path("records")
folder.mkdir()
runs = [Task("a", 1), Task("b", 2)]
""",
    "backends": _IMAGES
    + """
import torch
import torch.distributed as dist
import loi_torch
store = Path("store").absolute().as_uri()
dist.init_process_group("gloo", init_method=store, rank=0, world_size=1)
params = torch.full((height, width, 3), 0.2, requires_grad=True)
render = lambda params, camera: torch.sigmoid(params)
losses, views = [(loi_torch.LOILoss(torch.tensor(photograph)), None)], 1
optimizer = torch.optim.Adam([params])
""",
    "effects": _IMAGES
    + """
import loi_mitsuba
photograph[...] = 1.0
photograph[3:8, 15:20] = 0.5
Path("scene.xml").write_text('''<scene version="3.0.0">
<sensor type="perspective"><transform name="to_world"><lookat origin="0,0,6" target="0,0,0" up="0,1,0"/></transform>
<film type="hdrfilm"><integer name="width" value="24"/><integer name="height" value="16"/>
<boolean name="sample_border" value="true"/></film></sensor>
<emitter type="constant"/><shape type="sphere" id="ball"><float name="radius" value="0.5"/></shape></scene>''')
""",
}
"""Code that is run before the blocks of a page, by its name."""


@dataclass(frozen=True)
class Task:
    """A run that is no scene file."""

    name: str
    number: int


def carry_out(task: Task) -> dict[str, int]:
    """What a worker does for it."""
    return {"twice": 2 * task.number}
