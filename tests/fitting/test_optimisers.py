"""A fit uses any optimiser that keeps the protocol."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from loi_core import FitInterruptedError, Optimiser, PixelL2, fit
from loi_core.errors import FitError, OptionError, ParameterError
from loi_core.fitting.adam import Adam
from loi_core.fitting.history import FitStep
from tests.fitting.fits import Bowl, run
from tests.frameworks import load, loi_jax, loi_torch, torch
from tests.helpers import Host


def torch_optimiser(name: str, **options: Any) -> Any:
    return loi_torch.TorchOptimiser(getattr(torch.optim, name), **options)


def optax_optimiser(name: str, *arguments: float) -> Any:
    pytest.importorskip("optax")
    transformation = getattr(load("optax"), name)(*arguments)
    return loi_jax.OptaxOptimiser(transformation)


OPTIMISERS = {
    "torch Adam": lambda: torch_optimiser("Adam"),
    "torch NAdam": lambda: torch_optimiser("NAdam"),
    "torch ASGD": lambda: torch_optimiser("ASGD", t0=3.0),
    "torch RMSprop": lambda: torch_optimiser("RMSprop", momentum=0.3),
    "torch Rprop": lambda: torch_optimiser("Rprop"),
    "torch SGD": lambda: torch_optimiser("SGD", momentum=0.9),
    "optax adam": lambda: optax_optimiser("adam", 1.0),
    "optax lion": lambda: optax_optimiser("lion", 1.0),
    "optax sgd": lambda: optax_optimiser("sgd", 1.0, 0.9),
    "Adam": Adam,
}
GOAL: Host = np.array([[[0.9], [0.2]], [[0.4], [0.7]]])


def bowl(optimiser: Any, **options: Any) -> Any:
    rate = 0.5 if "sgd" in str(options.pop("name", "")).lower() else 0.05
    arguments: dict[str, Any] = {"steps": 60, "learning_rate": rate, "optimise": ["pixels"]} | options
    return fit(Bowl(), PixelL2(GOAL), optimiser=optimiser, **arguments)


@pytest.mark.parametrize("name", OPTIMISERS)
def test_a_fit_uses_the_given_optimiser(name: str) -> None:
    optimiser = OPTIMISERS[name]()
    assert isinstance(optimiser, Optimiser)
    result = bowl(optimiser, name=name)
    assert result.best_value < 0.1 * result.history[0].value
    assert result.params["pixels"].dtype == np.float64


@pytest.mark.parametrize("name", ["torch Adam", "optax adam"])
def test_adam_of_torch_and_optax_gives_the_same_fit(name: str) -> None:
    own_adam, wrapped_adam = run(steps=20), run(steps=20, optimiser=OPTIMISERS[name]())
    # The wrapped Adam adds 1e-8 to the root of the squares, the core next to nothing; gradients here exceed 1e-4.
    np.testing.assert_allclose(wrapped_adam.params["positions"], own_adam.params["positions"], rtol=0, atol=0.02)


@pytest.mark.parametrize("name", OPTIMISERS)
def test_a_resumed_fit_equals_an_uninterrupted_one_for_any_optimiser(name: str, tmp_path: Path) -> None:
    whole, file = bowl(OPTIMISERS[name](), name=name), tmp_path / "state.npz"

    def stop(step: FitStep, params: Any, image: Any) -> None:
        if step.step == 30:
            raise KeyboardInterrupt

    with pytest.raises(FitInterruptedError):
        bowl(OPTIMISERS[name](), name=name, checkpoint=file, callback=stop)
    resumed = bowl(OPTIMISERS[name](), name=name, checkpoint=file, resume=True)
    assert [entry.value for entry in resumed.history] == [entry.value for entry in whole.history]
    np.testing.assert_array_equal(resumed.params["pixels"], whole.params["pixels"])


@pytest.mark.parametrize("name", ["lbfgs", "polyak_sgd"])
def test_optax_transformations_that_need_a_value_are_refused_at_the_start(name: str) -> None:
    with pytest.raises(OptionError, match="`optimiser` must be a transformation of the gradient alone"):
        run(steps=3, optimiser=optax_optimiser(name))


def test_a_checkpoint_holds_random_keys(tmp_path: Path) -> None:
    def noisy() -> Any:
        pytest.importorskip("optax")
        optax = load("optax")
        return loi_jax.OptaxOptimiser(optax.chain(optax.add_noise(0.01, 0.5, 0), optax.adam(1.0)))

    whole, file = bowl(noisy(), steps=30, decay="none"), tmp_path / "state.npz"
    bowl(noisy(), steps=15, checkpoint=file, decay="none")
    resumed = bowl(noisy(), steps=30, checkpoint=file, decay="none", resume=True)
    np.testing.assert_array_equal(resumed.params["pixels"], whole.params["pixels"])


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (Adam, OPTIMISERS["torch Adam"]),
        (OPTIMISERS["torch Adam"], OPTIMISERS["torch NAdam"]),
        (OPTIMISERS["torch Adam"], lambda: torch_optimiser("Adam", amsgrad=True)),
        (OPTIMISERS["optax adam"], Adam),
        (OPTIMISERS["optax adam"], lambda: optax_optimiser("adamax", 1.0)),
        (OPTIMISERS["optax adam"], lambda: optax_optimiser("adam", 1.0, 0.8)),
    ],
)
def test_a_checkpoint_of_another_optimiser_is_refused(first: Any, second: Any, tmp_path: Path) -> None:
    bowl(first(), steps=3, checkpoint=tmp_path / "state.npz")
    with pytest.raises(ParameterError, match="`checkpoint` was made with optimiser ="):
        bowl(second(), steps=6, checkpoint=tmp_path / "state.npz", resume=True)


class Named:
    """A renderer whose image is its parameters, with any names and in any array library."""

    def __init__(self, *names: str, zeros: Any = np.zeros, stack: Any = np.stack, copy: Any = np.copy) -> None:
        self.start = {name: zeros((2,)) for name in names}
        self.stack, self.copy = stack, copy

    def parameters(self) -> dict[str, Any]:
        return {name: self.copy(value) for name, value in self.start.items()}

    def render(self, params: dict[str, Any], *, seed: int = 0) -> Any:
        return self.stack([params[name] for name in sorted(params)])[..., None]

    def render_vjp(self, params: dict[str, Any], *, seed: int = 0) -> Any:
        names = sorted(params)
        return self.render(params), lambda g: {name: g[index, :, 0] for index, name in enumerate(names)}


@pytest.mark.parametrize("name", ["Adam", "torch Adam", "optax adam"])
def test_parameter_names_with_slashes_do_not_collide(name: str) -> None:
    goal = np.array([[0.3, 0.7], [0.2, 0.5]])[..., None]
    results = []
    for names in (("b/c", "b"), ("b", "b/c")):
        result = fit(Named(*names), PixelL2(goal), steps=20, learning_rate=0.05, optimiser=OPTIMISERS[name]())
        results.append([result.params[key].tolist() for key in ("b", "b/c")])
    assert results[0] == results[1]


# JAX converts tensors of other libraries through NumPy, which has no bfloat16.
@pytest.mark.parametrize(
    ("dtype", "name"), [("float16", "torch Adam"), ("float16", "optax adam"), ("bfloat16", "torch Adam")]
)
def test_parameters_of_16_bits_are_fitted_and_resumed_with_wrapped_optimisers(
    dtype: str, name: str, tmp_path: Path
) -> None:
    goal, file = np.array([[0.3, 0.7]])[..., None], tmp_path / "state.npz"

    def go(steps: int, **options: Any) -> Any:
        zeros = functools.partial(torch.zeros, dtype=getattr(torch, dtype))
        renderer = Named("b", zeros=zeros, stack=torch.stack, copy=torch.clone)
        arguments: dict[str, Any] = {"learning_rate": 0.05, "decay": "none", "optimiser": OPTIMISERS[name]()}
        return fit(renderer, PixelL2(goal), steps=steps, **arguments, **options)

    whole = go(40)
    assert whole.best_value < 0.01 * whole.history[0].value
    go(20, checkpoint=file)
    resumed = go(40, checkpoint=file, resume=True)
    assert [entry.value for entry in resumed.history] == [entry.value for entry in whole.history]


def test_an_optimiser_may_leave_out_fixed_parameters() -> None:
    class Moved(Adam):
        def step(self, params: Any, gradient: Any, memory: Any, rates: Any) -> Any:
            moved, updated = super().step(params, gradient, memory, rates)
            return {name: moved[name] for name in rates}, updated

    goal = PixelL2(np.ones((2, 2, 1)))
    result = fit(Named("b", "c"), goal, steps=3, learning_rate=0.1, optimise=["b"], optimiser=Moved())
    assert np.all(result.params["c"] == 0.0)
    assert np.all(result.params["b"] > 0.0)


def test_an_error_of_the_optimiser_keeps_the_result() -> None:
    class Broken(Adam):
        def step(self, params: Any, gradient: Any, memory: Any, rates: Any) -> Any:
            if memory["count"] == 3:
                msg = "no more"
                raise RuntimeError(msg)
            return super().step(params, gradient, memory, rates)

    with pytest.raises(FitError, match="step 3: the optimiser failed: RuntimeError: no more") as stopped:
        bowl(Broken())
    assert stopped.value.result is not None


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: torch_optimiser("LBFGS"), "must step without a closure"),
        (lambda: torch_optimiser("Adam", lr=1.0), "`lr` is set by the fit"),
        (lambda: torch_optimiser("Adam", betas=3), "Adam does not take these options"),
        (lambda: loi_torch.TorchOptimiser(torch.nn.Linear), "must be a class of torch.optim"),
        (lambda: loi_jax.OptaxOptimiser("adam"), "must be an optax transformation"),
        (lambda: bowl("adam"), "`optimiser` must be an Optimiser"),
        (lambda: bowl(Adam), "`optimiser` must be an Optimiser"),
    ],
)
def test_invalid_optimisers_are_refused(make: Any, says: str) -> None:
    with pytest.raises(OptionError, match=says):
        make()
