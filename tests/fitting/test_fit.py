"""A fit minimises the objective, keeps bounds and remembers the best iterate."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from loi_core import Free, LOIObjective, PixelL2, RendererCapabilities, fit
from loi_core.errors import FitError
from loi_core.fitting.loop import FitInterruptedError, FitStep
from loi_core.fitting.state import Evaluation, State
from loi_core.fitting.views import Views
from loi_core.renderers import Disks
from tests.fitting.fits import REFERENCE, SCALES, SCENE, START, TARGET, Bowl, run
from tests.frameworks import array_api_strict, jnp, torch
from tests.helpers import Host


def test_a_disk_is_found_from_a_start_without_overlap_where_pixels_fail() -> None:
    result = run()
    assert np.abs(result.best_params["positions"] - TARGET).max() < 0.05
    from_pixels = fit(
        SCENE, PixelL2(REFERENCE), steps=60, learning_rate=1.5, optimise={"positions": Free(START, 0.0, 32.0)}
    )
    assert np.abs(from_pixels.best_params["positions"] - TARGET).max() > 5.0


def test_only_the_free_parameters_move() -> None:
    result = run(steps=3)
    for name in ("radii", "colours"):
        np.testing.assert_array_equal(result.params[name], SCENE.parameters()[name])


def test_the_best_value_is_the_minimum_of_the_history_and_belongs_to_the_image() -> None:
    result = run(steps=25, decay="none")
    values = [entry.value for entry in result.history]
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
    assert [entry.value for entry in first.history] == [entry.value for entry in second.history]


def test_the_rate_decays_like_half_a_cosine_and_is_the_parameters_own() -> None:
    rates = [entry.rate for entry in run(steps=9).history]
    np.testing.assert_allclose(rates, 1e-3 + (1 - 1e-3) * 0.5 * (1 + np.cos(np.pi * np.arange(9) / 8)))
    assert [entry.rate for entry in run(steps=3, decay="none").history] == [1.0] * 3
    target = PixelL2(np.full((2, 2, 1), 100.0))
    for rate in (0.25, 2.0):  # the first step of Adam is the rate itself
        result = fit(Bowl(), target, steps=1, learning_rate=9.0, optimise={"pixels": Free(learning_rate=rate)})
        np.testing.assert_allclose(result.params["pixels"], rate)


def test_the_parameters_after_the_last_step_count() -> None:
    result = fit(Bowl(), PixelL2(np.full((2, 2, 1), 100.0)), steps=3, learning_rate=1.0, optimise=["pixels"])
    assert result.best_step == 3
    np.testing.assert_array_equal(result.best_params["pixels"], result.params["pixels"])


def test_a_renderer_with_a_projection_projects_after_every_step() -> None:
    class Rounding(Bowl):
        @property
        def capabilities(self) -> RendererCapabilities:
            return RendererCapabilities(project=self.project)

        def project(self, params: dict[str, Any]) -> dict[str, Any]:
            return {name: np.round(value) for name, value in params.items()}

    result = fit(Rounding(), PixelL2(np.full((2, 2, 1), 100.0)), steps=5, learning_rate=1.4, decay="none")
    assert result.params["pixels"].tolist() == np.full((2, 2, 1), 5.0).tolist()


def test_a_projection_moves_only_free_parameters_within_their_bounds(tmp_path: Path) -> None:
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


@pytest.mark.parametrize(
    "make",
    [
        lambda values: np.asarray(values, np.float16),
        lambda values: torch.tensor(values, dtype=torch.bfloat16),
        lambda values: jnp.asarray(values, jnp.bfloat16),
    ],
    ids=["numpy", "torch", "jax"],
)
def test_parameters_of_16_bits_are_fitted_and_resumed_with_adam(make: Any, tmp_path: Path) -> None:
    make([0.0])  # skips here, and not within a fit, where the framework is not installed

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
    assert [float(number) for number in whole.best_params["level"]] == pytest.approx([1.0, 0.0], abs=0.05)
    with pytest.raises(FitInterruptedError):
        go(checkpoint=file, callback=stop)
    assert [entry.value for entry in go(checkpoint=file, resume=True).history] == [
        entry.value for entry in whole.history
    ]


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


def test_options_may_be_numbers_of_numpy() -> None:
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
def test_the_gradient_norm_in_float32_is_right_if_its_square_overflows(size: float) -> None:
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


def test_a_callback_receives_every_step_and_can_end_the_fit() -> None:
    steps_handled: list[int] = []

    def watch(step: FitStep, params: dict[str, Host], image: Host) -> bool:
        steps_handled.append(step.step)
        np.testing.assert_array_equal(image, SCENE.render(params))
        return step.step == 4

    assert len(run(steps=10, callback=watch).history) == 5
    assert steps_handled == [0, 1, 2, 3, 4]


@pytest.mark.parametrize(("answer", "steps"), [(np.True_, 1), (np.False_, 3), (None, 3)])
def test_a_callback_may_return_a_bool_of_numpy(answer: Any, steps: int) -> None:
    assert len(run(steps=3, callback=lambda *_: answer).history) == steps


@pytest.mark.parametrize("answer", [np.ones(2), np.ones(()), 1, "yes"])
def test_any_other_return_value_of_a_callback_is_refused_with_a_result(answer: Any) -> None:
    with pytest.raises(FitError, match=r"step 1: .*`callback` must return True .*, got [^\n]+$") as caught:
        run(steps=3, callback=lambda *_: answer)
    result: Any = caught.value.result
    assert len(result.history) == 1


def test_a_step_does_not_copy_the_history() -> None:
    evaluation = Evaluation({}, {}, {}, {}, {}, 0)
    state = State({}, {}, Views({}, single=True, at_once=1))
    for step in range(4):
        earlier, state = state, state.stepped(FitStep(step, 0.0, 0.0, 1.0, 0.0), {}, state.memory, evaluation)
        assert state.log is earlier.log
        assert [entry.step for entry in earlier.history] == list(range(step))
    rewritten = earlier.stepped(FitStep(9, 0.0, 0.0, 1.0, 0.0), {}, earlier.memory, evaluation)
    assert [entry.step for entry in rewritten.history] == [0, 1, 2, 9]
