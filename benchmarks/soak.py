"""Long runs: whether memory stays as it is, and a step takes as long as it did.

    python -m benchmarks.soak steps --count 1000000
    python -m benchmarks.soak objectives --count 10000      # a third of them on each of NumPy, torch and JAX
    python -m benchmarks.soak mitsuba --count 10000
    python -m benchmarks.soak picture a.json b.json --output docs/results/images/soak.png

Each takes 100 samples, and prints by how much memory has grown from the first tenth of the run, which warms up, to the
last tenth, and how much longer a step takes. ``--json FILE`` keeps all samples.
"""

from __future__ import annotations

import argparse
import gc
import json
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from loi_core import Free, LOIObjective, ScaleSpace, fit
from loi_core.renderers import Disks

__all__ = ["Soak", "many_objectives", "many_steps", "many_steps_in_mitsuba"]

SAMPLES: Final = 100
WARM: Final = 10  # a tenth of the run
MIB: Final = 2.0**20
SIDE: Final = 16


def own_memory() -> float:
    """Return the anonymous resident memory of this process in bytes; 0 on systems without ``/proc``."""
    status = Path("/proc/self/status")
    lines = status.read_text().splitlines() if status.exists() else []
    return next((1024.0 * float(line.split()[1]) for line in lines if line.startswith("RssAnon")), 0.0)


@dataclass
class Soak:
    """What a run took, by the number of its steps.

    Attributes
    ----------
    what : str
    count : int
        How many steps there are.
    steps : list of int
        When samples were taken.
    memory : list of float
        Resident memory that the process has to itself, in MiB.
    seconds : list of float
        For each step since the sample before.
    """

    what: str
    count: int
    steps: list[int] = field(default_factory=list)
    memory: list[float] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    _since: tuple[int, float] = field(default=(0, 0.0), repr=False)

    def begin(self) -> None:
        """Start the clock."""
        self._since = 0, time.perf_counter()

    def took(self, step: int) -> None:
        """Take note that so many steps are done."""
        if step * SAMPLES // self.count == (step - 1) * SAMPLES // self.count:
            return
        gc.collect()  # what waits to be collected is not lost
        before, began = self._since
        now = time.perf_counter()
        self.steps.append(step)
        self.memory.append(own_memory() / MIB)
        self.seconds.append((now - began) / (step - before))
        self._since = step, time.perf_counter()

    @property
    def growth(self) -> float:
        """By how many MiB memory has grown from the second tenth to the last: medians of both."""
        part = max(len(self.memory) // WARM, 1)
        return float(np.median(self.memory[-part:]) - np.median(self.memory[part : 2 * part]))

    @property
    def slowing(self) -> float:
        """How long a step takes in the last tenth, in units of the tenth after the first."""
        part = max(len(self.seconds) // WARM, 1)
        return float(np.median(self.seconds[-part:]) / np.median(self.seconds[part : 2 * part]))

    def __str__(self) -> str:
        return (
            f"| {self.what} | {self.count} | {sum(self.seconds) / len(self.seconds) * 1e3:.2f} | {self.memory[-1]:.1f} "
            f"| {self.growth:+.2f} | {self.slowing:.2f} |"
        )


def many_steps(count: int) -> Soak:
    """A fit of one disk on NumPy: objective, renderer, optimiser, and the history of every step."""
    there, scene = (Disks(SIDE, SIDE, [place], 3.0, [[1.0, 0.5, 0.2]]) for place in ((11.0, 10.0), (4.0, 5.0)))
    reference = there.render(there.parameters())
    soak = Soak("steps of a fit on NumPy", count)

    def callback(step: Any, *_: object) -> None:
        soak.took(step.step + 1)

    soak.begin()
    result = fit(
        scene,
        LOIObjective(reference, ScaleSpace(1.0, (2.0, 6.0), 0.25)),
        steps=count,
        learning_rate=0.05,
        optimise={"positions": Free(lower=0.0, upper=float(SIDE))},
        stages=None,
        callback=callback,
    )
    assert len(result.history) == count
    return soak


def many_objectives(count: int, kinds: int = 10**9) -> Soak:
    """Objectives of sizes and scales that change, made, used once and dropped, on NumPy, torch and JAX in turn.

    They have as many different scales as there are `kinds`: bounded caches of what depends on scales fill up with them.
    """
    import jax
    import jax.numpy as jnp
    import torch

    import loi_jax
    import loi_torch

    rng = np.random.default_rng(0)
    soak = Soak("objectives on NumPy, torch and JAX", count)

    def on_numpy(image: Any, reference: Any, scales: ScaleSpace) -> None:
        LOIObjective(reference, scales, "balanced").value_and_grad(image)

    def on_torch(image: Any, reference: Any, scales: ScaleSpace) -> None:
        given = torch.tensor(image, requires_grad=True)
        loi_torch.LOILoss(torch.tensor(reference), scales)(given).backward()

    def on_jax(image: Any, reference: Any, scales: ScaleSpace) -> None:
        jax.grad(loi_jax.loi_loss(jnp.asarray(reference), scales))(jnp.asarray(image)).block_until_ready()

    ways: list[Callable[[Any, Any, ScaleSpace], None]] = [on_numpy, on_torch, on_jax]
    sizes = [(16, 16), (24, 17), (31, 40), (12, 33)]
    soak.begin()
    for index in range(count):
        size = sizes[index // len(ways) % len(sizes)]
        alpha = 2.0 + 10.0 * (0.618 * (index % kinds) % 1.0)
        image, reference = rng.random((2, *size, 3), np.float32)
        ways[index % len(ways)](image, reference, ScaleSpace(1.0, (alpha,), 0.25))
        soak.took(index + 1)
    return soak


def many_steps_in_mitsuba(count: int) -> Soak:
    """Steps of a loop in Mitsuba: a ball, rendered, compared, and moved."""
    import loi_mitsuba  # before drjit and mitsuba

    # isort: split
    import drjit as dr
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    view = mi.ScalarTransform4f().look_at([0, 0, 8], [0, 0, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": SIDE, "height": SIDE, "sample_border": True}
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "direct_projective", "sppi": 0, "guiding": "none"},
            "camera": {"type": "perspective", "fov": 40, "to_world": view, "film": film},
            "light": {"type": "constant"},
            "ball": {"type": "sphere", "radius": 0.8, "bsdf": {"type": "diffuse"}},
        }
    )
    params = mi.traverse(scene)
    shape = mi.Transform4f(params["ball.to_world"])

    def move(place: Any) -> None:
        params["ball.to_world"] = mi.Transform4f().translate(place) @ shape
        params.update()

    move(mi.Point3f(1.0, -0.5, 0.0))
    loss = loi_mitsuba.LOILoss(mi.render(scene, spp=64), ScaleSpace(1.0, (2.0, 6.0), 0.25))
    optimizer = mi.ad.Adam(lr=0.01)
    optimizer["place"] = mi.Point3f(-1.0, 0.5, 0.0)
    soak = Soak("steps of a loop in Mitsuba", count)
    soak.begin()
    for step in range(count):
        move(optimizer["place"])
        dr.backward(loss(mi.render(scene, params, seed=step, spp=4)))
        optimizer.step()
        soak.took(step + 1)
    return soak


def picture(files: list[Path], output: Path) -> None:
    """Memory and time by steps: a row of two for each run."""
    import matplotlib.pyplot as plt

    runs = [json.loads(file.read_text()) for file in files]
    figure, axes = plt.subplots(len(runs), 2, figsize=(9.0, 2.3 * len(runs)), squeeze=False, layout="constrained")
    for (left, right), run in zip(axes, runs, strict=True):
        left.plot(run["steps"], run["memory"], lw=1.0)
        middle = float(np.median(run["memory"]))
        left.set_ylim(
            min(middle - 2.0, min(run["memory"][len(run["memory"]) // WARM :]) - 0.5), max(run["memory"]) + 0.5
        )
        left.set_ylabel("memory, MiB")
        left.set_title(f"{run['count']} {run['what']}", fontsize=9, loc="left")
        right.plot(run["steps"], np.asarray(run["seconds"]) * 1e3, lw=1.0)
        right.set_ylim(0.0, None)
        right.set_ylabel("a step, ms")
    figure.savefig(output, dpi=110)


def main() -> None:
    """Run what is asked for, and print a row of a table."""
    runs: dict[str, Callable[..., Soak]] = {
        "steps": many_steps,
        "objectives": many_objectives,
        "mitsuba": many_steps_in_mitsuba,
    }
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=(*runs, "picture"))
    parser.add_argument("files", type=Path, nargs="*", help="what runs have written, for the picture")
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--kinds", type=int, help="of scales that objectives have; all different by default")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--output", type=Path, default=Path("soak.png"))
    asked = parser.parse_args()
    if asked.what == "picture":
        picture(asked.files, asked.output)
        return
    soak = runs[asked.what](asked.count, *([asked.kinds] if asked.kinds else []))
    print("| what | number | ms each | memory at the end, MiB | growth, MiB | a step at the end |")
    print("| --- | --- | --- | --- | --- | --- |")
    print(soak)
    if asked.json:
        kept = {name: value for name, value in vars(soak).items() if not name.startswith("_")}
        asked.json.write_text(json.dumps(kept))


if __name__ == "__main__":
    main()
