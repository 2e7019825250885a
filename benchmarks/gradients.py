"""Time gradients of a Mitsuba scene in `loi_mitsuba` and in Mitsuba itself: ``python -m benchmarks.gradients``.

Both use the same integrator, samples, random numbers and one thread. Calls alternate after a warm-up call of each; the
table has medians and their ratio.
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
TERMS: Final = {"sppc": "shading", "sppp": "outlines in view", "sppi": "shadows and reflections"}
INTEGRATORS: Final = ("direct_projective", "prb_projective")


def main() -> None:
    """Print one table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--calls", type=int, default=7, help="number of timed calls of each (default: 7)")
    options = parser.parse_args()
    use_one_thread()
    rows = [row(integrator, term, options.calls) for integrator in INTEGRATORS for term in TERMS]
    print("\n".join(markdown(["integrator, part", "Mitsuba, s", "loi, s", "Mitsuba / loi"], rows)))


def use_one_thread() -> None:
    """Set one variant and one thread, without Mitsuba's messages about new integrators."""
    warnings.simplefilter("ignore")
    mi.set_variant("llvm_ad_rgb")
    mi.set_log_level(mi.LogLevel.Error)
    dr.set_thread_count(1)


def row(integrator: str, term: str, calls: int) -> tuple[str, ...]:
    """Time one term of one integrator."""
    described = {"type": integrator, "guiding": "none", **dict.fromkeys(TERMS, 0), term: SAMPLES}
    renderer = MitsubaRenderer(scene(), {"x": Translate("ball", (1, 0, 0))}, integrator=described)
    params_at_start = {"x": np.float32(0.0)}
    cotangent = np.random.default_rng(0).standard_normal((HEIGHT, WIDTH, 3)).astype(np.float32)
    integrator_plugin, params = mi.load_dict(described), mi.traverse(renderer.scene)
    start = mi.Transform4f(params["ball.to_world"])

    def ours(seed: int) -> None:
        renderer.vjp(params_at_start, cotangent, seed=seed)

    def mitsubas(seed: int) -> None:
        x = mi.Float(0.0)
        dr.enable_grad(x)
        params["ball.to_world"] = mi.Transform4f().translate(mi.Vector3f(x, 0.0, 0.0)) @ start
        params.update()
        integrator_plugin.render_backward(renderer.scene, params, mi.TensorXf(cotangent), renderer.sensor, seed)
        dr.eval(dr.grad(x))
        dr.sync_thread()
        params["ball.to_world"] = start
        params.update()

    seconds: tuple[list[float], ...] = ([], [])
    for seed in range(calls + 1):
        for call, taken in zip((mitsubas, ours), seconds, strict=True):
            taken.append(timed(call, seed))
    first, second = (statistics.median(taken[1:]) for taken in seconds)
    return f"{integrator}, {TERMS[term]}", f"{first:.2f}", f"{second:.2f}", f"{first / second:.1f}"


def timed(call: Callable[[int], None], seed: int) -> float:
    """Seconds of one call."""
    started = time.perf_counter()
    call(seed)
    return time.perf_counter() - started


def scene() -> dict[str, Any]:
    """Return a ball over a floor, under an area light."""
    transform = mi.ScalarTransform4f
    return {
        "type": "scene",
        "sensor": {
            "type": "perspective",
            "fov": 45,
            "to_world": transform().look_at([0, 6, 6], [0, 0, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": WIDTH, "height": HEIGHT},
        },
        "floor": {"type": "rectangle", "to_world": transform().rotate([1, 0, 0], -90).scale(8)},
        "ball": {"type": "sphere", "to_world": transform().translate([0, 1.5, 0]).scale(0.6)},
        "light": {
            "type": "sphere",
            "to_world": transform().translate([0, 12, 0]).scale(0.7),
            "emitter": {"type": "area", "radiance": 100.0},
        },
    }


if __name__ == "__main__":
    main()
