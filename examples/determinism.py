"""Measure bitwise reproducibility: ``python -m examples.determinism``, from the root of the repository.

Each backend computes the loss and its gradient, renders with their pullbacks, and a short fit, in a new process for
each of several settings that should not matter. The table shows equality to the bit, or the difference.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from loi_core import Free, LOIObjective, ScaleSpace, fit
from loi_core.renderers import Disks, Warp
from loi_core.renderers.contract import Renderer
from loi_core.support.arrays import from_numpy, to_numpy

__all__ = ["BACKENDS", "Results", "computed", "difference_in_eps"]

Host = np.ndarray[Any, Any]
Results = dict[str, Host]

HEIGHT, WIDTH, STEPS = 96, 128, 5
SCALES: Final = ScaleSpace((1, 5), (0, 5, 45), (0.125,))  # blurs by shifts, by matrices and through coarser samplings

# Changes of the environment of two compared processes; the default has one thread and hash seed 0.
FOUR_THREADS: Final = {"THREADS": "4"}
SETTINGS: Final[dict[str, tuple[dict[str, str], dict[str, str]]]] = {
    "1 thread, twice": ({}, {"PYTHONHASHSEED": "12345"}),
    "1 and 2 threads": ({}, {"THREADS": "2"}),
    "1 and 4 threads": ({}, FOUR_THREADS),
    "4 threads, twice": (FOUR_THREADS, {**FOUR_THREADS, "PYTHONHASHSEED": "12345"}),
}


def pictures(dtype: str) -> tuple[Host, Host]:
    """Return two images that differ everywhere: noise over disks."""
    rng = np.random.default_rng(5)
    scene = disks()
    noise = rng.uniform(0.0, 0.2, (2, HEIGHT, WIDTH, 3))
    image, reference = 0.8 * scene.render(scene.parameters()) + noise
    return image.astype(dtype), reference.astype(dtype)


def disks(make: Callable[..., Any] = Disks, **options: Any) -> Any:
    """Return twelve overlapping disks."""
    rng = np.random.default_rng(6)
    return make(
        HEIGHT,
        WIDTH,
        rng.uniform(5.0, 90.0, (12, 2)).tolist(),
        rng.uniform(3.0, 20.0, 12).tolist(),
        rng.uniform(0.0, 1.0, (12, 3)).tolist(),
        **options,
    )


def warp(make: Callable[..., Any] = Warp, **options: Any) -> Any:
    """Return a rotated picture."""
    rng = np.random.default_rng(7)
    picture, background = rng.uniform(0, 1, (40, 50, 4)), rng.uniform(0, 1, (HEIGHT, WIDTH, 3))
    return make(picture, background, (7.0, -3.0), 31.0, 1.3, 0.2, **options)


def rendered(name: str, renderer: Renderer) -> Results:
    """Return the image and the pullback of noise."""
    image, pullback = renderer.render_vjp(renderer.parameters(), seed=3)
    cotangent = np.random.default_rng(8).standard_normal(tuple(image.shape))
    gradient = pullback(from_numpy(cotangent, image))
    slopes = np.concatenate([to_numpy(gradient[key]).ravel() for key in sorted(gradient)])
    return {f"{name}: image": to_numpy(image), f"{name}: gradient": slopes}


def fitted(name: str, renderer: Renderer, free: str, rate: float) -> Results:
    """Return the parameters and values of a fit of a few steps."""
    start = renderer.parameters()
    target = to_numpy(renderer.render(start, seed=100))
    moved = {free: _moved(to_numpy(start[free]))}
    objective = LOIObjective(target, SCALES)
    result = fit(renderer, objective, steps=STEPS, learning_rate=rate, optimise=moved, seed=4)
    parameters = to_numpy(result.params[free]).ravel()
    values = np.array([step.value for step in result.history], dtype=parameters.dtype)
    return {f"{name}: fit": np.concatenate([parameters, values])}


def _moved(start: Host) -> Any:
    return Free(initial=start + np.linspace(0.1, 0.2, start.size).reshape(start.shape).astype(start.dtype))


def on_numpy() -> Results:
    """Compute on NumPy."""
    results: Results = {}
    for dtype in ("float32", "float64"):
        image, reference = pictures(dtype)
        value, gradient = LOIObjective(reference, SCALES).value_and_grad(image)
        results |= {f"loss, {dtype}": np.asarray(value), f"loss gradient, {dtype}": gradient}
    results |= rendered("disks", disks()) | rendered("warp", warp())
    return results | fitted("disks", disks(), "positions", 0.5)


def on_torch() -> Results:
    """Compute on PyTorch through autograd."""
    import torch

    import loi_torch
    from loi_torch.renderers import Disks as TorchDisks
    from loi_torch.warp import Warp as TorchWarp

    torch.set_num_threads(_threads())
    results: Results = {}
    for dtype in ("float32", "float64"):
        image, reference = pictures(dtype)
        leaf = torch.tensor(image, requires_grad=True)
        value = loi_torch.LOILoss(SCALES)(leaf, reference)
        value.backward()
        assert leaf.grad is not None
        results |= {f"loss, {dtype}": value.detach().numpy(), f"loss gradient, {dtype}": leaf.grad.numpy()}
    results |= rendered("disks", disks(TorchDisks)) | rendered("warp", warp(TorchWarp))
    return results | fitted("disks", disks(TorchDisks), "positions", 0.5)


def on_jax() -> Results:
    """Compute on JAX under jit."""
    import jax

    jax.config.update("jax_enable_x64", True)  # type: ignore[no-untyped-call]  # untyped in JAX
    import loi_jax
    from loi_jax.renderers import Disks as JaxDisks

    results: Results = {}
    for dtype in ("float32", "float64"):
        image, reference = pictures(dtype)
        value, gradient = jax.jit(jax.value_and_grad(partial(loi_jax.loi_loss, scales=SCALES)))(image, reference)
        results |= {f"loss, {dtype}": np.asarray(value), f"loss gradient, {dtype}": np.asarray(gradient)}
    results |= rendered("disks", disks(JaxDisks))
    return results | fitted("disks", disks(JaxDisks), "positions", 0.5)


def on_mitsuba() -> Results:
    """Compute on Dr.Jit, with a small scene of Mitsuba."""
    import loi_mitsuba  # before Dr.Jit, so that it gets an LLVM that works

    # isort: split
    import drjit as dr
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    mi.set_log_level(mi.LogLevel.Error)
    dr.set_thread_count(_threads())
    image, reference = pictures("float32")
    tensor = mi.TensorXf(image)
    dr.enable_grad(tensor)
    value = loi_mitsuba.loi_loss(tensor, reference, SCALES)
    dr.backward(value)
    results = {"loss, float32": np.array(value), "loss gradient, float32": np.array(dr.grad(tensor))}
    renderer = loi_mitsuba.MitsubaRenderer(_ball(mi), {"place": loi_mitsuba.Translate("ball")}, spp=8)
    return results | rendered("scene", renderer) | fitted("scene", renderer, "place", 0.05)


def _ball(mi: Any) -> dict[str, Any]:
    film = {"type": "hdrfilm", "width": 64, "height": 48, "rfilter": {"type": "box"}, "sample_border": True}
    view = mi.ScalarTransform4f().look_at([0, 0, 6], [0, 0, 0], [0, 1, 0])
    grey = {"type": "rgb", "value": [0.4, 0.5, 0.6]}
    return {
        "type": "scene",
        "sensor": {"type": "perspective", "fov": 40, "film": film, "to_world": view},
        "light": {"type": "constant"},
        "ball": {"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": grey}},
    }


BACKENDS: Final[dict[str, tuple[str, Callable[[], Results]]]] = {
    "NumPy": ("numpy", on_numpy),
    "torch": ("torch", on_torch),
    "JAX": ("jax", on_jax),
    "Mitsuba": ("mitsuba", on_mitsuba),
}


def _threads() -> int:
    return int(os.environ["THREADS"])


def computed(backend: str, folder: Path, **changes: str) -> Results:
    """Return the results of a backend in a new process with these changes of its environment."""
    # A shared compilation cache would make results equal for that reason alone.
    variables = {"THREADS": "1", "PYTHONHASHSEED": "0", "JAX_ENABLE_COMPILATION_CACHE": "false", **changes}
    threads = variables["THREADS"]
    variables |= dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NPROC"), threads)
    variables["XLA_FLAGS"] = f"--xla_cpu_multi_thread_eigen={'false' if threads == '1' else 'true'}"
    path = folder / "results.npz"
    subprocess.run(
        [sys.executable, "-m", "examples.determinism", "--row", backend, str(path)],
        check=True,
        env={**os.environ, **variables},
        cwd=Path(__file__).parents[1],
    )
    with np.load(path, allow_pickle=False) as stored:
        return {name: stored[name] for name in stored.files}


def difference_in_eps(first: Host, second: Host) -> float:
    """Return the largest difference, in units of the rounding (eps) of the largest value; 0 if all bits are equal."""
    if first.tobytes() == second.tobytes():
        return 0.0
    unit = float(np.finfo(first.dtype).eps) * max(float(np.abs(first).max()), sys.float_info.min)
    distance = float(np.abs(first.astype(np.float64) - second.astype(np.float64)).max()) / unit
    return max(distance, sys.float_info.min)  # zeros of different sign differ by 0 but are not equal


def shown(distance: float) -> str:
    """Return a cell of the table."""
    return "equal" if distance == 0.0 else f"{distance:.2g} eps"


def main(arguments: list[str]) -> int:
    """Print the table, or compute one row into a file."""
    parser = argparse.ArgumentParser(prog="python -m examples.determinism", description=__doc__)
    parser.add_argument("--row", nargs=2, metavar=("BACKEND", "FILE"), help="compute one row's numbers into a file")
    row = parser.parse_args(arguments).row
    if row:
        backend, path = row
        np.savez(path, allow_pickle=False, **BACKENDS[backend][1]())
        return 0
    print(f"| backend | result | {' | '.join(SETTINGS)} |\n|{' --- |' * (2 + len(SETTINGS))}")
    with tempfile.TemporaryDirectory() as folder:
        for backend, (module, _) in BACKENDS.items():
            if importlib.util.find_spec(module) is None:
                continue
            runs: dict[tuple[tuple[str, str], ...], Results] = {}
            for changes in (changes for pair in SETTINGS.values() for changes in pair):
                key = tuple(sorted(changes.items()))
                if key not in runs:
                    runs[key] = computed(backend, Path(folder), **changes)
            pairs = [tuple(runs[tuple(sorted(changes.items()))] for changes in pair) for pair in SETTINGS.values()]
            for name in runs[()]:
                cells = (shown(difference_in_eps(first[name], second[name])) for first, second in pairs)
                print(f"| {backend} | {name} | {' | '.join(cells)} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
