"""A fit descends, keeps bounds and the best iterate, can stop and go on, and fails without losing anything."""

from __future__ import annotations

import dis
import itertools
import sys
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import Any

import array_api_strict
import jax.numpy as jnp
import numpy as np
import pytest
import torch

from loi_core import Free, LOIObjective, PixelL2, ScaleSpace, fit
from loi_core.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from loi_core.errors import FitError, LoiError, OptionError, ParameterError, RendererError
from loi_core.fit import FitInterruptedError, FitStep
from loi_core.optimiser import Moments
from loi_core.renderers import Disks
from loi_core.state import State
from tests.helpers import Host

TARGET = np.array([[22.0, 9.0]])
START = np.array([[8.0, 23.0]])
SCENE = Disks(32, 32, TARGET, 5.0, [[0.9, 0.6, 0.1]], confine=True)
REFERENCE = SCENE.render(SCENE.parameters())
SCALES = ScaleSpace(1, (3, 9), 0.125)


class Bowl:
    """The simplest renderer of all: its image is its parameter, in any array library."""

    def __init__(self, xp: Any = np) -> None:
        self.xp = xp
        self.start = xp.zeros((2, 2, 1), dtype=xp.float64)

    def parameters(self) -> dict[str, Any]:
        return {"pixels": self.xp.asarray(self.start, copy=True), "unused": self.xp.zeros((), dtype=self.xp.float64)}

    def render(self, params: dict[str, Any], *, seed: int = 0) -> Any:
        return params["pixels"]

    def render_vjp(self, params: dict[str, Any], *, seed: int = 0) -> Any:
        return params["pixels"], lambda g: {"pixels": g, "unused": self.xp.zeros((), dtype=self.xp.float64)}


def run(steps: int = 60, **options: Any) -> Any:
    free = {"positions": Free(START, 0.0, 32.0)}
    arguments: dict[str, Any] = {"steps": steps, "learning_rate": 1.5, "optimise": free} | options
    return fit(SCENE, LOIObjective(REFERENCE, SCALES), **arguments)


def test_a_disk_is_found_from_a_start_without_overlap_where_pixels_fail() -> None:
    result = run()
    assert np.abs(result.best_params["positions"] - TARGET).max() < 0.05
    lost = fit(SCENE, PixelL2(REFERENCE), steps=60, learning_rate=1.5, optimise={"positions": Free(START, 0.0, 32.0)})
    assert np.abs(lost.best_params["positions"] - TARGET).max() > 5.0


def test_only_what_is_asked_for_moves() -> None:
    result = run(steps=3)
    for name in ("radii", "colours"):
        np.testing.assert_array_equal(result.params[name], SCENE.parameters()[name])


def test_the_best_iterate_is_the_least_of_the_history_and_its_image_fits() -> None:
    result = run(steps=25, decay="none")
    values = [one.value for one in result.history]
    assert len(values) == 25
    assert result.best_value <= min(values)
    np.testing.assert_array_equal(result.image, SCENE.render(result.best_params))
    assert float(LOIObjective(REFERENCE, SCALES).value(result.image)) == result.best_value


def test_bounds_are_kept() -> None:
    result = fit(
        Bowl(),
        PixelL2(np.full((2, 2, 1), 5.0)),
        steps=100,
        learning_rate=0.5,
        optimise={"pixels": Free(lower=-1.0, upper=[[[1.0], [2.0]], [[3.0], [9.0]]])},
    )
    np.testing.assert_allclose(result.params["pixels"].ravel(), [1.0, 2.0, 3.0, 5.0], atol=0.3)
    assert result.params["pixels"].ravel()[:3].tolist() == [1.0, 2.0, 3.0]


def test_a_fit_needs_nothing_but_the_array_api() -> None:
    reference = array_api_strict.full((2, 2, 1), 0.5)
    result = fit(Bowl(array_api_strict), PixelL2(reference), steps=80, learning_rate=0.1, optimise=["pixels"])
    np.testing.assert_allclose(np.asarray(result.best_params["pixels"]), 0.5, atol=1e-3)


def test_the_same_seed_gives_the_same_fit() -> None:
    first, second = run(steps=10, seed=3), run(steps=10, seed=3)
    np.testing.assert_array_equal(first.params["positions"], second.params["positions"])
    assert [one.value for one in first.history] == [one.value for one in second.history]


def test_the_rate_decays_like_half_a_cosine_and_is_the_parameters_own() -> None:
    rates = [one.rate for one in run(steps=9).history]
    np.testing.assert_allclose(rates, 1e-3 + (1 - 1e-3) * 0.5 * (1 + np.cos(np.pi * np.arange(9) / 8)))
    assert [one.rate for one in run(steps=3, decay="none").history] == [1.0] * 3
    target = PixelL2(np.full((2, 2, 1), 100.0))
    for rate in (0.25, 2.0):  # the first step of Adam is the rate itself
        result = fit(Bowl(), target, steps=1, learning_rate=9.0, optimise={"pixels": Free(learning_rate=rate)})
        np.testing.assert_allclose(result.params["pixels"], rate)


def test_the_parameters_after_the_last_step_count() -> None:
    result = fit(Bowl(), PixelL2(np.full((2, 2, 1), 100.0)), steps=3, learning_rate=1.0, optimise=["pixels"])
    assert result.best_step == 3
    np.testing.assert_array_equal(result.best_params["pixels"], result.params["pixels"])


def test_a_renderer_that_knows_what_is_legal_is_asked_after_every_step() -> None:
    class Whole(Bowl):
        def project(self, params: dict[str, Any]) -> dict[str, Any]:
            return {name: np.round(value) for name, value in params.items()}

    result = fit(Whole(), PixelL2(np.full((2, 2, 1), 100.0)), steps=5, learning_rate=1.4, decay="none")
    assert result.params["pixels"].tolist() == np.full((2, 2, 1), 5.0).tolist()


def test_a_projection_moves_only_what_is_free_and_within_its_bounds(tmp_path: Path) -> None:
    overlapping: Any = 32, 32, [[10.0, 16.0], [13.0, 16.0]], 4.0, [[0.9, 0.6, 0.1], [0.1, 0.6, 0.9]]
    scene = Disks(*overlapping, confine=True)
    assert np.abs(scene.project(scene.parameters())["positions"] - overlapping[2]).max() > 1.0
    options: Any = {"steps": 4, "learning_rate": 0.1, "checkpoint": tmp_path / "state.npz"}
    for _ in range(2):  # and such a fit can be resumed
        result = fit(scene, PixelL2(REFERENCE), optimise=["colours"], resume=True, **options)
        assert result.params["positions"].tolist() == overlapping[2]
    result = fit(scene, PixelL2(REFERENCE), optimise={"positions": Free(lower=10.0, upper=16.0)}, **options)
    assert result.params["positions"].min() >= 10.0
    assert result.params["positions"].max() <= 16.0


@pytest.mark.parametrize(
    ("legal", "says"),
    [
        ({"unused": np.zeros(())}, "the projection gave no value for 'pixels'"),
        ({"pixels": np.zeros(3)}, r"the value of 'pixels' must be an array of shape \(2, 2, 1\), got shape \(3,\)"),
    ],
)
def test_a_projection_that_is_none_is_told_so(legal: Any, says: str) -> None:
    class Bad(Bowl):
        def project(self, params: dict[str, Any]) -> Any:
            return legal

    with pytest.raises(FitError, match=f"step 0: the projection failed: RendererError: {says}"):
        fit(Bad(), PixelL2(np.ones((2, 2, 1))), steps=3, learning_rate=1, optimise=["pixels"])


def bad_pullback(gradient: Any) -> Bowl:
    class Bad(Bowl):
        def render_vjp(self, params: dict[str, Any], *, seed: int = 0) -> Any:
            return params["pixels"], lambda g: gradient

    return Bad()


@pytest.mark.parametrize(
    ("gradient", "says"),
    [
        ({"unused": np.zeros(())}, "the pullback gave no cotangent for 'pixels'"),
        (3.0, "the pullback gave no cotangent"),
        ({"pixels": np.zeros((2, 2))}, r"'pixels' must be an array of shape \(2, 2, 1\), got shape \(2, 2\)"),
        ({"pixels": 1.0}, "must be an array of shape .*, got float"),
    ],
)
def test_a_renderer_that_breaks_the_contract_is_told_how(gradient: Any, says: str) -> None:
    with pytest.raises(RendererError, match=says):
        fit(bad_pullback(gradient), PixelL2(np.ones((2, 2, 1))), steps=3, learning_rate=1, optimise=["pixels"])


@pytest.mark.parametrize("params", [{}, {"a": np.zeros(3, dtype=int)}, {"a": 1.0}, 5])
def test_parameters_that_cannot_be_optimised_are_refused(params: Any) -> None:
    class Bad(Bowl):
        def parameters(self) -> Any:
            return params

    with pytest.raises(RendererError, match=r"Bad\.parameters\(\)"):
        fit(Bad(), PixelL2(np.ones((2, 2, 1))), steps=3, learning_rate=1)


def test_parameters_keep_their_dtype_and_shape() -> None:
    class Mixed(Bowl):
        def parameters(self) -> dict[str, Any]:
            return {"level": np.zeros((), dtype=np.float32)}

        def render(self, params: dict[str, Any], *, seed: int = 0) -> Any:
            return np.full((2, 2, 1), float(params["level"]))

        def render_vjp(self, params: dict[str, Any], *, seed: int = 0) -> Any:
            return self.render(params), lambda g: {"level": np.asarray(g.sum())}

    level = fit(Mixed(), PixelL2(np.ones((2, 2, 1))), steps=30, learning_rate=0.1).best_params["level"]
    assert isinstance(level, np.ndarray)
    assert (level.dtype, level.shape) == (np.float32, ())
    assert float(level) == pytest.approx(1.0, abs=0.05)


def test_a_renderer_that_fails_later_leaves_the_best_so_far() -> None:
    class Failing(Bowl):
        calls = 0

        def render_vjp(self, params: dict[str, Any], *, seed: int = 0) -> Any:
            Failing.calls += 1
            if Failing.calls == 4:
                message = "out of samples"
                raise RuntimeError(message)
            return super().render_vjp(params)

    with pytest.raises(FitError, match="step 3: rendering failed: RuntimeError: out of samples") as caught:
        fit(Failing(), PixelL2(np.ones((2, 2, 1))), steps=9, learning_rate=0.1)
    result: Any = caught.value.result
    assert len(result.history) == 3


@pytest.mark.parametrize("broken", ["render", "value"])
def test_what_fails_after_the_last_step_leaves_the_best_of_all(broken: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        message = "out of memory"
        raise RuntimeError(message)

    scene, objective = Bowl(), PixelL2(np.ones((2, 2, 1)))
    monkeypatch.setattr(scene if broken == "render" else objective, broken, fail)
    with pytest.raises(FitError, match="step 4: measuring the last step failed: RuntimeError: out of mem") as caught:
        fit(scene, objective, steps=4, learning_rate=0.1)
    result: Any = caught.value.result
    assert len(result.history) == 4
    assert result.best_step == 3


def test_an_objective_without_a_number_is_named() -> None:
    class Wordy(PixelL2):
        def value_and_grad(self, image: Any) -> Any:
            return "much", image

    with pytest.raises(FitError, match="step 0: the objective failed: ValueError"):
        fit(Bowl(), Wordy(np.ones((2, 2, 1))), steps=4, learning_rate=0.1)


@pytest.mark.parametrize("interrupted", [True, False])
def test_a_checkpoint_that_cannot_be_written_leaves_the_result(
    interrupted: bool, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def full(*_: object) -> None:
        message = "no space left"
        raise OSError(message)

    def stop(step: FitStep, params: Any, image: Any) -> None:
        if interrupted and step.step == 2:
            raise KeyboardInterrupt

    monkeypatch.setattr(sys.modules["loi_core.fit"], "save_checkpoint", full)
    error = FitInterruptedError if interrupted else FitError
    caught: Any
    with pytest.raises(error, match=r"step .: writing the checkpoint failed: OSError: no space left") as caught:
        run(steps=4, checkpoint=tmp_path / "state.npz", callback=stop)
    assert len(caught.value.result.history) == (3 if interrupted else 4)


@pytest.mark.parametrize(
    "make",
    [
        lambda values: np.asarray(values, np.float16),
        lambda values: torch.tensor(values, dtype=torch.bfloat16),
        lambda values: jnp.asarray(values, jnp.bfloat16),
    ],
    ids=["numpy", "torch", "jax"],
)
def test_parameters_of_16_bits_are_fitted_and_resumed(make: Any, tmp_path: Path) -> None:
    class Half(Bowl):
        def parameters(self) -> dict[str, Any]:
            return {"level": make([0.0, 0.0])}  # the second has no gradient

        def render(self, params: dict[str, Any], *, seed: int = 0) -> Any:
            return np.full((2, 2, 1), float(params["level"][0]))

        def render_vjp(self, params: dict[str, Any], *, seed: int = 0) -> Any:
            return self.render(params), lambda g: {"level": make([1e-5 * g.sum(), 0.0])}

    def stop(step: FitStep, params: Any, image: Any) -> None:
        if step.step == 17:
            raise KeyboardInterrupt

    def go(**options: Any) -> Any:
        return fit(Half(), PixelL2(np.ones((2, 2, 1))), steps=40, learning_rate=0.1, **options)

    whole, file = go(), tmp_path / "state.npz"
    assert whole.best_params["level"].dtype == make([0.0]).dtype
    assert [float(one) for one in whole.best_params["level"]] == pytest.approx([1.0, 0.0], abs=0.05)
    with pytest.raises(FitInterruptedError):
        go(checkpoint=file, callback=stop)
    assert [one.value for one in go(checkpoint=file, resume=True).history] == [one.value for one in whole.history]


def test_a_torch_renderer_leaves_no_graph_behind() -> None:
    class Torch(Bowl):
        level = torch.nn.Parameter(torch.zeros(()))

        def parameters(self) -> dict[str, Any]:
            return {"level": self.level}

        def render(self, params: dict[str, Any], *, seed: int = 0) -> Any:
            return params["level"].expand(2, 2, 1)

        def render_vjp(self, params: dict[str, Any], *, seed: int = 0) -> Any:
            level = params["level"].detach().requires_grad_()
            image = level.expand(2, 2, 1)
            return image, lambda g: {"level": torch.autograd.grad(image, level, g, retain_graph=True)[0]}

    result = fit(Torch(), PixelL2(np.ones((2, 2, 1), dtype=np.float32)), steps=30, learning_rate=0.1)
    for value in (*result.params.values(), *result.best_params.values(), result.image):
        assert not value.requires_grad
    assert float(result.best_params["level"]) == pytest.approx(1.0, abs=0.05)


def test_numbers_of_numpy_are_taken_for_what_they_are() -> None:
    seeds: list[int] = []

    class Single(Bowl):
        def parameters(self) -> dict[str, Any]:
            return {"pixels": np.zeros((2, 2, 1), dtype=np.float32)}

        def render_vjp(self, params: dict[str, Any], *, seed: int = 0) -> Any:
            seeds.append(seed)
            return super().render_vjp(params)

    options: Any = {"steps": np.uint8(3), "learning_rate": np.float64(0.1), "seed": np.uint8(255)}
    options["optimise"] = {"pixels": Free(learning_rate=np.float32(0.1))}  # type: ignore[arg-type]  # as it comes
    result = fit(Single(), PixelL2(np.ones((2, 2, 1))), **options)
    assert result.params["pixels"].dtype == np.float32
    assert seeds == [255, 256, 257]


@pytest.mark.parametrize("size", [1e-30, 1e30])
def test_the_norm_of_a_gradient_in_float32_is_right_where_its_square_is_not(size: float) -> None:
    class Steep(Bowl):
        def parameters(self) -> dict[str, Any]:
            return {"pixels": np.zeros((2, 2, 1), dtype=np.float32)}

        def render_vjp(self, params: dict[str, Any], *, seed: int = 0) -> Any:
            return params["pixels"], lambda g: {"pixels": np.full((2, 2, 1), size, dtype=np.float32)}

    with np.errstate(over="ignore"):  # in Adam
        result = fit(Steep(), PixelL2(np.ones((2, 2, 1))), steps=1, learning_rate=0.1)
    assert result.history[0].gradient_norm == pytest.approx(2.0 * size)


def test_each_step_renders_with_its_own_seed() -> None:
    seeds: list[int] = []

    class Seeded(Bowl):
        def render_vjp(self, params: dict[str, Any], *, seed: int = 0) -> Any:
            seeds.append(seed)
            return super().render_vjp(params)

    fit(Seeded(), PixelL2(np.ones((2, 2, 1))), steps=4, learning_rate=0.1, seed=10)
    assert seeds == [10, 11, 12, 13]


def test_a_callback_sees_every_step_and_can_end_the_fit() -> None:
    seen: list[int] = []

    def watch(step: FitStep, params: dict[str, Host], image: Host) -> bool:
        seen.append(step.step)
        np.testing.assert_array_equal(image, SCENE.render(params))
        return step.step == 4

    assert len(run(steps=10, callback=watch).history) == 5
    assert seen == [0, 1, 2, 3, 4]


def test_a_fit_that_was_stopped_goes_on_as_if_it_had_not_been(tmp_path: Path) -> None:
    whole = run(steps=40)
    file = tmp_path / "state.npz"

    def stop(step: FitStep, params: Any, image: Any) -> None:
        if step.step == 17:
            raise KeyboardInterrupt

    with pytest.raises(FitInterruptedError) as caught:
        run(steps=40, checkpoint=file, callback=stop)
    assert caught.value.result is not None
    assert len(caught.value.result.history) == 18
    resumed = run(steps=40, checkpoint=file, resume=True)
    np.testing.assert_array_equal(resumed.params["positions"], whole.params["positions"])
    np.testing.assert_array_equal(resumed.best_params["positions"], whole.best_params["positions"])
    assert [one.value for one in resumed.history] == [one.value for one in whole.history]
    assert [path.name for path in tmp_path.iterdir()] == ["state.npz"]


def test_a_checkpoint_that_does_not_fit_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "state.npz"
    file.write_bytes(b"not a checkpoint")
    with pytest.raises(ParameterError, match="is not a checkpoint of a fit"):
        run(steps=3, checkpoint=file, resume=True)
    run(steps=3, checkpoint=file)
    with pytest.raises(ParameterError, match="`checkpoint` was made with learning rates"):
        fit(Bowl(), PixelL2(np.ones((2, 2, 1))), steps=3, learning_rate=1, checkpoint=file, resume=True)
    with pytest.raises(ParameterError, match="`checkpoint` was made with steps = 3, this fit has 2"):
        run(steps=2, checkpoint=file, resume=True)
    with pytest.raises(OptionError, match="`checkpoint` must be the path of a file"):
        run(steps=3, checkpoint=tmp_path)
    with pytest.raises(OptionError, match="`checkpoint` must lead to a folder"):
        run(steps=3, checkpoint=file / "below.npz")


def test_the_order_of_names_is_nothing_to_a_checkpoint(tmp_path: Path) -> None:
    for names in (["positions", "radii"], ["radii", "positions"]):
        run(steps=3, optimise=names, checkpoint=tmp_path / "state.npz", resume=True)


def test_a_damaged_checkpoint_is_refused_wherever_the_damage_is(tmp_path: Path) -> None:
    file = tmp_path / "state.npz"
    run(steps=3, checkpoint=file)
    whole, state = file.read_bytes(), load_checkpoint(file, {})
    refused = 0
    flags = whole.index(b"PK\x01\x02") + 8  # their first bit says that a password is needed
    for place, bit in ((flags, 1), *((place, 8) for place in range(0, len(whole), 7))):
        file.write_bytes(whole[:place] + bytes([whole[place] ^ bit]) + whole[place + 1 :])
        try:
            load_checkpoint(file, state.settings)
        except ParameterError:
            refused += 1
    assert refused > 100
    for changes in ({"step": 2}, {"count": 1}, {"best_step": 4}, {"best_step": -1}, {"history": state.history[:1]}):
        save_checkpoint(file, replace(state, **changes))
        with pytest.raises(ParameterError, match=r"not a checkpoint of a fit \(its counts of steps disagree\)"):
            load_checkpoint(file, state.settings)


def test_ctrl_c_while_a_fit_is_resumed_leaves_its_checkpoint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    file = tmp_path / "state.npz"
    run(steps=3, checkpoint=file)
    before = file.read_bytes()
    monkeypatch.setattr(Disks, "render", interrupt)
    with pytest.raises(FitInterruptedError) as caught:
        run(steps=3, checkpoint=file, resume=True)
    assert caught.value.result is None
    assert file.read_bytes() == before


def test_ctrl_c_within_a_step_falls_before_it(tmp_path: Path) -> None:
    class Interrupted(Disks):
        calls = 0

        def project(self, params: dict[str, Host]) -> dict[str, Host]:
            Interrupted.calls += 1
            if Interrupted.calls == 7:
                raise KeyboardInterrupt
            return super().project(params)

    def go(scene: Disks, **options: Any) -> Any:
        free = {"positions": Free(START, 0.0, 32.0)}
        return fit(scene, LOIObjective(REFERENCE, SCALES), steps=12, learning_rate=1.5, optimise=free, **options)

    whole = go(SCENE)
    file = tmp_path / "state.npz"
    with pytest.raises(FitInterruptedError):
        go(Interrupted(32, 32, TARGET, 5.0, [[0.9, 0.6, 0.1]], confine=True), checkpoint=file)
    resumed = go(SCENE, checkpoint=file, resume=True)
    np.testing.assert_array_equal(resumed.params["positions"], whole.params["positions"])


STATEFUL = {"fit", "_last_seen", "_save", "seen", "stepped", "result", "history"}  # the functions that hold the state


def interrupted_after(count: int) -> Any:
    """A trace function that raises KeyboardInterrupt after so many instructions of the loop and of its state."""
    left = count

    def trace(frame: FrameType, event: str, _: object) -> Any:
        nonlocal left
        code = frame.f_code
        if code.co_name not in STATEFUL or Path(code.co_filename).name not in ("fit.py", "state.py"):
            return None
        frame.f_trace_opcodes = True
        # Python handles no signal between the last value of a function and its return.
        if event == "opcode" and dis.opname[code.co_code[frame.f_lasti]] != "RETURN_VALUE":
            left -= 1
            if left == 0:
                raise KeyboardInterrupt
        return trace

    return trace


def test_ctrl_c_at_any_instruction_leaves_the_state_after_whole_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    saved: list[Checkpoint] = []
    loop = sys.modules["loi_core.fit"]  # `loi_core.fit` is the function
    monkeypatch.setattr(loop, "CHECKPOINT_STEPS", 1)
    monkeypatch.setattr(loop, "save_checkpoint", lambda path, state: saved.append(state))

    def go(trace: Any) -> Any:
        """The result, or the KeyboardInterrupt."""
        before = sys.gettrace()
        saved.clear()
        free: Any = {"optimise": ["pixels"], "checkpoint": "x"}
        try:
            sys.settrace(trace)
            return fit(Bowl(), PixelL2(np.ones((2, 2, 1))), steps=2, learning_rate=0.1, **free)
        except KeyboardInterrupt as stop:
            return stop
        finally:
            sys.settrace(before)

    whole = go(sys.gettrace())
    after = {state.step: state for state in saved}
    params = [Bowl().parameters()["pixels"], after[1].params["pixels"], after[2].params["pixels"]]
    kept: set[tuple[int, int]] = set()
    for count in itertools.count(1):
        end = go(interrupted_after(count))
        if not isinstance(end, KeyboardInterrupt):
            break
        result = getattr(end, "result", None)
        assert (result is None) == (not saved)
        if result is None:
            continue
        last = saved[-1]
        kept.add((last.step, last.best_step))
        assert [one.value for one in result.history] == [one.value for one in whole.history[: last.step]]
        assert last.history[:, 1].tolist() == [one.value for one in result.history]
        np.testing.assert_array_equal(result.params["pixels"], params[last.step])
        np.testing.assert_array_equal(last.params["pixels"], params[last.step])
        np.testing.assert_array_equal(last.best_params["pixels"], params[last.best_step])
        np.testing.assert_array_equal(result.image, params[result.best_step])
        assert last.count == last.step
        if last.step:
            np.testing.assert_array_equal(last.first["pixels"], after[last.step].first["pixels"])
            np.testing.assert_array_equal(last.second["pixels"], after[last.step].second["pixels"])
    assert kept == {(0, 0), (1, 0), (1, 1), (2, 1), (2, 2)}


def test_a_step_does_not_copy_the_history() -> None:
    state = State({}, Moments({}, {}))
    for step in range(4):
        before, state = state, state.stepped(FitStep(step, 0.0, 0.0, 1.0, 0.0), {}, state.moments)
        assert state.log is before.log
        assert [one.step for one in before.history] == list(range(step))
    again = before.stepped(FitStep(9, 0.0, 0.0, 1.0, 0.0), {}, before.moments)
    assert [one.step for one in again.history] == [0, 1, 2, 9]


class Breaking(Bowl):
    """Renders NaN, or pulls back NaN, from the third step on."""

    def __init__(self, how: str) -> None:
        super().__init__()
        self.how, self.calls = how, 0

    def render_vjp(self, params: dict[str, Any], *, seed: int = 0) -> Any:
        self.calls += 1
        broken = np.nan if self.calls >= 3 else 1.0
        image, pullback = super().render_vjp(params)
        if self.how == "image":
            return image * broken, pullback
        return image, lambda g: {name: value * broken for name, value in pullback(g).items()}


@pytest.mark.parametrize(("how", "says"), [("image", "step 2: the render is not finite"), ("pull", "gradient of 'pix")])
def test_a_non_finite_step_stops_the_fit_with_the_best_so_far(how: str, says: str) -> None:
    with pytest.raises(FitError, match=says) as caught:
        fit(Breaking(how), PixelL2(np.ones((2, 2, 1))), steps=9, learning_rate=0.1)
    assert isinstance(caught.value, ArithmeticError)
    result: Any = caught.value.result
    assert len(result.history) == 2
    assert np.all(np.isfinite(result.best_params["pixels"]))
    assert result.best_value < 1.0


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"steps": 0}, "`steps` must be a whole number, 1 or more, got 0"),
        ({"steps": 2.5}, "`steps`"),
        ({"learning_rate": -1}, "`learning_rate` must be a finite number, more than 0, got -1"),
        ({"seed": -1}, "`seed`"),
        ({"decay": "linear"}, "`decay` must be one of 'cosine', 'none', got 'linear'"),
        ({"optimise": ["colour"]}, "'colour', which the renderer does not have; it has colours, positions, radii"),
        ({"optimise": []}, "`optimise` must name at least one parameter"),
        ({"optimise": "positions"}, "`optimise` must be names"),
        ({"optimise": {"positions": 1}}, "must be a Free, got int"),
        ({"optimise": {"positions": Free([1, 2, 3])}}, r"`initial` of 'positions' must be a number or have shape"),
        ({"optimise": {"positions": Free(np.nan)}}, "`initial` of 'positions' must be finite"),
        ({"optimise": {"positions": Free(lower=5, upper=1)}}, "`lower` of 'positions' must not exceed `upper`"),
        ({"optimise": {"positions": Free(lower=30)}}, "`initial` of 'positions' must lie within its bounds"),
        ({"optimise": {"positions": Free(learning_rate=0)}}, "`learning_rate of 'positions'`"),
    ],
)
def test_wrong_arguments_are_named(options: dict[str, Any], says: str) -> None:
    with pytest.raises(ValueError, match=says) as caught:
        run(**options)
    assert isinstance(caught.value, LoiError)
