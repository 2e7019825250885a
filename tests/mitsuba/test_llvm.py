"""Dr.Jit gets an LLVM that works, and one that does not is refused before it is loaded."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import loi_mitsuba
from loi_mitsuba.drjit import llvm

OLD = [
    path
    for folder in ("/usr/lib/x86_64-linux-gnu", "/usr/lib/aarch64-linux-gnu", "/usr/lib64")
    for version in (14, 15)
    for path in sorted(Path(folder).glob(f"libLLVM-{version}.so*"))
]
CHOICE = loi_mitsuba.prepare()

RENDER = """
import loi_mitsuba, mitsuba as mi, drjit as dr
mi.set_variant("llvm_ad_rgb")
low = dr.minimum(mi.Float([1, 2]), mi.Float([2, 1]))  # what LLVM 15 dies of
print(low, loi_mitsuba.prepare().version)
"""


def run(code: str, path: str | None) -> subprocess.CompletedProcess[str]:
    env = {name: value for name, value in os.environ.items() if name != llvm.VARIABLE}
    if path is not None:
        env[llvm.VARIABLE] = path
    env["PYTHONPATH"] = os.pathsep.join(sys.path)
    return subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, timeout=60)


def test_a_fresh_process_finds_one_that_works() -> None:
    done = run(RENDER, None)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split()[:2] == ["[1,", "1]"]


@pytest.mark.skipif(CHOICE.path is None, reason="Dr.Jit found its own LLVM here")
def test_the_variable_is_taken_at_its_word() -> None:
    done = run("import loi_mitsuba; print(loi_mitsuba.choose_llvm())", str(CHOICE.path))
    assert f"source='{llvm.VARIABLE}'" in done.stdout, done.stderr


@pytest.mark.parametrize("path", OLD, ids=lambda path: path.name)
def test_an_old_one_is_an_error_not_an_abort(path: Path) -> None:
    done = run(RENDER, str(path))
    assert done.returncode == 1
    last = done.stderr.strip().splitlines()[-1]
    assert "LLVMError: `DRJIT_LIBLLVM_PATH` must name LLVM 16 or later" in last
    assert f"LLVM {llvm.library_version(path)}; unset it and {llvm._fix()}" in last


@pytest.mark.skipif(not OLD, reason="no old LLVM here to point at")
def test_neither_a_link_nor_another_name_hides_an_old_one(tmp_path: Path) -> None:
    link, other = tmp_path / "libLLVM.so", tmp_path / "libLLVM-19.so"
    link.symlink_to(OLD[0])
    other.symlink_to(OLD[0])
    for path in (link, other):
        assert llvm.library_version(path) in (14, 15)


@pytest.mark.skipif(not OLD, reason="no old LLVM here for Dr.Jit to find")
def test_a_dr_jit_that_has_loaded_an_old_one_is_refused() -> None:
    path = next((path for path in OLD if "15" in path.name), None)
    if path is None:
        pytest.skip("Dr.Jit itself refuses LLVM 14")
    code = f"import os, drjit; os.environ.pop({llvm.VARIABLE!r}); import loi_mitsuba"
    done = run(code, str(path))
    assert "LLVMError: Dr.Jit has loaded LLVM 15 already" in done.stderr
    assert "import loi_mitsuba before drjit and mitsuba" in done.stderr


@pytest.mark.parametrize(
    ("name", "version"),
    [("libLLVM-15.so.1", 15), ("libLLVM.so.23.1", 23), ("libLLVM.so.22.1-rust", 22), ("libLLVM.so", None)],
)
def test_without_a_soname_the_file_name_tells(tmp_path: Path, name: str, version: int | None) -> None:
    for content in (b"", b"INPUT(libsomething.so)", b"\x7fELF\x02\x01" + b"\0" * 10, b"\x7fELF\x02\x01" + b"\xff" * 90):
        (tmp_path / name).write_bytes(content)
        assert llvm.library_version(tmp_path / name) == version


def test_the_order_of_sources(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def make(*names: str) -> list[Path]:
        for name in names:
            (tmp_path / name).write_bytes(b"")
        return [tmp_path / name for name in names]

    monkeypatch.delenv(llvm.VARIABLE, raising=False)
    monkeypatch.setattr("platform.system", lambda: "Linux")
    monkeypatch.setattr("platform.machine", lambda: "x86_64")
    monkeypatch.setattr(llvm, "_system_folders", lambda: [tmp_path])
    monkeypatch.setattr(llvm, "_wheel_files", lambda stem: [])
    with pytest.raises(llvm.LLVMError, match="needs LLVM 16 or later, none was found; pip install karellen-llvm-core"):
        llvm.choose_llvm()
    with monkeypatch.context() as patch:
        patch.setattr("platform.machine", lambda: "aarch64")  # for which there is no wheel
        with pytest.raises(llvm.LLVMError, match="none was found; install LLVM 16 or later of your system, or set"):
            llvm.choose_llvm()
    make("libLLVM-15.so.1", "libLLVM-14.so", "libLLVMDemangle.so")
    with pytest.raises(llvm.LLVMError, match="the system has LLVM 14 and LLVM 15 only"):
        llvm.choose_llvm()
    wheel = tmp_path / "wheel"
    wheel.mkdir()
    (wheel / "libLLVM.so.23.1").write_bytes(b"")
    monkeypatch.setattr(llvm, "_wheel_files", lambda stem: [wheel / "libLLVM.so.23.1"])
    choice = llvm.choose_llvm()
    assert (choice.source, choice.version) == (llvm.WHEEL, 23)
    assert "LLVM 14 and LLVM 15 of the system passed over" in choice.reason
    for name, version in (("libLLVM.so.17.0", 17), ("libLLVM.so.19.1", 19), ("libLLVM.so.30.1", 19)):
        make(name)
        choice = llvm.choose_llvm()
        assert (choice.source, choice.version) == ("system", version)  # seen to work goes before newer
    monkeypatch.setenv(llvm.VARIABLE, str(tmp_path / "libLLVM.so.17.0"))
    assert llvm.choose_llvm().version == 17
    for wrong, says in (("nothing.so", "which is no file"), ("libLLVMDemangle.so", "a file of unknown version")):
        monkeypatch.setenv(llvm.VARIABLE, str(tmp_path / wrong))
        with pytest.raises(llvm.LLVMError, match=says):
            llvm.choose_llvm()


def test_preparing_again_changes_nothing() -> None:
    before: Any = dict(os.environ)
    assert loi_mitsuba.prepare() is CHOICE
    assert dict(os.environ) == before
