"""What a gradient of a Mitsuba scene takes by us and by Mitsuba itself: ``python -m benchmarks.gradients``.

Each part has the same integrator, samples and random numbers both ways, and one thread. Calls take turns, after one of
each that compiles; medians, and the ratio of both.
"""

from __future__ import annotations

import argparse
import statistics
import time
import warnings
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from loi_core.support.markdown import markdown
from loi_mitsuba import MitsubaRenderer, Translate  # before mitsuba

# isort: split
import drjit as dr
import mitsuba as mi

WIDTH, HEIGHT, SAMPLES = 256, 192, 16
PARTS: Final = {"sppc": "shading", "sppp": "outlines in view", "sppi": "shadows and reflections"}
KINDS: Final = ("direct_projective", "prb_projective")


def main() -> None:
    """Print one table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--calls", type=int, default=7, help="of each, after one that is not counted (default: 7)")
    options = parser.parse_args()
    use_one_thread()
    rows = [row(kind, part, options.calls) for kind in KINDS for part in PARTS]
    print("\n".join(markdown(["integrator, part", "Mitsuba, s", "loi, s", "Mitsuba / loi"], rows)))


def use_one_thread() -> None:
    """One variant and one thread, without Mitsuba's advice about each new integrator."""
    warnings.simplefilter("ignore")
    mi.set_variant("llvm_ad_rgb")
    mi.set_log_level(mi.LogLevel.Error)
    dr.set_thread_count(1)


def row(kind: str, part: str, calls: int) -> tuple[str, ...]:
    """One part of one integrator."""
    described = {"type": kind, "guiding": "none", **dict.fromkeys(PARTS, 0), part: SAMPLES}
    renderer = MitsubaRenderer(scene(), {"x": Translate("ball", (1, 0, 0))}, integrator=described)
    here = {"x": np.float32(0.0)}
    cotangent = np.random.default_rng(0).standard_normal((HEIGHT, WIDTH, 3)).astype(np.float32)
    own, params = mi.load_dict(described), mi.traverse(renderer.scene)
    start = mi.Transform4f(params["ball.to_world"])

    def ours(seed: int) -> None:
        renderer.vjp(here, cotangent, seed=seed)

    def mitsubas(seed: int) -> None:
        x = mi.Float(0.0)
        dr.enable_grad(x)
        params["ball.to_world"] = mi.Transform4f().translate(mi.Vector3f(x, 0.0, 0.0)) @ start
        params.update()
        own.render_backward(renderer.scene, params, mi.TensorXf(cotangent), renderer.sensor, seed)
        dr.eval(dr.grad(x))
        dr.sync_thread()
        params["ball.to_world"] = start
        params.update()

    seconds: tuple[list[float], ...] = ([], [])
    for seed in range(calls + 1):
        for call, taken in zip((mitsubas, ours), seconds, strict=True):
            taken.append(timed(call, seed))
    first, second = (statistics.median(taken[1:]) for taken in seconds)
    return f"{kind}, {PARTS[part]}", f"{first:.2f}", f"{second:.2f}", f"{first / second:.1f}"


def timed(call: Callable[[int], None], seed: int) -> float:
    """Seconds of one call."""
    started = time.perf_counter()
    call(seed)
    return time.perf_counter() - started


def scene() -> dict[str, Any]:
    """A ball over a floor, under a lamp."""
    place = mi.ScalarTransform4f
    return {
        "type": "scene",
        "sensor": {
            "type": "perspective",
            "fov": 45,
            "to_world": place().look_at([0, 6, 6], [0, 0, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": WIDTH, "height": HEIGHT},
        },
        "floor": {"type": "rectangle", "to_world": place().rotate([1, 0, 0], -90).scale(8)},
        "ball": {"type": "sphere", "to_world": place().translate([0, 1.5, 0]).scale(0.6)},
        "lamp": {
            "type": "sphere",
            "to_world": place().translate([0, 12, 0]).scale(0.7),
            "emitter": {"type": "area", "radiance": 100.0},
        },
    }


if __name__ == "__main__":
    main()
