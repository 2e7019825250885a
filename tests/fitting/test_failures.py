"""An error during a fit is one line and keeps the best result so far."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from loi_core import Free, PixelL2, RendererCapabilities, fit
from loi_core.errors import FitDivergedError, FitError, LoiError, RendererError
from loi_core.renderers import Disks
from tests.fitting.fits import Bowl, bad_pullback, run


@pytest.mark.parametrize(
    ("legal", "says"),
    [
        ({"unused": np.zeros(())}, "the projection gave no value for 'pixels'"),
        ({"pixels": np.zeros(3)}, r"the value of 'pixels' must be an array of shape \(2, 2, 1\), got shape \(3,\)"),
    ],
)
def test_a_projection_without_a_valid_array_is_refused(legal: Any, says: str) -> None:
    class Bad(Bowl):
        @property
        def capabilities(self) -> RendererCapabilities:
            return RendererCapabilities(project=self.project)

        def project(self, params: dict[str, Any]) -> Any:
            return legal

    with pytest.raises(FitError, match=f"step 0: the projection failed: RendererError: {says}"):
        fit(Bad(), PixelL2(np.ones((2, 2, 1))), steps=3, learning_rate=1, optimise=["pixels"])


@pytest.mark.parametrize(
    ("gradient", "says"),
    [
        ({"unused": np.zeros(())}, "the pullback gave no cotangent for 'pixels'"),
        (3.0, "the pullback gave no cotangent"),
        ({"pixels": np.zeros((2, 2))}, r"'pixels' must be an array of shape \(2, 2, 1\), got shape \(2, 2\)"),
        ({"pixels": 1.0}, "must be an array of shape .*, got float"),
        ({"pixels": np.ones((2, 2, 1), complex)}, "the gradient of 'pixels' must be floating-point, got complex128"),
        ({"pixels": np.zeros((2, 2, 1), int)}, "the gradient of 'pixels' must be floating-point, got int64"),
    ],
)
def test_a_pullback_that_breaks_the_contract_is_refused(gradient: Any, says: str) -> None:
    with pytest.raises(RendererError, match=says):
        fit(bad_pullback(gradient), PixelL2(np.ones((2, 2, 1))), steps=3, learning_rate=1, optimise=["pixels"])


@pytest.mark.parametrize("params", [{}, {"a": np.zeros(3, dtype=int)}, {"a": 1.0}, 5])
def test_parameters_that_cannot_be_optimised_are_refused(params: Any) -> None:
    class Bad(Bowl):
        def parameters(self) -> Any:
            return params

    with pytest.raises(RendererError, match=r"Bad\.parameters\(\)"):
        fit(Bad(), PixelL2(np.ones((2, 2, 1))), steps=3, learning_rate=1)


def test_a_renderer_that_fails_later_leaves_a_result() -> None:
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
def test_a_failure_after_the_last_step_keeps_the_best_result(broken: str, monkeypatch: pytest.MonkeyPatch) -> None:
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
        def value_and_grad(self, image: Any, *, weights: Any = None) -> Any:
            return "much", image

    with pytest.raises(FitError, match="step 0: the objective failed: ValueError"):
        fit(Bowl(), Wordy(np.ones((2, 2, 1))), steps=4, learning_rate=0.1)


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
    with pytest.raises(FitDivergedError, match=says) as caught:
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
        (
            {"learning_rate": -1},
            "`learning_rate` must be a finite number, more than 0, or pixels as in '1.5 px', got -1",
        ),
        ({"seed": -1}, "`seed`"),
        ({"resume": True}, "`resume` must be False without a `checkpoint` to continue from, got True"),
        ({"views_per_step": 1}, "`views_per_step` must be left out unless `renderer` is a dict of views, got 1"),
        ({"decay": "linear"}, "`decay` must be one of 'cosine', 'none', got 'linear'"),
        ({"optimise": ["colour"]}, "'colour', which the renderer does not have; it has colours, positions, radii"),
        ({"optimise": []}, "`optimise` must name at least one parameter"),
        ({"optimise": "positions"}, "`optimise` must be names"),
        ({"optimise": {"positions": 1}}, "must be a Free, got int"),
        ({"optimise": {"positions": Free([1, 2, 3])}}, r"`initial` of 'positions' must be a number or fill shape"),
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


class Exiting(Disks):
    """A renderer that raises SystemExit in its third gradient."""

    calls = 0

    def render_vjp(self, params: Any, *, seed: int = 0) -> Any:
        self.calls += 1
        if self.calls == 3:
            raise SystemExit(0)
        return super().render_vjp(params, seed=seed)


def test_a_renderer_that_raises_system_exit_ends_the_fit_with_a_result() -> None:
    renderer = Exiting(6, 6, [[2.0, 3.0]], [1.5], [[0.9, 0.2, 0.1]])
    with pytest.raises(FitError, match="step 2: rendering failed: SystemExit: 0") as caught:
        fit(renderer, PixelL2(np.full((6, 6, 3), 0.25)), steps=5, learning_rate=0.1)
    assert caught.value.result is not None
