"""The command ``loi tradeoff``: what it measures is there, what it recommends is right, what fails is named."""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Callable, Mapping
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from loi_core import LogTone, LOIObjective, ScaleSpace, registry
from loi_core.backends import BFLOAT16_PRODUCTS, Backend, NumPy
from loi_core.cli import main
from loi_core.cli.demo import make_disks
from loi_core.scene import load_scene
from loi_core.tradeoff import HIDDEN, WITHIN, Setting, noise, pareto_set, recommend, rows, run, settings_of
from loi_core.tradeoff.memory import peak_memory, restart_peak
from tests.environments import ROOT
from tests.helpers import SCALES, Host, images, relative_error

Plugins = Callable[..., None]

NUMPY = EntryPoint("numpy", "loi_core.backends:NumPy", registry.BACKEND_GROUP)
ROW = {
    *("backend", "device", "accuracy", "dtype", "change", "sigma", "alpha", "beta", "levels", "seconds", "runs"),
    *("memory_bytes", "error", "parameter_error", "pareto", "problem"),
}
ANSWER = {
    *(
        "problem",
        "machine",
        "load",
        "rows",
        "missing",
        "stochastic",
        "noises",
        "recommendation",
        "interrupted",
        "report",
    ),
}

BROKEN = """\
import os

from loi_core.backends import NumPy


class Refuses:
    def __init__(self):
        raise RuntimeError("no licence\\nsecond line")


class Fails(NumPy):
    dtypes = ("float32",)

    def prepare(self, image, reference, scales, accuracy, dtype):
        raise RuntimeError("out of luck")


class Crashes(Fails):
    def prepare(self, image, reference, scales, accuracy, dtype):
        os._exit(7)
"""

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


@pytest.fixture
def plugins(monkeypatch: pytest.MonkeyPatch) -> Plugins:
    """Makes these entry points the only ones."""

    def announce(*points: EntryPoint) -> None:
        monkeypatch.setattr(registry, "entry_points", lambda group: [one for one in points if one.group == group])

    announce(NUMPY)
    return announce


@pytest.fixture
def pair(tmp_path: Path) -> list[str]:
    first, second = images((12, 10, 3), 0)
    np.save(tmp_path / "a.npy", first)
    np.save(tmp_path / "b.npy", second)
    return ["--image", str(tmp_path / "a.npy"), "--reference", str(tmp_path / "b.npy")]


def tradeoff(output: Path, capsys: pytest.CaptureFixture[str], *arguments: str, code: int = 0) -> dict[str, Any]:
    assert main(["tradeoff", "--seconds", "1e-3", "--output", str(output), "--json", *arguments]) == code
    return dict(json.loads(capsys.readouterr().out))


def test_two_images_are_measured_end_to_end(
    plugins: Plugins, pair: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = tradeoff(tmp_path / "out", capsys, *pair)
    assert set(found) == ANSWER
    assert (found["problem"]["height"], found["problem"]["width"]) == (12, 10)
    assert all(set(row) == ROW for row in found["rows"])
    grid = [(row["accuracy"], row["dtype"]) for row in found["rows"] if row["change"] is None]
    assert sorted(grid) == sorted((a, d) for a in ("exact", "balanced", "fast") for d in ("float32", "float64"))
    assert {"half beta", "twice beta"} < {row["change"] for row in found["rows"]}
    for row in found["rows"]:
        assert row["problem"] is None
        assert row["seconds"] > 0.0
        assert row["runs"] >= 1
        assert row["parameter_error"] is None
        promised = {"exact": 1e-3 if row["dtype"] == "float32" else 1e-12, "balanced": 1e-2, "fast": 5e-2}
        assert row["error"] > 1e-3 if row["change"] else row["error"] <= promised[row["accuracy"]], row
    points = [(row["seconds"], row["error"]) for row in found["rows"]]
    assert [row["pareto"] for row in found["rows"]] == pareto_set(points)
    advised = found["rows"][found["recommendation"]["index"]]
    assert advised["change"] is None
    assert found["recommendation"]["error"] == advised["error"] <= WITHIN
    assert not found["interrupted"]
    stored = json.loads((tmp_path / "out" / "tradeoff.json").read_text())
    assert stored == {key: value for key, value in found.items() if key != "report"}


def test_the_page_holds_all_that_it_shows(
    plugins: Plugins, pair: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["tradeoff", "--seconds", "1e-3", "--output", str(tmp_path / "out"), *pair]) == 0
    said = capsys.readouterr().out
    page = (tmp_path / "out" / "report.html").read_text()
    assert page.count("data:image/png;base64,") == 3
    assert "http" not in page
    assert (tmp_path / "out" / "tradeoff.png").read_bytes().startswith(b"\x89PNG")
    sentence = json.loads((tmp_path / "out" / "tradeoff.json").read_text())["recommendation"]["sentence"]
    assert f"Recommended: {sentence}" in said
    assert "without a renderer" in sentence
    assert said.count("| numpy") == page.count("<td>numpy</td>") == 10


@given(st.lists(st.tuples(st.integers(0, 6), st.integers(0, 6))))
def test_the_pareto_set_is_what_no_other_point_beats(points: list[tuple[int, int]]) -> None:
    def beaten(point: tuple[int, int]) -> bool:
        return any(one != point and one[0] <= point[0] and one[1] <= point[1] for one in points)

    assert pareto_set(points) == [not beaten(point) for point in points]


@given(
    st.lists(st.tuples(st.floats(1e-3, 10.0), st.floats(0.0, 0.1)), min_size=1),
    st.none() | st.floats(0.0, 0.5),
)
def test_what_is_recommended_is_the_fastest_of_those_that_are_accurate_enough(
    points: list[tuple[float, float]], noise: float | None
) -> None:
    allowed = WITHIN if noise is None else HIDDEN * noise
    advice = recommend(points, noise)
    assert advice is not None
    seconds, error = points[advice.index]
    assert (advice.error, advice.allowed, advice.noise) == (error, allowed, noise)
    assert advice.met == any(one[1] <= allowed for one in points)
    if advice.met:
        assert error <= allowed
        assert all(one[0] >= seconds for one in points if one[1] <= allowed)
    else:
        assert error == min(one[1] for one in points)


def test_nothing_is_recommended_where_nothing_was_measured() -> None:
    assert recommend([], None) is None


@pytest.mark.parametrize("name", SCALES)
def test_every_change_is_of_one_thing_and_leaves_something_to_compare(name: str) -> None:
    scales = SCALES[name]
    listed = settings_of("any", ("float32", "float64"), scales)
    assert len(set(listed)) == len(listed)
    for one in listed:
        differs = [key for key in ("sigma", "alpha", "beta") if getattr(one.scales, key) != getattr(scales, key)]
        assert len(differs) == (1 if one.change else 0)
        assert not one.change or (one.accuracy, one.dtype) == ("balanced", "float32")
    left_out = [one for one in listed if one.change.startswith("without")]
    assert len(left_out) == sum(len(each) for each in (scales.sigma, scales.alpha) if len(each) > 1)


def announced_backends() -> dict[str, Backend]:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    entries = project["entry-points"][registry.BACKEND_GROUP]
    return {name: EntryPoint(name, value, registry.BACKEND_GROUP).load()() for name, value in entries.items()}


@pytest.mark.parametrize("name", ["jax", "numpy", "torch"])
def test_every_backend_of_the_project_gives_the_numbers_of_the_core(name: str) -> None:
    backend = announced_backends()[name]
    image, reference = images((16, 12, 3), 3)
    scales = ScaleSpace((0, 2), (2, 5), 0.125)
    value, gradient = LOIObjective(reference, scales).value_and_grad(image)
    for dtype, tolerance in (("float64", 1e-12), ("float32", 1e-3)):  # ties are what float32 sees differently
        assert dtype in backend.dtypes
        evaluate = backend.prepare(image, reference, scales, "exact", dtype)
        for _ in range(2):
            got, slope = evaluate()
            assert got == pytest.approx(float(value), rel=tolerance)
            assert isinstance(slope, np.ndarray)
            assert slope.dtype == dtype
            assert relative_error(slope, gradient) < tolerance


def test_products_in_bfloat16_are_a_choice_of_torch_that_is_set_back() -> None:
    backend = announced_backends()["torch"]
    image, reference = images((40, 48, 3), 3)
    scales = ScaleSpace((0, 2), (2, 5), 0.125)
    value = float(LOIObjective(reference, scales).value(image))
    torch.set_float32_matmul_precision("high")
    try:
        got, slope = backend.prepare(image, reference, scales, "exact", BFLOAT16_PRODUCTS)()
        assert torch.get_float32_matmul_precision() == "high"
    finally:
        torch.set_float32_matmul_precision("highest")
    assert slope.dtype == np.float32
    # Each of the products of a blur rounds both factors to 8 bits, and differences of CDFs are compared, not CDFs.
    assert got == pytest.approx(value, rel=2.0 * 4.0 * 2.0**-8)


def test_the_backends_of_the_project_are_all_tried() -> None:
    assert sorted(announced_backends()) == ["jax", "mitsuba", "numpy", "torch"]


def test_a_broken_backend_is_reported_and_the_others_are_measured(
    plugins: Plugins,
    pair: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (tmp_path / "broken_backends.py").write_text(BROKEN)
    monkeypatch.syspath_prepend(str(tmp_path))
    plugins(
        NUMPY,
        EntryPoint("absent", "no_such_module:Backend [gpu]", registry.BACKEND_GROUP),
        *(EntryPoint(one.lower(), f"broken_backends:{one}", registry.BACKEND_GROUP) for one in ("Fails", "Refuses")),
    )
    found = tradeoff(tmp_path / "out", capsys, *pair)
    assert [(one["name"], one["mend"]) for one in found["missing"]] == [
        ("absent", "pip install 'unknown[gpu]'"),
        ("refuses", ""),
    ]
    assert found["missing"][1]["problem"] == "RuntimeError: no licence second line"
    by_backend = {name: [row for row in found["rows"] if row["backend"] == name] for name in ("numpy", "fails")}
    assert {row["problem"] for row in by_backend["fails"]} == {"RuntimeError: out of luck"}
    assert not any(row["pareto"] for row in by_backend["fails"])
    assert {row["problem"] for row in by_backend["numpy"]} == {None}
    assert found["rows"][found["recommendation"]["index"]]["backend"] == "numpy"


def test_a_backend_that_ends_its_process_ends_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "broken_backends.py").write_text(BROKEN)
    monkeypatch.syspath_prepend(str(tmp_path))
    setting = Setting("crashes", "exact", "float32", ScaleSpace(1, 2, 0.25))
    said = rows.measure_setting("broken_backends:Crashes", setting, *images((8, 8, 1), 0), 1e-3)
    assert said == "its process ended with exit code 7"


def test_nothing_but_broken_backends_is_an_error(
    plugins: Plugins, pair: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plugins(EntryPoint("absent", "no_such_module:Backend", registry.BACKEND_GROUP))
    assert main(["tradeoff", *pair, "--output", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert "no backend can be measured: absent: ModuleNotFoundError" in said
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--image", "{a}"], "`--image` and `--reference` go together, got only `--image`"),
        (["--reference", "{a}"], "got only `--reference`"),
        (["--image", "{a}", "--reference", "{b}", "--scene", "disks"], "exclude each other"),
        (["--image", "{a}", "--reference", "{small}"], "must have the same shape, got (12, 10, 3) and (6, 10, 3)"),
        (["--image", "{a}", "--reference", "{a}"], "`image` has no gradient"),
        (["--image", "{a}", "--reference", "none.png"], "none.png: no such image file"),
        (["--scene", "teapot"], "`--scene` must be a file that ends in .toml, or one of disks, photograph"),
        (["--scene", "none.toml"], "none.toml: no such scene file"),
        (["--image", "{a}", "--reference", "{b}", "--backend", "fortran"], "no backend is called 'fortran'"),
        (["--seconds", "0"], "`--seconds` must be a finite number, more than 0, got 0.0"),
        (["--seconds", "nan"], "`--seconds` must be"),
        (["--output", "{a}"], "`--output` must lead to a folder"),
        (["--output", "a\0b"], "`--output` must lead to a folder"),
        (["--seconds", "soon"], "invalid float value: 'soon'"),
    ],
)
def test_wrong_calls_are_one_line_and_write_nothing(
    plugins: Plugins,
    pair: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    says: str,
) -> None:
    np.save(tmp_path / "small.npy", np.zeros((6, 10, 3)))
    places = {name: str(tmp_path / f"{name}.npy") for name in ("a", "b", "small")}
    before = sorted(tmp_path.iterdir())
    given = ["--output", str(tmp_path / "out"), *(one.format(**places) for one in arguments)]
    assert main(["tradeoff", *given]) == 2
    said = capsys.readouterr()
    assert says in said.err.splitlines()[-1]
    assert said.out == ""
    assert sorted(tmp_path.iterdir()) == before


def test_ctrl_c_keeps_what_is_done(
    plugins: Plugins,
    pair: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    calls: list[str] = []

    def interrupted(*arguments: Any) -> rows.Sample | str:
        calls.append("")
        if len(calls) == 3:
            raise KeyboardInterrupt
        return rows.Sample("cpu", 1.0, 1, None, np.ones((12, 10, 3)))

    monkeypatch.setattr(run, "measure_setting", interrupted)
    found = tradeoff(tmp_path / "out", capsys, *pair, code=1)
    assert found["interrupted"]
    assert len(found["rows"]) == 2
    assert (tmp_path / "out" / "report.html").is_file()


def test_the_peak_of_memory_is_seen_after_it_has_passed() -> None:
    before = restart_peak()
    if before is None:
        pytest.skip("the system does not tell")
    np.ones(2**23).sum()  # 64 MiB, given back at once
    after = peak_memory()
    assert after is not None
    assert 60 * 2**20 < after - before < 80 * 2**20


def test_a_larger_image_takes_more_memory() -> None:
    if peak_memory() is None:
        pytest.skip("the system does not tell")
    setting = Setting("numpy", "exact", "float64", ScaleSpace(1, 4, 0.125))
    small, large = (
        rows.measure_setting("loi_core.backends:NumPy", setting, *images((size, size, 3), 0), 1e-3)
        for size in (16, 192)
    )
    assert isinstance(small, rows.Sample)
    assert isinstance(large, rows.Sample)
    assert small.memory is not None
    assert large.memory is not None
    # The reference is kept as it is, blurred, and as places among the levels, all in float64; the gradient is a fourth.
    assert large.memory - small.memory > 4 * 192 * 192 * 3 * 8


def test_a_busy_machine_is_told(
    plugins: Plugins,
    pair: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(run, "measure_setting", lambda *_: rows.Sample("cpu", 1.0, 1, None, np.ones((12, 10, 3))))
    for load, told in ((1e3, True), (0.0, False)):
        monkeypatch.setattr("os.getloadavg", lambda load=load: (load, 0.0, 0.0))
        assert main(["tradeoff", *pair, "--output", str(tmp_path / "out")]) == 0
        assert ("The machine was busy" in capsys.readouterr().out) == told


def test_why_float32_is_far_off_on_flat_images_is_told(
    plugins: Plugins, pair: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plugins(NUMPY)
    for place, name in ((8, "left"), (72, "right")):
        flat = np.full((96, 96, 3), 0.05)
        flat[place : place + 16, place : place + 16] = 0.9
        np.save(tmp_path / f"{name}.npy", flat)
    apart = ["--image", str(tmp_path / "left.npy"), "--reference", str(tmp_path / "right.npy")]
    for arguments, told in ((apart, True), (pair, False)):
        assert main(["tradeoff", "--seconds", "1e-3", "--output", str(tmp_path / "out"), *arguments]) == 0
        assert ("Large errors of float32" in capsys.readouterr().out) == told


def grain_scene(folder: Path, plugins: Plugins, lines: str = "") -> Path:
    plugins(NUMPY, EntryPoint("grain", "tests.test_tradeoff:Grain", registry.GROUP))
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
    plugins: Plugins, tmp_path: Path, capsys: pytest.CaptureFixture[str]
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
    make_disks(tmp_path)
    plugins(NUMPY, EntryPoint("disks", "loi_core.renderers:Disks", registry.GROUP))
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


def test_a_backend_is_found_by_its_name(plugins: Plugins) -> None:
    assert registry.load_backend("numpy") is NumPy
    assert [one.state for one in registry.available_backends()] == ["ready"]
    assert registry.available_renderers() == []
