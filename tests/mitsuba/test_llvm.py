"""Dr.Jit loads an LLVM that works, and one that is too old is refused."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import loi_mitsuba
from mitsuba_boundaries import llvm

LLVM_15 = [
    path
    for folder in ("/usr/lib/x86_64-linux-gnu", "/usr/lib/aarch64-linux-gnu", "/usr/lib64")
    for path in sorted(Path(folder).glob("libLLVM-15.so*"))
]
CHOICE = loi_mitsuba.prepare()
HAS_WHEEL = bool(llvm._wheel_files("libLLVM"))

RENDER = """
import loi_mitsuba, mitsuba as mi, drjit as dr
mi.set_variant("llvm_ad_rgb")
low = dr.minimum(mi.Float([1, 2]), mi.Float([2, 1]))  # with LLVM 15, this aborts the process
print(low, loi_mitsuba.prepare())
"""


def run(code: str, library: str | None) -> subprocess.CompletedProcess[str]:
    env = {name: value for name, value in os.environ.items() if name != llvm.VARIABLE}
    if library is not None:
        env[llvm.VARIABLE] = library
    env["PYTHONPATH"] = os.pathsep.join(sys.path)
    return subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, timeout=60)


def test_a_fresh_process_loads_an_llvm_that_works() -> None:
    done = run(RENDER, None)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split()[:2] == ["[1,", "1]"]
    assert (f"source='{llvm.WHEEL}'" in done.stdout) == HAS_WHEEL


@pytest.mark.skipif(not HAS_WHEEL, reason="the wheel with LLVM is not installed")
def test_the_environment_variable_takes_precedence() -> None:
    done = run(RENDER, str(llvm._wheel_files("libLLVM")[0]))
    assert f"source='{llvm.VARIABLE}'" in done.stdout, done.stderr


@pytest.mark.skipif(not LLVM_15, reason="LLVM 15 is not installed")
def test_llvm_15_raises_an_error_instead_of_aborting() -> None:
    done = run(RENDER, str(LLVM_15[0]))
    assert done.returncode == 1
    message = done.stderr.strip().splitlines()[-1]
    assert "LLVMError: Mitsuba needs LLVM 16 or later, but Dr.Jit has loaded LLVM 15 (DRJIT_LIBLLVM_PATH)" in message
    assert f"pip install {llvm.WHEEL}" in message


@pytest.mark.skipif(not LLVM_15, reason="LLVM 15 is not installed")
def test_a_dr_jit_that_has_loaded_llvm_15_already_is_refused() -> None:
    code = f"import os, drjit; os.environ.pop({llvm.VARIABLE!r}); import loi_mitsuba"
    done = run(code, str(LLVM_15[0]))
    assert (
        "has loaded LLVM 15 (Dr.Jit); import loi_mitsuba or mitsuba_boundaries before drjit and mitsuba" in done.stderr
    )


def test_a_second_call_of_prepare_changes_nothing() -> None:
    environment: Any = dict(os.environ)
    assert loi_mitsuba.prepare() is CHOICE
    assert dict(os.environ) == environment


def test_doctor_lists_the_version_of_llvm() -> None:
    assert loi_mitsuba.diagnose() == [("LLVM", f"{CHOICE.version} ({CHOICE.source})")]
