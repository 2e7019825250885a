"""``loi doctor``: the state of every part of the installation, and the commands that repair it."""

from __future__ import annotations

import argparse
import contextlib
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
from loi_core.cli.codes import DONE, FAILED
from loi_core.errors import LoiError, WeightsError
from loi_core.method.compiled import SWITCH, available
from loi_core.plugins.baselines import make_baseline
from loi_core.plugins.registry import OBJECTIVES, PluginInfo, available_renderers
from loi_core.support.installed import how_to_install, import_library
from loi_core.support.processors import usable_processors

__all__ = ["Finding", "findings", "run"]

State = Literal["ok", "missing", "broken", "note"]


@dataclass(frozen=True)
class Finding:
    """The state of one part of the installation.

    Attributes
    ----------
    name : str
    state : {"ok", "missing", "broken", "note"}
        "missing" is an optional part that is not installed; "broken" a part that is installed and does not work.
    detail : str
        Version, or the problem.
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
    "filelock": "filelock",
    "pillow": "PIL",
    "OpenEXR": "OpenEXR",
    "shtab": "shtab",
    "tqdm": "tqdm",
}
# Each is imported by its adapter: loi_mitsuba has to come before mitsuba, to choose the LLVM.
BACKENDS: Final = {"torch": "loi_torch", "jax": "loi_jax", "mitsuba": "loi_mitsuba"}
EXTRAS: Final = {
    "kornia": "kornia",
    "trimesh": "mesh",
    "svgelements": "svg",
    "distributed": "dask",
    "matplotlib": "plots",
}


def run(options: argparse.Namespace) -> int:
    """Print all findings, or the table of hard cases; FAILED if a part is broken."""
    if options.stability:
        from loi_core.cli.stability import examine_stability

        return DONE if examine_stability(as_json=options.json) else FAILED
    listed = findings()
    if options.json:
        print(json.dumps([asdict(finding) for finding in listed], indent=2))
    else:
        width = max(len(finding.name) for finding in listed)
        for finding in listed:
            print(f"{finding.name:<{width}}  {finding.state:<7}  {finding.detail}")
            if finding.fix:
                print(f"{'':<{width}}  fix:    {finding.fix}")
    return FAILED if any(finding.state == "broken" for finding in listed) else DONE


def findings() -> list[Finding]:
    """Examine Python, the packages, the backends, the processor, the GPU, renderers and objectives."""
    listed = [
        Finding("loi", "ok", f"{__version__} in {os.path.dirname(os.path.dirname(os.path.dirname(__file__)))}"),  # noqa: PTH120
        Finding("python", "ok", f"{platform.python_version()} at {sys.executable}"),
        Finding("platform", "ok", f"{platform.system()} {platform.machine()}"),
        Finding("threads", "ok", _threads()),
    ]
    listed += [
        _package(name, module, "pip install --force-reinstall loi", required=True) for name, module in REQUIRED.items()
    ]
    for name, module in BACKENDS.items():
        listed.append(_package(name, module, how_to_install(name), required=False))
        if listed[-1].state == "ok":
            diagnose = getattr(sys.modules[module], "diagnose", list)
            listed += [Finding(topic, "ok", detail) for topic, detail in diagnose()]
    listed.append(_numba())
    listed += [_package(name, name, how_to_install(extra), required=False) for name, extra in EXTRAS.items()]
    listed.append(_gpu())
    listed += [_plugin("renderer", info) for info in available_renderers()]
    listed += [_objective(info) for info in OBJECTIVES.available()]
    return listed


def _plugin(role: str, info: PluginInfo) -> Finding:
    state: State = "ok" if info.state == "ready" else "missing" if info.state == "missing" else "broken"
    return Finding(f"{role} {info.name}", state, info.problem or f"{info.package} {info.version}", info.fix)


def _objective(info: PluginInfo) -> Finding:
    """Construct an objective, since its learned weights may not be installed."""
    finding = _plugin("objective", info)
    if finding.state != "ok":
        return finding
    try:
        with contextlib.redirect_stdout(sys.stderr):  # a plugin's own output is not part of the answer
            make_baseline(info.name, np.full((64, 64, 3), 0.5, np.float32), nan_policy="raise", tone=None)
    except WeightsError as error:
        problem, _, fix = str(error).rpartition("; ")
        return Finding(finding.name, "missing", problem, fix)
    except LoiError as error:
        return Finding(finding.name, "broken", str(error))
    return finding


def _threads() -> str:
    limits = [
        f"{name}={os.environ[name]}" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS") if name in os.environ
    ]
    return f"{usable_processors()} usable of {os.cpu_count()}" + (f", limited by {', '.join(limits)}" if limits else "")


def _package(name: str, module: str, fix: str, *, required: bool) -> Finding:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import_library(module)
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
    """Examine Numba, which is installed with loi where it has wheels; without it only speed is lost."""
    finding = _package("numba", "numba", "pip install numba", required=False)
    if finding.state == "missing":
        return replace(finding, detail="not installed; on the processor the loss takes several times as long")
    if finding.state == "ok" and not available():
        detail = f"{finding.detail}, switched off by {SWITCH}=0 or NUMBA_DISABLE_JIT=1"
        return replace(finding, state="note", detail=detail)
    return finding


def _gpu() -> Finding:
    """Examine the GPU through the installed backends, and not through a driver."""
    probes: dict[str, Callable[[Any], str]] = {"torch": _torch_gpu, "jax": _jax_gpu}
    for name, probe in probes.items():
        try:
            device = probe(import_library(name))
        except Exception:  # noqa: BLE001, S112 - the backend's own finding describes the problem
            continue
        if device:
            return Finding("gpu", "ok", f"{device} (by {name})")
    return Finding("gpu", "note", "torch and jax find none; everything runs on the processor")


def _torch_gpu(torch: Any) -> str:
    return str(torch.cuda.get_device_name(0)) if torch.cuda.is_available() else ""


def _jax_gpu(jax: Any) -> str:
    devices = [device for device in jax.devices() if device.platform != "cpu"]
    return str(devices[0].device_kind) if devices else ""
