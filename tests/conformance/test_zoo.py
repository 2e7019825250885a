"""Every check of the conformance kit can fail: each broken subject is caught by the check meant for it, by name."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from loi_core import GaussianPyramid, LOIObjective, PixelL2, ScaleSpace
from loi_core.errors import ConformanceError, OptionError
from loi_core.testing import (
    OBJECTIVE_CHECKS,
    RENDERER_CHECKS,
    ObjectiveSubject,
    RendererSubject,
    check_objective,
    check_renderer,
    parametrize_with_checks,
)
from tests.conformance.zoo import BROKEN_OBJECTIVES, BROKEN_RENDERERS, Params, Sound, Wrapped, scaled


@pytest.mark.parametrize(
    ("broken", "name"),
    BROKEN_RENDERERS,
    ids=[f"{one.__name__}-{number}" for number, (one, _) in enumerate(BROKEN_RENDERERS)],
)
def test_a_broken_renderer_is_caught_by_the_check_meant_for_it(broken: type[Sound], name: str) -> None:
    check = next(one for one in RENDERER_CHECKS if one.name == name)
    with pytest.raises(ConformanceError) as caught:
        check(RendererSubject(broken()))
    assert caught.value.check == name
    assert caught.value.rule == check.rule
    assert check.rule in str(caught.value)
    assert isinstance(caught.value, AssertionError)
    with pytest.raises(ConformanceError):
        check_renderer(broken())


@pytest.mark.parametrize(("broken", "name"), BROKEN_OBJECTIVES)
def test_a_broken_objective_is_caught_by_the_check_meant_for_it(broken: Callable[[Any], Any], name: str) -> None:
    check = next(one for one in OBJECTIVE_CHECKS if one.name == name)
    with pytest.raises(ConformanceError) as caught:
        check(ObjectiveSubject(broken))
    assert caught.value.check == name
    with pytest.raises(ConformanceError):
        check_objective(broken)


def test_every_check_has_a_subject_that_it_catches() -> None:
    assert {name for _, name in BROKEN_RENDERERS} == {check.name for check in RENDERER_CHECKS}
    assert {name for _, name in BROKEN_OBJECTIVES} == {check.name for check in OBJECTIVE_CHECKS}


@parametrize_with_checks(
    [RendererSubject(Sound()), RendererSubject(Sound(dtype="float32"), rtol=2e-2), ObjectiveSubject(Wrapped)]
)
def test_what_is_sound_passes(check: Any, subject: Any) -> None:
    check(subject)


def test_known_failures_are_named_and_must_fail() -> None:
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


def test_a_conformance_error_survives_pickling() -> None:
    error = ConformanceError("image", "a rule", "a finding")
    again = pickle.loads(pickle.dumps(copy.copy(error)))  # noqa: S301 - our own, as a worker process would send it
    assert (str(again), again.check) == (str(error), "image")


class Noisy(Sound):
    """Independent noise for each seed, and for the pullback, as a Monte Carlo renderer has it."""

    def __init__(self, factor: float = 1.0) -> None:
        super().__init__()
        self.factor = factor

    def render_vjp(self, params: Params, *, seed: int = 0) -> Any:
        image, pullback = super().render_vjp(params)
        rng = np.random.default_rng(seed)
        image = image + 0.01 * rng.standard_normal(image.shape)
        noise = 0.3 * rng.standard_normal()
        return image, lambda g: {k: v * (self.factor + noise) for k, v in pullback(g).items()}

    def render(self, params: Params, *, seed: int = 0) -> Any:
        return self.render_vjp(params, seed=seed)[0]


def test_noise_is_averaged_over_seeds() -> None:
    check_renderer(Noisy(), seeds=200, rtol=0.08)
    with pytest.raises(ConformanceError, match="finite_differences"):
        check_renderer(Noisy(1.25), seeds=200, rtol=0.08)
    with pytest.raises(ConformanceError, match="finite_differences"):
        check_renderer(Noisy(), seeds=1, rtol=0.01)


@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("shape", [(16, 12, 3), (3, 9, 1)])
def test_all_objectives_of_the_library_conform(dtype: str, shape: tuple[int, ...]) -> None:
    rtol = 1e-2 if dtype == "float64" else 5e-2
    for make in (
        PixelL2,
        GaussianPyramid,
        LOIObjective,
        lambda reference: LOIObjective(reference, ScaleSpace.paper("path")),
        lambda reference: LOIObjective(reference, ScaleSpace.released((1, 5), (1, 5), 8, 21)),
        lambda reference: LOIObjective(reference, ScaleSpace(1, 3, 0.1), nan_policy="mask"),
    ):
        check_objective(make, dtype=dtype, shape=shape, rtol=rtol)
