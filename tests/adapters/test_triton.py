"""The Triton kernels compute what whole-array operations do, compile for GPUs, and keep launches and memory low.

All of it runs without a GPU: kernels are interpreted, compiled to machine code, or counted.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from loi_core import ScaleSpace
from loi_core.method.dispatch import ARRAY_API, choose_backend, register_backend
from loi_core.method.planner import make_plan
from tests.environments import run
from tests.frameworks import torch
from tests.strategies import THOROUGH, thorough

pytest.importorskip("triton")


def test_values_and_gradients_are_those_of_whole_array_operations() -> None:
    run(sys.executable, "-m", "tests.adapters.triton_program", cwd=Path.cwd(), TRITON_INTERPRET="1")


COMPILED_SCALES: dict[str, tuple[ScaleSpace, int, int, bool]] = {
    "default": (ScaleSpace.for_image(192, 256), 192, 256, False),
    "large": (ScaleSpace.for_image(1080, 1920), 1080, 1920, True),
    "path": (ScaleSpace.paper("path"), 192, 256, False),
    "centred": (ScaleSpace(1.0, 40.0, 0.125, centred=True), 96, 128, False),
    "power": (ScaleSpace(1.0, (40.0, 60.0), 0.0625, (1, 2), "zero", p=2.0), 96, 128, False),
}


SHARED_BYTES = 99 * 2**10  # of the GPUs with the least, of compute capability 8.6


@pytest.mark.parametrize("capability", [pytest.param(80, marks=thorough), 90])
def test_every_kernel_compiles_without_spilling_registers_or_much_shared_memory(
    capability: int, tmp_path: Path
) -> None:
    import triton
    from triton.backends.compiler import GPUTarget
    from triton.backends.nvidia.compiler import get_ptxas

    from loi_torch.triton_backend.cost import cost_of

    used = {}
    for scales, height, width, weighted in COMPILED_SCALES.values():
        for launch in cost_of(scales, height, width, weighted=weighted).launches:
            if not isinstance(launch.kernel, str):
                used[launch.kernel.__name__, *launch.constants.values()] = launch
    # One of each kernel, the one of the largest tiles: all take minutes.
    largest = {name: (name, *rest) for name, *rest in sorted(used)}
    assert set(largest) == set(kernel_names())
    chosen = used if THOROUGH else {key: used[key] for key in largest.values()}
    for key, launch in chosen.items():
        target = GPUTarget("cuda", capability, 32)
        kernel = triton.compile(_source(launch), target=target, options={**launch.options, "enable_fp_fusion": True})
        assert kernel.metadata.shared <= SHARED_BYTES
        code = kernel.asm
        ptx = tmp_path / "kernel.ptx"
        ptx.write_text(code["ptx"])
        architecture = re.search(r"\.target (\w+)", code["ptx"])[1]  # type: ignore[index]  # every program has one
        command = [get_ptxas(capability).path, "-v", f"--gpu-name={architecture}", ptx, "-o", os.devnull]
        report = subprocess.run(command, capture_output=True, text=True, check=True).stderr
        assert re.findall(r"(\d+) bytes spill stores", report) == ["0"], f"{key}: {report}"


def kernel_names() -> list[str]:
    from loi_torch.triton_backend import kernels

    return kernels.__all__


def _source(launch: Any) -> Any:
    """Return what Triton compiles for a launch, with the types and divisibilities of its arguments."""
    from triton.compiler import ASTSource

    names = launch.kernel.arg_names
    types: dict[str, str] = {}
    constants: dict[str, Any] = {}
    attributes = {}
    for index, name in enumerate(names):
        value = launch.constants[name] if name in launch.constants else launch.arguments[index]
        if name in launch.constants or (isinstance(value, int) and value == 1):
            types[name], constants[name] = "constexpr", value
        elif isinstance(value, float):
            types[name] = "fp32"
        else:
            types[name] = "i32" if isinstance(value, int) else {torch.int32: "*i32", torch.float32: "*fp32"}[value]
            if not isinstance(value, int) or value % 16 == 0:
                attributes[index,] = [["tt.divisibility", 16]]
    return ASTSource(launch.kernel, types, constexprs=constants, attrs=attributes)


@pytest.mark.parametrize(("size", "milliseconds"), [((192, 256), 1.0), ((512, 512), 2.0), ((1080, 1920), 10.0)])
def test_a_comparison_in_the_paper_scales_takes_150_mebibytes_and_10_milliseconds(
    size: tuple[int, int], milliseconds: float
) -> None:
    from loi_torch.triton_backend.cost import cost_of

    cost = cost_of(ScaleSpace.paper("path"), *size)
    assert cost.peak_bytes <= 150 * 2**20
    assert 1e3 * cost.seconds() <= milliseconds
    assert len(cost.launches) <= 240


@pytest.mark.parametrize("size", [(192, 256), (512, 512), (1080, 1920)])
def test_a_comparison_in_the_default_scales_takes_30_launches_and_100_mebibytes(size: tuple[int, int]) -> None:
    from loi_torch.triton_backend.cost import cost_of

    cost = cost_of(ScaleSpace.for_image(*size), *size)
    assert len(cost.launches) <= 30
    assert cost.peak_bytes <= 100 * 2**20


def test_the_memory_does_not_grow_with_the_levels() -> None:
    from loi_torch.triton_backend.cost import cost_of

    few, many = (cost_of(ScaleSpace(1, (1, 20), beta), 270, 480) for beta in (1 / 256, 1 / 1024))
    assert many.peak_bytes <= 1.2 * few.peak_bytes


def test_images_on_the_processor_and_other_dtypes_are_left_to_other_backends(monkeypatch: pytest.MonkeyPatch) -> None:
    from loi_torch.triton_backend.backend import TRITON, TritonWarning, supports

    class Image:
        device = torch.device("cuda", 0)
        dtype = torch.float64

    assert not supports(torch.zeros(1, 2, 2))
    monkeypatch.setattr("loi_torch.triton_backend.backend.is_torch_array", lambda image: True)
    monkeypatch.setattr("loi_torch.triton_backend.backend.is_recorded", lambda image: False)
    monkeypatch.setattr("loi_torch.triton_backend.backend._problem", lambda device: "")
    with pytest.warns(TritonWarning, match="float64"):
        assert not supports(Image())
    Image.dtype = torch.float32
    assert supports(Image())
    monkeypatch.setenv("LOI_COMPILED", "0")
    assert not supports(Image())
    monkeypatch.setattr("loi_core.method.dispatch._REGISTERED", [])
    register_backend(lambda image: image.device.type == "meta", TRITON)
    assert choose_backend(torch.zeros(1, 2, 2, device="meta")) is TRITON
    assert choose_backend(torch.zeros(1, 2, 2, dtype=torch.float16)) is ARRAY_API


def test_whole_arrays_take_over_where_kernels_fail() -> None:
    from loi_torch.triton_backend.backend import TRITON, TritonWarning, _warn

    scales = ScaleSpace.for_image(12, 16)
    plan = make_plan(scales, 12, 16, tolerance=0.0, eps=float(torch.finfo(torch.float32).eps))
    image, reference, weights = torch.rand((3, 2, 12, 16), generator=torch.Generator().manual_seed(0))
    _warn.cache_clear()
    with pytest.warns(TritonWarning, match="kernels fail"):  # there is no GPU
        result = TRITON.comparison(scales, plan, reference).with_weights(weights).compare(image, gradient=True)
    expected = ARRAY_API.comparison(scales, plan, reference, weights).compare(image, gradient=True)
    assert result.terms == expected.terms
    assert torch.equal(result.cotangent, expected.cotangent)
