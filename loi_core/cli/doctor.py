"""``loi doctor``: what works on this machine, and for each thing that does not, the command that fixes it."""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import platform
import sys
import warnings
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from typing import Any, Final, Literal

import numpy as np

from loi_core import __version__
from loi_core.errors import LoiError, WeightsError
from loi_core.method.compiled import SWITCH, available
from loi_core.plugins.baselines import make_baseline
from loi_core.plugins.registry import OBJECTIVES, PluginInfo, available_renderers
from loi_core.support.installed import how_to_install
from loi_core.support.processors import usable_processors

__all__ = ["Finding", "examine", "findings"]

State = Literal["ok", "missing", "broken", "note"]


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at.

    Attributes
    ----------
    name : str
    state : {"ok", "missing", "broken", "note"}
        "missing" is an optional thing that is not there; "broken" one that is there and does not work.
    detail : str
        Version, or what is wrong.
    fix : str
        The command that fixes it; empty if nothing needs fixing.
    """

    name: str
    state: State
    detail: str
    fix: str = ""


REQUIRED: Final = {
    "numpy": "numpy",
    "array-api-compat": "array_api_compat",
    "pillow": "PIL",
    "matplotlib": "matplotlib",
    "OpenEXR": "OpenEXR",
    "shtab": "shtab",
    "tqdm": "tqdm",
}
# Each through its adapter: loi_mitsuba, for one, has to come before mitsuba, to choose the LLVM.
BACKENDS: Final = {"torch": "loi_torch", "jax": "loi_jax", "mitsuba": "loi_mitsuba"}
EXTRAS: Final = {"distributed": "dask", "pyarrow": "parquet", "tensorboard": "tensorboard"}


def examine(*, as_json: bool) -> bool:
    """Print all findings; False if something is broken."""
    found = findings()
    if as_json:
        print(json.dumps([asdict(one) for one in found], indent=2))
    else:
        width = max(len(one.name) for one in found)
        for one in found:
            print(f"{one.name:<{width}}  {one.state:<7}  {one.detail}")
            if one.fix:
                print(f"{'':<{width}}  fix:    {one.fix}")
    return not any(one.state == "broken" for one in found)


def findings() -> list[Finding]:
    """Look at Python, the packages, the backends, the processor, the GPU, renderers and objectives."""
    found = [
        Finding("loi", "ok", f"{__version__} in {os.path.dirname(os.path.dirname(os.path.dirname(__file__)))}"),  # noqa: PTH120
        Finding("python", "ok", f"{platform.python_version()} at {sys.executable}"),
        Finding("platform", "ok", f"{platform.system()} {platform.machine()}"),
        Finding("threads", "ok", _threads()),
    ]
    found += [
        _package(name, module, "pip install --force-reinstall loi", required=True) for name, module in REQUIRED.items()
    ]
    for name, module in BACKENDS.items():
        found.append(_package(name, module, how_to_install(name), required=False))
        if found[-1].state == "ok":
            diagnose = getattr(sys.modules[module], "diagnose", list)
            found += [Finding(one, "ok", detail) for one, detail in diagnose()]
    found.append(_numba())
    found += [_package(name, name, how_to_install(extra), required=False) for name, extra in EXTRAS.items()]
    found.append(_gpu())
    found += [_plugin("renderer", one) for one in available_renderers()]
    found += [_objective(one) for one in OBJECTIVES.available()]
    return found


def _plugin(kind: str, one: PluginInfo) -> Finding:
    state: State = "ok" if one.state == "ready" else "missing" if one.state == "missing" else "broken"
    return Finding(f"{kind} {one.name}", state, one.problem or f"{one.package} {one.version}", one.fix)


def _objective(one: PluginInfo) -> Finding:
    """Made, and not only imported: what it has learned may not be installed."""
    found = _plugin("objective", one)
    if found.state != "ok":
        return found
    try:
        with contextlib.redirect_stdout(sys.stderr):  # what a plugin prints is not part of our answer
            make_baseline(one.name, np.full((64, 64, 3), 0.5, np.float32), nan_policy="raise", tone=None)
    except WeightsError as error:
        problem, _, fix = str(error).rpartition("; ")
        return Finding(found.name, "missing", problem, fix)
    except LoiError as error:
        return Finding(found.name, "broken", str(error))
    return found


def _threads() -> str:
    limits = [
        f"{name}={os.environ[name]}" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS") if name in os.environ
    ]
    return f"{usable_processors()} usable of {os.cpu_count()}" + (f", limited by {', '.join(limits)}" if limits else "")


def _package(name: str, module: str, fix: str, *, required: bool) -> Finding:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            importlib.import_module(module)
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] in (name, module):
            return Finding(name, "broken" if required else "missing", "not installed", fix)
        return Finding(name, "broken", f"{error}", fix)
    except Exception as error:  # noqa: BLE001 - a half-installed package may raise anything on import
        return Finding(name, "broken", f"{type(error).__name__}: {error}".splitlines()[0], fix)
    try:
        return Finding(name, "ok", version(name))
    except PackageNotFoundError:
        return Finding(name, "ok", "version unknown")


def _numba() -> Finding:
    """Numba comes with loi where it has wheels; what is missing without it is speed alone."""
    found = _package("numba", "numba", "pip install numba", required=False)
    if found.state == "missing":
        return replace(found, detail="not installed; on the processor the loss takes several times as long")
    if found.state == "ok" and not available():
        return replace(found, state="note", detail=f"{found.detail}, switched off by {SWITCH}=0 or NUMBA_DISABLE_JIT=1")
    return found


def _gpu() -> Finding:
    """A GPU as an installed backend sees it; no driver is asked directly."""
    probes: dict[str, Callable[[Any], str]] = {"torch": _torch_gpu, "jax": _jax_gpu}
    for name, probe in probes.items():
        try:
            seen = probe(importlib.import_module(name))
        except Exception:  # noqa: BLE001, S112 - the backend's own finding says what is wrong with it
            continue
        if seen:
            return Finding("gpu", "ok", f"{seen} (by {name})")
    return Finding("gpu", "note", "none seen by torch or jax; everything runs on the processor")


def _torch_gpu(torch: Any) -> str:
    return str(torch.cuda.get_device_name(0)) if torch.cuda.is_available() else ""


def _jax_gpu(jax: Any) -> str:
    devices = [one for one in jax.devices() if one.platform != "cpu"]
    return str(devices[0].device_kind) if devices else ""
