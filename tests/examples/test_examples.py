"""Tests of the examples in the README and the documentation: they run and reproduce the documented output."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest
import trimesh

from tests.strategies import thorough

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("options", [["--quick"], pytest.param([], marks=thorough)], ids=["quick", "full"])
def test_every_documented_tolerance_holds(options: list[str]) -> None:
    command = [sys.executable, "-m", "examples.checks", *options]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stdout + done.stderr
    rows = [line.split(" | ")[0].removeprefix("| ") for line in done.stdout.splitlines()[2:]]
    documented = (ROOT / "docs" / "mathematics.md").read_text()
    assert len(rows) == 9
    assert all(f"| {name} | " in documented for name in rows)


@thorough
def test_noise_changes_the_gradient_as_documented(tmp_path: Path) -> None:
    plot = tmp_path / "noise.png"
    done = subprocess.run(
        [sys.executable, "-m", "examples.noise", "--quick", "--output", str(plot)],
        capture_output=True,
        text=True,
        cwd=ROOT,
        check=True,
    )
    assert plot.stat().st_size > 10_000
    documented = (ROOT / "docs" / "results" / "noise.md").read_text()
    tables = [block for block in done.stdout.split("\n\n") if block.startswith("|")]
    rows = [line.split(" | ") for table in tables for line in table.splitlines()[2:]]
    assert len(tables) == 3
    assert len(rows) == 3 * 7
    assert all(f"{row[0]} | " in documented for row in rows)
    # From far, with noise of a tenth of the range, the loss points to the goal for every seed, unlike pixel L2.
    shares = {row[0].removeprefix("| "): row[1].split(", ")[-1] for row in rows[:7]}
    assert all(shares[f"loi, {preset}"] == "100%" for preset in ("vector", "path", "for_image"))
    assert shares["pixel L2"] != "100%"


def test_the_logo_example_fits_a_position_where_pixels_fail(tmp_path: Path) -> None:
    plot = tmp_path / "logo.png"
    done = subprocess.run(
        [sys.executable, "-m", "examples.logo", "--quick", "--output", str(plot)],
        capture_output=True,
        text=True,
        cwd=ROOT,
        check=True,
    )
    assert plot.stat().st_size > 5_000
    loi_error, pixel_error = (float(cell) for cell in done.stdout.splitlines()[-1].strip("| ").split(" | ")[1:])
    assert loi_error < 0.5  # pixels of 48; the full example ends closer, and prints its error
    assert pixel_error > 10.0


SETUPS = {
    "LOIObjective(": """
        from loi_core.renderers import Disks
        renderer = Disks(height, width, [[5.0, 9.0]], 3.0, [[1.0, 0.5, 0.2]])
        params = renderer.parameters()
        update = lambda params, gradient: {k: params[k] - 10.0 * gradient[k] for k in params}
    """,
    "loi_torch": """
        import torch, loi_torch
        from loi_core import ScaleSpace
        params = torch.full((height, width, 3), 0.2, dtype=torch.float64, requires_grad=True)
        render = torch.sigmoid
        optimizer = torch.optim.Adam([params], lr=0.1)
    """,
    "loi_jax": """
        import jax, jax.numpy as jnp, optax, loi_jax
        from loi_core import ScaleSpace
        params = {"image": jnp.full((height, width, 3), 0.2)}
        render = lambda params: params["image"]
        optimizer = optax.adam(0.1)
    """,
    "loi_mitsuba": """
        import loi_mitsuba, mitsuba as mi, drjit as dr
        from loi_core import ScaleSpace
        mi.set_variant("llvm_ad_rgb")
        film = {"type": "hdrfilm", "width": width, "height": height, "filter": {"type": "box"}}
        colour = {"type": "rgb", "value": [0.2, 0.2, 0.2]}
        view = mi.ScalarTransform4f().look_at([0, 0, 3], [0, 0, 0], [0, 1, 0])
        scene = mi.load_dict({
            "type": "scene",
            "integrator": {"type": "prb", "max_depth": 2},
            "sensor": {"type": "perspective", "film": film, "to_world": view},

            "light": {"type": "constant"},
            "ball": {"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": colour}},
        })
        params = mi.traverse(scene)
        optimizer = mi.ad.Adam(lr=0.05)
        optimizer["ball.bsdf.reflectance.value"] = params["ball.bsdf.reflectance.value"]
        params.update(optimizer)
    """,
}


@pytest.mark.parametrize("name", SETUPS)
def test_the_snippets_of_the_readme_are_eight_lines_and_run(name: str) -> None:
    text = (ROOT / "README.md").read_text()
    snippets = [block.split("```")[0] for block in text.split("```python\n")[1:]]
    (snippet,) = [snippet for snippet in snippets if name in snippet and "loi_torch.mesh" not in snippet]
    assert len([line for line in snippet.splitlines() if line and "import" not in line]) <= 8
    assert "range(200)" in snippet
    start = "import loi\nimport numpy as np\nheight, width = 12, 16\n"
    start += "photograph = np.full((height, width, 3), 0.7)\n"
    ending = {
        "LOIObjective(": "assert float(value) > 0.0",
        "loi_torch": "assert (params > 0.2).all()",
        "loi_jax": "assert (params['image'] > 0.2).all()",
        "loi_mitsuba": "assert min(params['ball.bsdf.reflectance.value'].numpy().ravel()) > 0.2",
    }[name]
    code = start + textwrap.dedent(SETUPS[name]) + snippet.replace("range(200)", "range(3)") + ending
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_first_loop_of_the_readme_finds_a_disk_that_its_render_does_not_overlap() -> None:
    snippets = [block.split("```")[0] for block in (ROOT / "README.md").read_text().split("```python\n")[1:]]
    start = """
        import numpy as np
        from loi_core.renderers import Disks

        height, width = 48, 64
        renderer = Disks(height, width, [[50.0, 36.0]], 5.0, [[1.0, 0.5, 0.2]], background=(0.2, 0.2, 0.3))
        photograph = renderer.render(renderer.parameters())
        params = {**renderer.parameters(), "positions": np.array([[12.0, 10.0]])}

        def update(params, gradient):
            slope = gradient["positions"]
            return {**params, "positions": params["positions"] - 0.5 * slope / np.linalg.norm(slope)}
    """
    code = textwrap.dedent(start) + snippets[0] + "assert np.allclose(params['positions'], [[50.0, 36.0]], atol=0.5)"
    subprocess.run([sys.executable, "-W", "error", "-c", code], check=True)


def test_the_far_to_near_loop_of_the_readme_fits_a_spot_on_stripes() -> None:
    snippets = [block.split("```")[0] for block in (ROOT / "README.md").read_text().split("```python\n")[1:]]
    (snippet,) = [snippet for snippet in snippets if "loi_torch.LOILoss(" in snippet and "mesh" not in snippet]
    start = """
        import loi
        import loi_torch
        import torch

        height, width = 48, 64
        y, x = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
        params = torch.tensor([12.0, 10.0], requires_grad=True)
        optimizer = torch.optim.Adam([params], lr=0.5)

        def render(place):
            spot = torch.exp(-((x - place[0]) ** 2 + (y - place[1]) ** 2) / 32)
            return (spot + (1 - spot) * (0.3 + 0.1 * torch.sin(x)))[..., None].expand(-1, -1, 3)

        photograph = render(torch.tensor([48.0, 36.0]))
    """
    code = textwrap.dedent(start) + snippet + "assert torch.dist(params, torch.tensor([48.0, 36.0])) < 0.5, params"
    subprocess.run([sys.executable, "-W", "error", "-c", code], check=True)


def test_the_readme_fits_a_mesh_in_under_twenty_lines(tmp_path: Path) -> None:
    snippets = [block.split("```")[0] for block in (ROOT / "README.md").read_text().split("```python\n")[1:]]
    (snippet,) = [snippet for snippet in snippets if "loi_torch.mesh" in snippet]
    assert len(snippet.splitlines()) < 20
    trimesh.creation.box().export(tmp_path / "crate.glb")
    start = "import numpy as np\nheight, width = 12, 16\nphotograph = np.full((height, width, 3), 0.1)\n"
    code = start + snippet.replace("range(300)", "range(3)") + "assert bool((place != 0.0).any())"
    subprocess.run([sys.executable, "-c", code], check=True, cwd=tmp_path)


@pytest.mark.parametrize(
    ("name", "target", "tolerance"),
    [
        ("numpy", (75.0, 45.0), 0.5),
        pytest.param(
            "torch", (75.0, 45.0), 0.5, marks=thorough
        ),  # the same loop as in the guide, whose test always runs
        pytest.param("mesh", (2.0, -0.8, 0.0), 0.05, marks=thorough),  # scene units; a pixel is 0.09
        pytest.param("tensorboard", (75.0, 45.0), 0.5, marks=thorough),
        pytest.param("torch_distributed", (15.0, 45.0, -10.0), 0.5, marks=thorough),
        pytest.param("jax", (75.0, 45.0), 0.5, marks=thorough),
        pytest.param("jax_sharding", (15.0, 45.0, -10.0), 0.5, marks=thorough),
        pytest.param("mitsuba", (1.5, -1.0), 0.1, marks=thorough),  # scene units; a pixel is 0.12
    ],
)
def test_the_loops_of_the_readme_converge_from_starts_without_overlap(
    name: str, target: tuple[float, ...], tolerance: float
) -> None:
    ranks = ("torch.distributed.run", "--standalone", "--nproc-per-node", "2", "-m") if "distributed" in name else ()
    command = [sys.executable, "-m", *ranks, f"examples.loops.with_{name}"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=True)
    result = [float(word) for word in done.stdout.split()]
    assert result == pytest.approx(target, abs=tolerance)


def output_on_stubs(module: str) -> str:
    """Return the output of a program, with stand-ins for libraries that need a GPU or a build."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent / "stubs"), *sys.path])}
    command = [sys.executable, "-m", module]
    return subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=True, env=environment).stdout


@pytest.mark.parametrize(
    ("name", "package", "tolerance"),
    [
        ("torchreg", "torchreg", 0.3),  # pixels
        pytest.param("nanodrr", "nanodrr", 1.0, marks=thorough),  # mm; a pixel is 5.8
        pytest.param("gsplat", None, 0.2, marks=thorough),  # world units; a pixel is 0.1; on a stand-in for gsplat
        pytest.param("pytorch3d", None, 0.1, marks=thorough),  # world units; on a stand-in for PyTorch3D
        ("roboreg", None, 0.3),  # pixels
        pytest.param("bpy", None, 0.1, marks=thorough),  # Blender's units; a pixel is 0.1; on a stand-in for bpy
    ],
)
def test_loops_of_other_libraries_arrive_where_l2_is_lost(name: str, package: str | None, tolerance: float) -> None:
    if package:
        pytest.importorskip(package)
    truths = {"torchreg": (-24.0, -19.0), "roboreg": (50.0, 34.0)}
    errors = {}
    for line in output_on_stubs(f"examples.loops.with_{name}").splitlines():
        loss, text = line.split(maxsplit=1)
        errors[loss] = np.abs(np.subtract(json.loads(text), truths.get(name, 0.0))).max()
    assert errors["loi"] <= tolerance
    assert errors["L2"] > 3.0 * tolerance


@thorough
def test_more_turns_of_a_cube_are_found_than_by_l2_without_random_search() -> None:
    lines = output_on_stubs("examples.loops.with_nvdiffrast").splitlines()
    found = {loss: int(text) for loss, text in (line.split() for line in lines)}
    assert found["loi"] >= 12  # of 16
    assert found["loi"] > found["L2"]


@thorough
def test_pixel_losses_are_enough_for_gaussians_that_cover_their_image() -> None:
    lines = output_on_stubs("examples.loops.with_gsplat_image").splitlines()
    psnr = {name: float(text.removesuffix(" dB")) for name, text in (line.split(": ") for line in lines)}
    assert list(psnr) == ["L2", "L1 and SSIM", "loi"]
    assert min(psnr.values()) > 15.0  # 6.8 dB for the photograph's mean colour
    assert max(psnr.values()) - min(psnr.values()) < 3.0


def test_optuna_finds_settings_of_a_fit_that_pixels_confirm() -> None:
    pytest.importorskip("optuna")
    command = [sys.executable, "-m", "examples.loops.with_optuna"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=True)
    assert float(done.stdout.split()[-1]) < 1e-3  # of 0.1 at the start
    assert "pruned" in done.stderr
