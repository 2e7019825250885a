"""Every check of the conformance kit can fail: each broken subject is detected by the check meant for it."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import loi_jax.renderers
import loi_torch.renderers
from loi_core import GaussianPyramid, LOIObjective, PixelL2, ScaleSpace
from loi_core.errors import ConformanceError, OptionError
from loi_core.renderers import Disks
from loi_core.testing import (
    OBJECTIVE_CHECKS,
    RENDERER_CHECKS,
    ObjectiveSubject,
    RendererSubject,
    check_objective,
    check_renderer,
    parametrize_with_checks,
)
from tests.testing.zoo import BROKEN_OBJECTIVES, BROKEN_RENDERERS, Inert, Params, Scaled, Sound, Wrapped, scaled


@pytest.mark.parametrize(
    ("broken", "name"),
    BROKEN_RENDERERS,
    ids=[f"{broken.__name__}-{index}" for index, (broken, _) in enumerate(BROKEN_RENDERERS)],
)
@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_a_broken_renderer_is_detected_by_the_check_meant_for_it(broken: type[Sound], name: str, dtype: str) -> None:
    check = next(check for check in RENDERER_CHECKS if check.name == name)
    with pytest.raises(ConformanceError) as caught:
        check(RendererSubject(broken(dtype=dtype)))
    assert caught.value.check == name
    assert caught.value.rule == check.rule
    assert check.rule in str(caught.value)
    assert isinstance(caught.value, AssertionError)
    with pytest.raises(ConformanceError):
        check_renderer(broken(dtype=dtype))


@pytest.mark.parametrize(("broken", "name"), BROKEN_OBJECTIVES)
def test_a_broken_objective_is_detected_by_the_check_meant_for_it(broken: Callable[[Any], Any], name: str) -> None:
    check = next(check for check in OBJECTIVE_CHECKS if check.name == name)
    with pytest.raises(ConformanceError) as caught:
        check(ObjectiveSubject(broken))
    assert caught.value.check == name
    with pytest.raises(ConformanceError):
        check_objective(broken)


def test_every_check_has_a_subject_that_breaks_its_rule() -> None:
    assert {name for _, name in BROKEN_RENDERERS} == {check.name for check in RENDERER_CHECKS}
    assert {name for _, name in BROKEN_OBJECTIVES} == {check.name for check in OBJECTIVE_CHECKS}


@parametrize_with_checks(
    [
        RendererSubject(Sound()),
        RendererSubject(Inert()),
        RendererSubject(Sound(dtype="float32")),
        ObjectiveSubject(Wrapped),
    ]
)
def test_a_sound_renderer_and_objective_pass_every_check(check: Any, subject: Any) -> None:
    check(subject)


@parametrize_with_checks(
    [RendererSubject(scaled(2.0)())], expected_failures={"finite_differences": "its pullback is doubled on purpose"}
)
def test_expected_failures_are_marked_on_pytest_parameters(check: Any, subject: Any) -> None:
    check(subject)


def test_expected_failures_must_exist_and_must_fail() -> None:
    reason = {"finite_differences": "its pullback is doubled on purpose"}
    check_renderer(scaled(2.0)(), expected_failures=reason)
    with pytest.raises(ConformanceError, match="passed, but was expected to fail"):
        check_renderer(Sound(), expected_failures=reason)
    with pytest.raises(OptionError, match="names 'speed'; the checks are parameters, image"):
        check_renderer(Sound(), expected_failures={"speed": "slow"})
    with pytest.raises(OptionError, match="`seeds` must be 1 or more"):
        check_renderer(Sound(), seeds=0)
    with pytest.raises(OptionError, match="at least one subject"):
        parametrize_with_checks([])
    with pytest.raises(OptionError, match="names 'speed'; the checks are parameters, image"):
        parametrize_with_checks([RendererSubject(Sound())], expected_failures={"speed": "slow"})


def test_a_conformance_error_survives_pickling() -> None:
    error = ConformanceError("image", "a rule", "a finding")
    unpickled = pickle.loads(pickle.dumps(copy.copy(error)))  # noqa: S301 - written here, as by a worker process
    assert (str(unpickled), unpickled.check) == (str(error), "image")


class Blob:
    """A Gaussian, the smoothest of all renderers."""

    def __init__(self, dtype: str) -> None:
        self.dtype = np.dtype(dtype)
        self.rows, self.columns = (axis.astype(self.dtype) for axis in np.mgrid[:18, :24])

    def parameters(self) -> Params:
        return {"centre": np.array([11.3, 8.2], self.dtype), "spread": np.array(3.0, self.dtype)}

    def render(self, params: Params, *, seed: int = 0) -> Any:
        return self.render_vjp(params)[0]

    def render_vjp(self, params: Params, *, seed: int = 0) -> Any:
        centre, spread = params["centre"].copy(), params["spread"].copy()
        x, y = self.columns - centre[0], self.rows - centre[1]
        squared = x * x + y * y
        image = np.exp(-squared / (2.0 * spread * spread))[..., None].astype(self.dtype)

        def pullback(cotangent: Any) -> Params:
            product = (cotangent * image)[..., 0]
            centre_slope = np.array([np.sum(product * x), np.sum(product * y)]) / spread**2
            spread_slope = np.asarray(np.sum(product * squared) / spread**3, self.dtype)
            return {"centre": centre_slope.astype(self.dtype), "spread": spread_slope}

        return image, pullback


DISKS: Any = (14, 17, [[5.3, 9.1], [10.6, 4.4]], [3.2, 2.4], [[1, 0.5, 0.2], [0.1, 0.4, 0.9]], (0.2, 0.3, 0.1))
MAKERS: dict[str, Callable[[str], Any]] = {
    "blob": Blob,
    "numpy": lambda dtype: Disks(*DISKS, dtype=dtype),
    "torch": lambda dtype: loi_torch.renderers.Disks(*DISKS, dtype=dtype),
    "jax": lambda dtype: loi_jax.renderers.Disks(*DISKS, dtype=dtype),
}


@pytest.mark.parametrize(("dtype", "error"), [("float64", 1e-3), ("float32", 1e-2)])
@pytest.mark.parametrize("name", MAKERS)
def test_a_small_error_of_the_gradient_is_detected_in_every_dtype_and_library(
    name: str, dtype: str, error: float
) -> None:
    check_renderer(MAKERS[name](dtype))
    for factor in (1.0 + error, 1.0 - error, 1.1, 0.9):
        with pytest.raises(ConformanceError, match=r"finite_differences: .* off by"):
            check_renderer(Scaled(MAKERS[name](dtype), factor))


class Noisy(Blob):
    """A blob with independent noise of image and pullback for each seed, as in a Monte Carlo renderer."""

    def __init__(self, size: float = 0.05, dtype: str = "float32") -> None:
        super().__init__(dtype)
        self.size = size

    def render_vjp(self, params: Params, *, seed: int = 0) -> Any:
        image, pullback = super().render_vjp(params)
        rng = np.random.default_rng(seed)
        image = image + 0.01 * rng.standard_normal(image.shape).astype(self.dtype)
        factor = self.dtype.type(1.0 + self.size * rng.standard_normal())
        return image, lambda g: {k: v * factor for k, v in pullback(g).items()}


def test_averaging_over_seeds_detects_an_error_of_5_percent_under_noise() -> None:
    check_renderer(Noisy(), seeds=25)
    for factor in (1.05, 0.95):
        with pytest.raises(ConformanceError, match=r"finite_differences: .* off by"):
            check_renderer(Scaled(Noisy(), factor), seeds=50)
    with pytest.raises(ConformanceError, match="average over more seeds"):
        check_renderer(Noisy(1.0), seeds=4)


class Counted(Noisy):
    def render(self, params: Params, *, seed: int = 0) -> Any:
        self.renders = getattr(self, "renders", 0) + 1
        return super().render(params, seed=seed)


def test_noise_does_not_cause_retries_at_other_parameters() -> None:
    noisy, quiet = Counted(0.05), Counted(0.0)
    check_renderer(noisy, seeds=25)
    check_renderer(quiet, seeds=25)
    assert noisy.renders == quiet.renders


@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("shape", [(16, 12, 3), (3, 9, 1)])
def test_all_objectives_of_the_library_keep_the_contract(dtype: str, shape: tuple[int, ...]) -> None:
    for make in (
        PixelL2,
        GaussianPyramid,
        LOIObjective,
        lambda reference: LOIObjective(reference, ScaleSpace.paper("path")),
        lambda reference: LOIObjective(reference, ScaleSpace.released((1, 5), (1, 5), 8, 21)),
        lambda reference: LOIObjective(reference, ScaleSpace(1, 3, 0.1), nan_policy="mask"),
    ):
        check_objective(make, dtype=dtype, shape=shape)
