"""The tone curve is odd, increasing and finite for all floats, and its derivative is part of the gradient."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from loi_core import Free, GaussianPyramid, LogTone, LOIObjective, PixelL2, ScaleSpace, fit
from loi_core.errors import OptionError
from loi_core.objectives import ImageObjective
from loi_core.renderers import Disks
from loi_core.testing import check_objective
from tests.frameworks import array_api_strict, jax, jnp, torch
from tests.helpers import Host, directional_difference

# These tests use values beyond the bounds on purpose.
pytestmark = pytest.mark.filterwarnings("ignore::loi_core.objectives.RangeWarning")

TONES = st.builds(LogTone, st.floats(1e-12, 1e12), st.floats(1e-3, 1e6))
WIDTHS = {"float32": 32, "float64": 64}
OBJECTIVES: dict[str, Any] = {
    "loi": lambda reference, **options: LOIObjective(reference, ScaleSpace((0, 2), (1, 5), 0.125, (-1, 1)), **options),
    "pixel": PixelL2,
    "pyramid": GaussianPyramid,
}


def radiance(shape: tuple[int, ...], seed: int) -> tuple[Host, Host]:
    """Return two images over six orders of magnitude, with some negative values."""
    rng = np.random.default_rng(seed)
    first, second = 10.0 ** rng.uniform(-4.0, 2.0, (2, *shape)) * rng.choice([1.0, 1.0, 1.0, -0.1], (2, *shape))
    return first, second


@given(TONES, st.data(), st.sampled_from(list(WIDTHS)))
def test_the_tone_curve_is_finite_odd_and_increasing_for_all_floats(
    tone: LogTone, data: st.DataObject, dtype: str
) -> None:
    floats = st.floats(width=WIDTHS[dtype], allow_nan=False, allow_infinity=False)  # type: ignore[arg-type]
    samples = [*data.draw(st.lists(floats, min_size=1, max_size=6)), tone.peak, 1e-3 * tone.peak, 1e30]
    largest, smallest = np.finfo(dtype).max, np.finfo(dtype).smallest_subnormal
    values = np.sort(np.array([*samples, largest, -largest, smallest, -smallest, 0.0], dtype=dtype))
    curve, slope = tone.apply(values), tone.pullback(values, np.ones_like(values))
    eps = float(np.finfo(dtype).eps)
    assert curve.dtype == slope.dtype == np.dtype(dtype)
    assert np.all(np.isfinite(curve))
    assert np.all(np.isfinite(slope))
    assert np.all(slope >= 0.0)
    np.testing.assert_array_equal(tone.apply(-values), -curve)
    np.testing.assert_array_equal(tone.pullback(-values, np.ones_like(values)), slope)
    # Logarithms have errors of a few units in the last place, so neighbouring floats may swap by as much.
    assert np.all(np.diff(curve) >= -8.0 * eps * np.abs(curve[1:]))
    assert np.all(np.diff(tone.apply(tone.peak * np.logspace(-6, 12, 60, dtype=dtype))) > 0.0)
    assert float(tone.apply(np.asarray(tone.peak, dtype=dtype))) == pytest.approx(1.0, rel=16 * eps)


@given(TONES, st.floats(-1e3, 1e3))
def test_the_tone_curve_and_its_slope_equal_the_formulas(tone: LogTone, relative: float) -> None:
    x = np.array([relative * tone.peak])
    scale = np.log1p(tone.compression)
    inside = tone.compression * abs(relative)
    np.testing.assert_allclose(tone.apply(x), np.sign(x) * np.log1p(inside) / scale, rtol=1e-13)
    slope = tone.compression / tone.peak / scale / (1.0 + inside)
    np.testing.assert_allclose(tone.pullback(x, np.full_like(x, 3.0)), 3.0 * slope, rtol=1e-13)


@pytest.mark.parametrize("library", [torch, jnp, array_api_strict], ids=["torch", "JAX", "strict"])
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_the_tone_curve_is_equal_in_every_library(library: Any, dtype: str) -> None:
    tone, asarray = LogTone(2.0), library.asarray
    values = np.array([0.0, -0.0, 1e-30, 0.3, -0.3, 2.0, 1e4, 1e30, -1e30, np.inf, -np.inf, np.nan], dtype=dtype)
    eps = float(np.finfo(dtype).eps)
    curve = np.asarray(tone.apply(asarray(values)))
    slope = np.asarray(tone.pullback(asarray(values), asarray(np.ones_like(values))))
    assert curve.dtype == slope.dtype == np.dtype(dtype)
    np.testing.assert_allclose(curve, tone.apply(values), rtol=8 * eps)
    np.testing.assert_allclose(slope, tone.pullback(values, np.ones_like(values)), rtol=8 * eps)


def test_the_slope_of_the_tone_curve_equals_autograd_also_at_zero() -> None:
    tone = LogTone(2.0, 100.0)
    values = np.array([0.0, -0.0, 1e-9, -1e-9, 0.5, -0.5, 2.0, 1e9])
    slope = tone.pullback(values, np.ones_like(values))
    leaf = torch.tensor(values, requires_grad=True)
    tone.apply(leaf).sum().backward()
    assert leaf.grad is not None
    np.testing.assert_allclose(leaf.grad, slope, rtol=1e-14)
    np.testing.assert_allclose(jax.grad(lambda x: jnp.sum(tone.apply(x)))(jnp.asarray(values)), slope, rtol=1e-14)


@pytest.mark.parametrize("name", OBJECTIVES)
@pytest.mark.parametrize("policy", ["raise", "mask"])
def test_the_derivative_of_the_tone_curve_is_part_of_the_gradient(name: str, policy: str) -> None:
    image, reference = radiance((13, 11, 3), seed=2)
    tone = LogTone(100.0)
    objective: ImageObjective[Any] = OBJECTIVES[name](reference, tone=tone, nan_policy=policy)
    assert objective.tone is tone
    _, gradient = objective.value_and_grad(image)
    for seed in range(3):
        # Relative steps, because pixels differ in magnitude; no value lies beyond the bounds.
        direction = np.random.default_rng(seed).standard_normal(image.shape) * np.abs(image)
        measured = directional_difference(objective.value, image, direction, 1e-7)
        assert abs(measured - float(np.sum(gradient * direction))) < 1e-6 * np.linalg.norm(gradient * np.abs(image))


@pytest.mark.parametrize("name", OBJECTIVES)
def test_an_objective_with_a_tone_curve_equals_the_objective_of_toned_images(name: str) -> None:
    image, reference = radiance((9, 8, 2), seed=3)
    tone = LogTone(5.0, 50.0)
    value, gradient = OBJECTIVES[name](reference, tone=tone).value_and_grad(image)
    plain, slope = OBJECTIVES[name](tone.apply(reference)).value_and_grad(tone.apply(image))
    assert float(value) == pytest.approx(float(plain), rel=1e-14)
    np.testing.assert_allclose(gradient, tone.pullback(image, slope), rtol=1e-12)


@pytest.mark.parametrize("name", OBJECTIVES)
@pytest.mark.parametrize("library", [np, torch], ids=["numpy", "torch"])
def test_objectives_with_a_tone_curve_keep_the_contract(name: str, library: Any) -> None:
    check_objective(lambda reference: OBJECTIVES[name](reference, tone=LogTone(2.0, 20.0)), asarray=library.asarray)


def test_radiance_beyond_the_peak_has_a_gradient_towards_the_reference() -> None:
    image = np.array([1e30, 50.0, 0.5, -3.0]).reshape(1, 4, 1)
    for level, signs in ((0.1, [1, 1, 1, -1]), (9.0, [1, 1, -1, -1]), (20.0, [1, 1, -1, -1])):
        objective = LOIObjective(np.full((1, 4, 1), level), ScaleSpace(0, 0, 0.125), tone=LogTone(10.0))
        value, gradient = objective.value_and_grad(image)
        assert np.isfinite(value)
        assert np.all(np.isfinite(gradient))
        np.testing.assert_array_equal(np.sign(gradient.ravel()), signs)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"peak": 0.0}, "`peak` of a tone curve must be a number from 1e-12 to 1e\\+12, got 0.0"),
        ({"peak": np.nan}, "`peak`.*got nan"),
        ({"peak": "bright"}, "`peak`.*got 'bright'"),
        ({"peak": True}, "`peak`.*got True"),
        ({"peak": 1.0, "compression": -1.0}, "`compression` of a tone curve must be a number from 0.001 to 1e\\+06"),
        ({"peak": 1.0, "compression": np.inf}, "`compression`"),
    ],
)
def test_invalid_tone_curves_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(OptionError, match=message):
        LogTone(**options)


@pytest.mark.parametrize("name", OBJECTIVES)
def test_a_tone_must_be_a_tone_curve(name: str) -> None:
    with pytest.raises(OptionError, match=r"`tone` must be a LogTone or None, got 2\.0"):
        OBJECTIVES[name](np.zeros((8, 8, 1)), tone=2.0)


def test_tone_curves_take_numbers_of_any_library() -> None:
    assert LogTone(np.float32(2), torch.tensor(100.0)) == LogTone(2.0, 100)  # type: ignore[arg-type]


class FireflyScene:
    """A dim disk and a light a thousand times as bright, with fireflies of up to a million at random pixels."""

    size: ClassVar[int] = 32
    dim: ClassVar[tuple[float, ...]] = (0.06, 0.04, 0.02)
    goal: ClassVar[Host] = np.array([[9.0, 24.0], [23.0, 8.0]])
    light: ClassVar[Host] = np.array([60.0, 40.0, 20.0])
    # The dim disk starts without overlap with its goal, the light at its goal with a wrong radiance.
    optimise: ClassVar[dict[str, Free]] = {
        "positions": Free([[8.0, 7.0], goal[1]], [[4.0, 4.0], goal[1]], [[28.0, 28.0], goal[1]]),
        "colours": Free([dim, [10.0] * 3], [dim, [0.0] * 3], [dim, [1e3] * 3], learning_rate=2.0),
    }

    def __init__(self) -> None:
        self._disks = Disks(self.size, self.size, self.goal, [4.0, 3.0], np.stack([self.dim, self.light]), [0.002] * 3)

    def parameters(self) -> dict[str, Host]:
        return self._disks.parameters()

    def render(self, params: dict[str, Host], *, seed: int = 0) -> Host:
        return self.render_vjp(params, seed=seed)[0]

    def render_vjp(self, params: dict[str, Host], *, seed: int = 0) -> tuple[Host, Callable[[Host], dict[str, Host]]]:
        image, pullback = self._disks.render_vjp(params)
        rng = np.random.default_rng(seed)
        rows, columns = rng.integers(self.size, size=(2, 4))
        image[rows, columns] = 10.0 ** rng.uniform(2.0, 6.0, (4, 1))
        return image, pullback

    def errors(self, make: Callable[[Host], ImageObjective[Any]]) -> tuple[float, float]:
        """Return the errors of a fit: of the dim disk's position, in pixels, and of the light, relative."""
        reference = self._disks.render(self.parameters())
        params = fit(self, make(reference), steps=100, learning_rate=1.0, optimise=self.optimise).params
        position_error = np.linalg.norm(params["positions"][0] - self.goal[0])
        return float(position_error), float(np.max(np.abs(params["colours"][1] / self.light - 1.0)))


def test_a_fit_of_high_dynamic_range_with_fireflies_needs_no_tone_curve() -> None:
    scene, curve, alpha = FireflyScene(), LogTone(100.0), (1.2, 3.7, 11.2)
    disk_error, light_error = scene.errors(
        lambda reference: LOIObjective(reference, ScaleSpace(1, alpha, 0.125), tone=curve)
    )
    assert disk_error < 0.1
    assert light_error < 0.01
    # Beyond the bounds, intensities are compared by their logarithm; wide bounds would not resolve the disk.
    narrow = scene.errors(lambda reference: LOIObjective(reference, ScaleSpace(1, alpha, 0.125)))
    assert narrow[0] < 0.1
    assert narrow[1] < 0.1
    wide = scene.errors(lambda reference: LOIObjective(reference, ScaleSpace(1, alpha, 12.5, (0, 100))))
    assert wide[0] > 10.0
    # The curve also helps the baselines, whose squares are dominated by fireflies.
    assert min(scene.errors(GaussianPyramid)) > 0.5
    assert scene.errors(lambda reference: GaussianPyramid(reference, tone=curve))[0] < 1.0
