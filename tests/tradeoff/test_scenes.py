"""Scenes: errors of their parameters, compared with the noise of their renderer."""

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
from loi_core.tradeoff import MAX_NOISE_FRACTION, Row, Setting, noise, run
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
    """A blob whose image hardly depends on the seed, and whose pullback has a known random factor."""

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


def test_the_noise_of_a_renderer_is_the_noise_of_its_pullback(plugins: Plugins, tmp_path: Path) -> None:
    path = grain_scene(tmp_path, plugins)
    for samples in (4, 16):
        scene = load_scene(path, samples=samples)
        assert scene.samples == samples
        assert noise.is_stochastic(scene)
        measured = noise.renderer_noise(scene, 1e-9)
        factors = [Grain.factor(seed, samples) for seed in range(measured.seeds)]
        assert measured.seeds >= 5
        assert set(measured.parameters) == {"shift"}  # the level is not optimised
        # The image differs from seed to seed by 1e-9.
        assert measured.least == pytest.approx(np.std(factors, ddof=1) / np.mean(factors), rel=1e-5)


def test_the_tone_curve_of_a_scene_is_applied_between_loss_and_renderer(
    plugins: Plugins, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = grain_scene(tmp_path, plugins)
    path.write_text(path.read_text() + "\n[objective]\ntone = { peak = 2 }\n")
    problems: list[run.Problem] = []

    def measure(problem: run.Problem, *_: Any, **__: Any) -> None:
        problems.append(problem)
        raise KeyboardInterrupt

    monkeypatch.setattr("loi_core.cli.tradeoff.measure", measure)
    assert main(["tradeoff", "--scene", str(path), "--output", str(tmp_path / "out")]) == 1
    (problem,) = problems
    scene = problem.scene
    assert scene is not None
    image, pullback = scene.renderer.render_vjp(scene.renderer.parameters(), seed=scene.fit.seed)
    _, exact = LOIObjective(scene.target, scene.scales, tone=LogTone(2.0)).value_and_grad(image)
    gradient = LOIObjective(problem.reference, problem.scales).value_and_grad(problem.image)[1]
    perturbation = gradient * np.random.default_rng(0).normal(size=gradient.shape)
    size = np.linalg.norm(pullback(exact)["shift"])
    error = np.linalg.norm(pullback(LogTone(2.0).pullback(image, perturbation))["shift"]) / size
    assert noise.ParameterErrors(scene, gradient).largest(gradient + perturbation) == pytest.approx(error, rel=1e-9)


def test_the_noise_of_a_stochastic_scene_determines_the_recommendation(
    plugins: Plugins, in_this_process: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    result = tradeoff(tmp_path / "out", capsys, "--scene", str(grain_scene(tmp_path, plugins)))
    assert result["stochastic"] is True
    assert [entry["samples"] for entry in result["noises"]] == [1, 4, 16]
    advice = result["recommendation"]
    least_noise = result["noises"][1]["least"]
    assert advice["noise"] == least_noise
    assert advice["allowed"] == pytest.approx(MAX_NOISE_FRACTION * least_noise)
    row = result["rows"][advice["index"]]
    assert advice["error"] == row["parameter_error"] <= advice["allowed"]
    assert f"{least_noise:.1e}" in advice["sentence"]
    assert "4 samples" in advice["sentence"]


def test_the_tolerance_determines_the_recommendation_of_a_deterministic_scene(
    plugins: Plugins, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    plugins(NUMPY, EntryPoint("disks", "loi_core.renderers:Disks", registry.RENDERERS.name))
    copy_scene("disks", tmp_path)
    scene = load_scene(tmp_path / "scene.toml")
    assert scene.samples is None

    def half_too_large(
        factory: str, setting: Setting, image: Host, reference: Host, seconds: float
    ) -> tuple[Row, Host]:
        exact = LOIObjective(reference, scene.scales).value_and_grad(image)[1]
        return Row(setting, "cpu", 1.0, 1), (1.0 if setting.accuracy == "exact" else 1.5) * exact

    monkeypatch.setattr(run, "measure_setting", half_too_large)
    result = tradeoff(tmp_path / "out", capsys, "--scene", str(tmp_path / "scene.toml"))
    assert (result["stochastic"], result["noises"]) == (False, [])
    for row in result["rows"]:
        # The pullback is linear, so relative errors of image and parameters are equal.
        expected = 0.0 if row["accuracy"] == "exact" else 0.5
        assert row["error"] == pytest.approx(expected, abs=1e-6)
        assert row["parameter_error"] == pytest.approx(expected, abs=1e-5)
    assert result["rows"][result["recommendation"]["index"]]["accuracy"] == "exact"
    assert "nothing is random here" in result["recommendation"]["sentence"]
