"""Scenes: errors of their parameters, beside the noise of their renderer."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from loi_core import LogTone, LOIObjective
from loi_core.cli import main
from loi_core.cli.bundled import copy_scene
from loi_core.plugins import registry
from loi_core.scenes.reading import load_scene
from loi_core.tradeoff import HIDDEN, Setting, noise, rows, run
from tests.helpers import Host
from tests.tradeoff.command import NUMPY, Plugins, tradeoff

GRAIN_SCENE = """\
target = "target.npy"
{0}
[renderer]
name = "grain"
[optimise.shift]
[scales]
sigma = 1
alpha = 2
beta = 0.25
"""


class Grain:
    """A blob whose image hardly depends on the seed, and whose pullback is off by a known random factor."""

    size: ClassVar[int] = 12

    def __init__(self, spp: int = 4) -> None:
        self._spp = spp

    def parameters(self) -> dict[str, Host]:
        return {"shift": np.zeros(2), "level": np.array(0.5)}

    def render(self, params: Mapping[str, Host], *, seed: int = 0) -> Host:
        image = np.full((self.size, self.size, 3), float(params["level"]))
        image[2:6, 2:6] += 0.3
        return image + 1e-9 * np.random.default_rng(seed).normal(size=image.shape)

    def render_vjp(
        self, params: Mapping[str, Host], *, seed: int = 0
    ) -> tuple[Host, Callable[[Host], dict[str, Host]]]:
        def pullback(cotangent: Host) -> dict[str, Host]:
            slopes = [np.sum(cotangent[2:6, 2:4]), np.sum(cotangent[7:9])]
            return {"shift": self.factor(seed, self._spp) * np.array(slopes), "level": np.sum(cotangent)}

        return self.render(params, seed=seed), pullback

    @staticmethod
    def factor(seed: int, spp: int) -> float:
        return 1.0 + float(np.random.default_rng(seed).normal()) / math.sqrt(spp)


def grain_scene(folder: Path, plugins: Plugins, lines: str = "") -> Path:
    plugins(NUMPY, EntryPoint("grain", "tests.tradeoff.test_scenes:Grain", registry.RENDERERS.name))
    target = np.full((Grain.size, Grain.size, 3), 0.3)
    target[6:10, 6:10] = 0.9
    np.save(folder / "target.npy", target)
    (folder / "scene.toml").write_text(GRAIN_SCENE.format(lines))
    return folder / "scene.toml"


def test_the_noise_of_a_renderer_is_that_of_its_pullback(plugins: Plugins, tmp_path: Path) -> None:
    path = grain_scene(tmp_path, plugins)
    for samples in (4, 16):
        scene = load_scene(path, samples=samples)
        assert scene.samples == samples
        assert noise.is_stochastic(scene)
        found = noise.renderer_noise(scene, 1e-9)
        factors = [Grain.factor(seed, samples) for seed in range(found.seeds)]
        assert found.seeds >= 5
        assert set(found.parameters) == {"shift"}  # the level stays as it is
        # The image differs from seed to seed by 1e-9.
        assert found.least == pytest.approx(np.std(factors, ddof=1) / np.mean(factors), rel=1e-5)


def test_a_scene_s_tone_curve_lies_between_loss_and_renderer(
    plugins: Plugins, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = grain_scene(tmp_path, plugins)
    path.write_text(path.read_text() + "\n[objective]\ntone = { peak = 2 }\n")
    seen: list[run.Problem] = []

    def measure(problem: run.Problem, *_: Any, **__: Any) -> None:
        seen.append(problem)
        raise KeyboardInterrupt

    monkeypatch.setattr("loi_core.cli.tradeoff.measure", measure)
    assert main(["tradeoff", "--scene", str(path), "--output", str(tmp_path / "out")]) == 1
    (problem,) = seen
    scene = problem.scene
    assert scene is not None
    image, pullback = scene.renderer.render_vjp(scene.renderer.parameters(), seed=scene.fit.seed)
    _, wanted = LOIObjective(scene.target, scene.scales, tone=LogTone(2.0)).value_and_grad(image)
    gradient = LOIObjective(problem.reference, problem.scales).value_and_grad(problem.image)[1]
    off = gradient * np.random.default_rng(0).normal(size=gradient.shape)
    size = np.linalg.norm(pullback(wanted)["shift"])
    error = np.linalg.norm(pullback(LogTone(2.0).pullback(image, off))["shift"]) / size
    assert noise.PulledBack(scene, gradient).error(gradient + off) == pytest.approx(error, rel=1e-9)


def test_a_stochastic_scene_is_judged_by_its_own_noise(
    plugins: Plugins, by_arrays: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = tradeoff(tmp_path / "out", capsys, "--scene", str(grain_scene(tmp_path, plugins)))
    assert found["stochastic"] is True
    assert [one["samples"] for one in found["noises"]] == [1, 4, 16]
    advice = found["recommendation"]
    own = found["noises"][1]["least"]
    assert advice["noise"] == own
    assert advice["allowed"] == pytest.approx(HIDDEN * own)
    row = found["rows"][advice["index"]]
    assert advice["error"] == row["parameter_error"] <= advice["allowed"]
    assert f"{own:.1e}" in advice["sentence"]
    assert "4 samples" in advice["sentence"]


def test_a_scene_where_nothing_is_random_is_judged_by_what_balanced_promises(
    plugins: Plugins, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    copy_scene("disks", tmp_path)
    plugins(NUMPY, EntryPoint("disks", "loi_core.renderers:Disks", registry.RENDERERS.name))
    scene = load_scene(tmp_path / "scene.toml")
    assert scene.samples is None

    def half_off(target: str, setting: Setting, image: Host, reference: Host, seconds: float) -> rows.Sample:
        exact = LOIObjective(reference, scene.scales).value_and_grad(image)[1]
        return rows.Sample("cpu", 1.0, 1, None, (1.0 if setting.accuracy == "exact" else 1.5) * exact)

    monkeypatch.setattr(run, "measure_setting", half_off)
    found = tradeoff(tmp_path / "out", capsys, "--scene", str(tmp_path / "scene.toml"))
    assert (found["stochastic"], found["noises"]) == (False, [])
    for row in found["rows"]:
        # A pullback is linear: half of the image's gradient is half of the parameters'.
        wanted = 0.0 if row["accuracy"] == "exact" else 0.5
        assert row["error"] == pytest.approx(wanted, abs=1e-6)
        assert row["parameter_error"] == pytest.approx(wanted, abs=1e-5)
    assert found["rows"][found["recommendation"]["index"]]["accuracy"] == "exact"
    assert "nothing is random here" in found["recommendation"]["sentence"]
