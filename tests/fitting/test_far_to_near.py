"""A fit uses scales from far to near, rates in pixels, and reports a verdict."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from loi_core import FarToNear, Free, LOIObjective, PixelL2, ScaleSpace, fit
from loi_core.errors import OptionError, ParameterError
from loi_core.fitting.loop import FitInterruptedError, FitStep
from loi_core.fitting.parameters import bounds_of
from loi_core.fitting.schedule import Schedule, has_settled
from loi_core.fitting.starts import draw_starts
from loi_core.renderers import Disks, Warp
from loi_core.renderers.units import measure_units
from tests.contents import photograph
from tests.frameworks import jnp, torch
from tests.strategies import SEEDS

HEIGHT, WIDTH = 48, 64
BOUNDS = np.array([WIDTH / 2 - 6.0, HEIGHT / 2 - 6.0])


def scene(seed: int = 3) -> tuple[Warp, np.ndarray[Any, Any], Free]:
    """A patch of one picture on another, its goal, and a start far from it."""
    rng = np.random.default_rng(seed)
    renderer = Warp(photograph((11, 11, 3), rng), photograph((HEIGHT, WIDTH, 3), rng))
    return renderer, np.array([15.0, -9.0]), Free(np.array([-14.0, 8.0]), -BOUNDS, BOUNDS)


def target_of(renderer: Warp, goal: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    return renderer.render(renderer.parameters() | {"translation": goal})


def test_a_textured_patch_is_found_with_bounds_alone() -> None:
    renderer, goal, free = scene()
    result = fit(renderer, LOIObjective(target_of(renderer, goal)), steps=160, optimise={"translation": free})
    assert np.hypot(*(result.best_params["translation"] - goal)) < 0.1
    assert [entry.stage for entry in result.history] == sorted(entry.stage for entry in result.history)
    assert result.diagnosis is not None
    assert result.diagnosis.ok


def test_given_scales_and_stages_replace_the_defaults() -> None:
    renderer, goal, free = scene()
    objective = LOIObjective(target_of(renderer, goal), ScaleSpace(1, 5, 0.125))
    result = fit(renderer, objective, steps=5, optimise={"translation": free})
    assert {entry.stage for entry in result.history} == {0}
    chosen = fit(renderer, objective, steps=5, optimise={"translation": free}, stages=[ScaleSpace(1, 22, 0.125)])
    assert chosen.history[0].value != result.history[0].value


@pytest.mark.parametrize("stages", ["far", [3], 7])
def test_invalid_stages_are_refused(stages: Any) -> None:
    renderer, goal, free = scene()
    with pytest.raises(OptionError, match="`stages` must"):
        fit(renderer, LOIObjective(target_of(renderer, goal)), optimise={"translation": free}, stages=stages)


@given(st.floats(1e-9, 1e9), st.floats(0.0, 0.2), SEEDS)
def test_noise_around_a_level_has_settled_and_a_steady_fall_has_not(size: float, noise: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    falling = size * (1.0 - 0.02 * np.arange(40.0))
    assert not has_settled([*falling], 12)
    assert has_settled([size] * 24, 12)
    # A line through noise alone exceeds two errors of its slope one time in thirty, so not five times in a row.
    level = [size * (1.0 + noise * rng.standard_normal()) for _ in range(120)]
    assert any(has_settled(level[: 40 + 20 * index], 12) for index in range(5))


@pytest.mark.parametrize(("fall", "is_stuck"), [(0.05, True), (0.5, False)])
def test_a_stage_whose_fall_would_leave_most_of_its_loss_at_the_end_is_stuck(fall: float, is_stuck: bool) -> None:
    schedule = Schedule(stages=1, steps=200, restarts=1, noise_floor=0.0)
    for step in range(60):
        schedule = schedule.after(1.0 - fall * step / 200)
    assert schedule.stuck is is_stuck


def test_a_schedule_leaves_time_for_the_last_stage_for_any_values() -> None:
    schedule = FarToNear(stages=3, steps=100)
    stages = []
    for step in range(100):
        stages.append(schedule.stage)
        schedule.step(1.0 / (1.0 + step))
    assert stages == sorted(stages)
    assert stages.count(2) >= 40
    assert schedule.passed == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(("stages", "steps"), [(0, 5), (2, 0), (1.5, 5)])
def test_a_schedule_without_stages_or_steps_is_refused(stages: Any, steps: Any) -> None:
    with pytest.raises(OptionError, match="must be a whole number, 1 or more"):
        FarToNear(stages, steps)


def test_a_schedule_refuses_the_losses_of_a_batch() -> None:
    schedule = FarToNear(stages=2, steps=100)
    schedule.step(np.ones((1, 1)))
    with pytest.raises(OptionError, match=r"`value` must be one number, such as the mean.*, got shape \(3,\)"):
        schedule.step(np.ones(3))


@pytest.mark.parametrize("metres", [1e-3, 1.0, 250.0])
def test_a_measured_unit_moves_the_image_by_a_pixel_in_any_scale_of_the_parameter(metres: float) -> None:
    class Elsewhere(Disks):
        """Positions in other units than pixels."""

        def parameters(self) -> Any:
            params = super().parameters()
            return params | {"positions": params["positions"] / metres}

        def render(self, params: Any, *, seed: int = 0) -> Any:
            return super().render(dict(params) | {"positions": params["positions"] * metres}, seed=seed)

    renderer = Elsewhere(HEIGHT, WIDTH, [[20.0, 20.0]], 6.0, [[0.9, 0.4, 0.2]])
    params = renderer.parameters()
    bounds = bounds_of(params, {"positions": Free(lower=0.0, upper=60.0 / metres)})
    units, longer_side = measure_units([renderer], params, bounds, ["positions"])
    # Both coordinates move, so the disk goes the root of 2 as far; blurred, its edge is not quite a line.
    assert units["positions"] * metres * np.sqrt(2.0) == pytest.approx(1.0, rel=0.35)
    assert longer_side == WIDTH


def test_a_parameter_without_effect_has_no_unit_and_is_reported() -> None:
    class Moody:
        """A parameter that nothing depends on."""

        def parameters(self) -> Any:
            return {"mood": np.zeros(3)}

        def render(self, params: Any, *, seed: int = 0) -> Any:
            return np.tile(np.linspace(0.0, 1.0, WIDTH)[None, :, None], (HEIGHT, 1, 1))

        def render_vjp(self, params: Any, *, seed: int = 0) -> Any:
            return self.render(params), lambda _: {"mood": np.zeros(3)}

    renderer = Moody()
    params, free = renderer.parameters(), {"mood": Free(lower=-1.0, upper=1.0)}
    assert np.isinf(measure_units([renderer], params, bounds_of(params, free), ["mood"])[0]["mood"])
    result = fit(renderer, LOIObjective(renderer.render(params)[:, ::-1].copy()), steps=4, optimise=free)
    assert result.diagnosis is not None
    assert result.diagnosis.verdict == "no gradient"
    assert "'mood' leaves no trace" in str(result.diagnosis)
    same = fit(renderer, LOIObjective(renderer.render(params)), steps=4, optimise=free)
    assert same.diagnosis is not None
    assert same.diagnosis.verdict == "no gradient"  # the images are alike because nothing in them can differ


def test_an_encoded_target_is_recognised() -> None:
    renderer, goal, free = scene()
    dark = Warp(0.5 * renderer.layers, 0.3 * renderer.background)
    target = target_of(dark, goal) ** (1.0 / 2.2)
    result = fit(dark, PixelL2(target), steps=10, optimise={"translation": free})
    assert result.diagnosis is not None
    assert result.diagnosis.verdict == "other range"


def test_pixels_without_overlap_stall_and_the_verdict_reports_this() -> None:
    renderer = Disks(HEIGHT, WIDTH, [[12.0, 12.0]], 5.0, [[0.9, 0.4, 0.2]])
    target = renderer.render({**renderer.parameters(), "positions": np.array([[50.0, 36.0]])})
    result = fit(renderer, PixelL2(target), steps=20, optimise={"positions": Free(None, 6.0, 42.0)})
    assert result.diagnosis is not None
    assert not result.diagnosis.ok
    assert result.diagnosis.left > 0.5
    assert "starts=8" in result.diagnosis.advice


@pytest.mark.parametrize("steps", [2, 5, 12])
def test_a_short_fit_ends_no_worse_than_it_began(steps: int) -> None:
    renderer, goal, free = scene()
    objective = LOIObjective(target_of(renderer, goal))
    start_near_goal = Free(goal + 0.2, free.lower, free.upper)
    result = fit(renderer, objective, steps=steps, optimise={"translation": start_near_goal})
    start = renderer.render(renderer.parameters() | {"translation": start_near_goal.initial})
    assert result.best_value <= float(objective.value(start))
    assert result.best_value == pytest.approx(float(objective.value(result.image)), rel=1e-12)
    assert result.diagnosis is not None
    assert result.diagnosis.left <= 1.0


def test_a_stalled_fit_without_bounds_is_advised_to_set_them() -> None:
    renderer = Disks(HEIGHT, WIDTH, [[12.0, 12.0]], 5.0, [[0.9, 0.4, 0.2]])
    target = renderer.render({**renderer.parameters(), "positions": np.array([[50.0, 36.0]])})
    result = fit(renderer, PixelL2(target), steps=20, optimise={"positions": Free()})
    assert result.diagnosis is not None
    assert "give 'positions' bounds" in result.diagnosis.advice


def test_starts_fill_their_bounds_and_keep_fixed_numbers() -> None:
    params = {"at": np.array([[1.0, 2.0], [3.0, 4.0]]), "still": np.zeros(3)}
    lowest, highest = params["at"].copy(), params["at"].copy()
    lowest[1], highest[1] = -1.0, 5.0
    starts = draw_starts(params, bounds_of(params, {"at": Free(None, lowest, highest)}), 65)
    points = np.array([start["at"][1] for start in starts[1:]])
    assert starts[0] is params
    assert all(np.array_equal(start["at"][0], [1.0, 2.0]) for start in starts)
    assert points.min() < -0.8
    assert points.max() > 4.8
    counts = np.histogram2d(points[:, 0], points[:, 1], bins=4, range=[[-1, 5], [-1, 5]])[0]
    assert counts.min() >= 2  # of 64 points in 16 boxes
    with pytest.raises(OptionError, match="`starts` draws within bounds, and 'at' has none"):
        draw_starts(params, bounds_of(params, {"at": Free()}), 2)


def test_several_starts_find_a_disk_that_one_start_misses() -> None:
    renderer = Disks(HEIGHT, WIDTH, [[12.0, 12.0]], 5.0, [[0.9, 0.4, 0.2]])
    goal = np.array([[50.0, 36.0]])
    target = renderer.render({**renderer.parameters(), "positions": goal})
    free = {"positions": Free(None, 6.0, [[58.0, 42.0]])}
    alone = fit(renderer, PixelL2(target), steps=60, optimise=free)
    raced = fit(renderer, PixelL2(target), steps=60, optimise=free, starts=16)
    assert np.abs(alone.best_params["positions"] - goal).max() > 5.0
    assert np.abs(raced.best_params["positions"] - goal).max() < 0.1
    assert raced.agreeing is not None


@pytest.fixture(scope="module")
def whole() -> tuple[Callable[..., Any], Any]:
    """Return a function that fits in stages, and the result of it when nothing interrupts."""
    renderer, goal, free = scene(8)
    objective = LOIObjective(target_of(renderer, goal))

    def go(**options: Any) -> Any:
        return fit(renderer, objective, steps=50, optimise={"translation": free}, **options)

    return go, go()


@pytest.mark.parametrize("stop", [7, 24, 40])  # one in each stage
def test_stages_and_searches_are_resumed_to_the_bit(
    stop: int, whole: tuple[Callable[..., Any], Any], tmp_path: Path
) -> None:
    go, uninterrupted = whole
    file = tmp_path / "state.npz"

    def interrupt(step: FitStep, params: Any, image: Any) -> None:
        if step.step == stop:
            raise KeyboardInterrupt

    with pytest.raises(FitInterruptedError):
        go(checkpoint=file, callback=interrupt)
    resumed = go(checkpoint=file, resume=True)
    assert [(entry.stage, entry.value) for entry in resumed.history] == [
        (entry.stage, entry.value) for entry in uninterrupted.history
    ]
    np.testing.assert_array_equal(resumed.best_params["translation"], uninterrupted.best_params["translation"])
    assert all(
        np.array_equal(first.params["translation"], second.params["translation"])
        for first, second in zip(resumed.history, uninterrupted.history, strict=True)
    )


def test_a_resumed_fit_may_take_more_steps_but_not_fewer_than_are_done(tmp_path: Path) -> None:
    renderer, goal, free = scene()
    objective, file = LOIObjective(target_of(renderer, goal)), tmp_path / "state.npz"
    options: dict[str, Any] = {"optimise": {"translation": free}, "checkpoint": file}
    fit(renderer, objective, steps=20, **options)
    longer = fit(renderer, objective, steps=30, resume=True, **options)
    assert len(longer.history) == 30
    with pytest.raises(ParameterError, match="made with steps"):
        fit(renderer, objective, steps=25, resume=True, **options)


def test_noise_in_a_target_is_not_mistaken_for_an_encoding() -> None:
    renderer, goal, free = scene()
    rng = np.random.default_rng(0)
    dark = Warp(renderer.layers, 0.0 * renderer.background)
    target = np.clip(target_of(dark, goal) + rng.normal(0.0, 0.2, (HEIGHT, WIDTH, 3)), 0.0, 1.0)
    result = fit(dark, PixelL2(target), steps=10, optimise={"translation": free})
    assert result.diagnosis is not None
    assert result.diagnosis.verdict != "other range"


@pytest.mark.parametrize("library", ["python", "numpy", "torch", "jax", "drjit"])
def test_a_schedule_takes_the_loss_values_of_any_library(library: str) -> None:
    def returned(value: float) -> Any:
        if library == "torch":
            return (torch.tensor([value], requires_grad=True) * 1.0).sum()
        if library == "jax":
            return jnp.asarray(value)
        if library == "drjit":
            pytest.importorskip("loi_mitsuba")  # before Dr.Jit, so that it gets an LLVM that works
            drjit = pytest.importorskip("drjit")
            leaf = drjit.llvm.ad.Float(value)
            drjit.enable_grad(leaf)
            return leaf * 1.0
        return np.float64(value) if library == "numpy" else value

    schedule = FarToNear(stages=2, steps=100)
    while schedule.stage == 0:
        schedule.step(returned(1.0))
    assert schedule.passed == 0.0
    schedule.step(returned(0.5))
    assert schedule.stage == 1
