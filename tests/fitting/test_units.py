"""Rates in pixels suit images without edges: a grey texture, a uniform colour, a black image."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from loi_core import Free, LOIObjective, PixelL2, fit
from loi_core.errors import RendererError
from loi_core.fitting.parameters import bounds_of
from loi_core.renderers import Disks
from loi_core.renderers.units import measure_units
from tests.contents import photograph

SIZE = 32
BOUNDED = Free(None, 0.0, 1.0)


class Texture:
    """A renderer whose image is its parameter, broadcast from a texel, a row, or a colour."""

    def __init__(self, start: Any) -> None:
        self.start = np.asarray(start, dtype=np.float64)

    def parameters(self) -> dict[str, Any]:
        return {"texels": self.start.copy()}

    def render(self, params: dict[str, Any], *, seed: int = 0) -> Any:
        return np.broadcast_to(params["texels"], (SIZE, SIZE, 3)).copy()

    def render_vjp(self, params: dict[str, Any], *, seed: int = 0) -> Any:
        axes = tuple(axis for axis, size in enumerate(self.start.shape) if size != (SIZE, SIZE, 3)[axis])
        return self.render(params), lambda gradient: {"texels": np.sum(gradient, axis=axes, keepdims=True)}


def grey(*shape: int) -> Texture:
    return Texture(np.full(shape, 0.5))


@pytest.mark.parametrize("free", [BOUNDED, Free()], ids=["bounded", "unbounded"])
@pytest.mark.parametrize("steps", [60, 200])
def test_a_grey_texture_is_found_at_the_default_rate(free: Free, steps: int) -> None:
    target = photograph((SIZE, SIZE, 3), np.random.default_rng(3))
    result = fit(grey(SIZE, SIZE, 3), LOIObjective(target), steps=steps, optimise={"texels": free})
    assert result.diagnosis is not None
    assert result.diagnosis.ok
    assert result.psnr is not None
    assert result.psnr > 20.0


def test_a_uniform_colour_is_found_at_the_default_rate() -> None:
    target = np.broadcast_to([0.9, 0.2, 0.4], (SIZE, SIZE, 3)).copy()
    result = fit(grey(1, 1, 3), LOIObjective(target), steps=100, optimise={"texels": BOUNDED})
    np.testing.assert_allclose(result.best_params["texels"].ravel(), [0.9, 0.2, 0.4], atol=0.02)


def test_a_black_texture_has_a_rate() -> None:
    target = photograph((SIZE, SIZE, 3), np.random.default_rng(4))
    result = fit(Texture(np.zeros((SIZE, SIZE, 3))), PixelL2(target), steps=100, optimise={"texels": BOUNDED})
    assert result.psnr is not None
    assert result.psnr > 30.0


@pytest.mark.parametrize("brightness", [1e-3, 1.0, 1e3])
def test_the_unit_of_a_position_does_not_depend_on_the_brightness_of_the_target(brightness: float) -> None:
    disk = Disks(48, 64, [[20.0, 20.0]], 6.0, [[0.9, 0.4, 0.2]])
    params = disk.parameters()
    bounds = bounds_of(params, {"positions": Free(lower=0.0, upper=64.0)})
    target = brightness * photograph((48, 64, 3), np.random.default_rng(5))
    units, _ = measure_units([disk], params, bounds, ["positions"], targets=[target])
    alone, _ = measure_units([disk], params, bounds, ["positions"])
    assert units == alone


def test_a_flat_view_does_not_change_the_unit_from_another_view() -> None:
    class Exposed:
        """A picture multiplied by its parameter."""

        def __init__(self, picture: Any) -> None:
            self.picture = picture

        def render(self, params: Any, *, seed: int = 0) -> Any:
            return self.picture * params["exposure"]

    picture = Exposed(photograph((SIZE, SIZE, 3), np.random.default_rng(6)))
    plain = Exposed(np.full((SIZE, SIZE, 3), 0.5))
    params = {"exposure": np.asarray(1.0)}
    alone, with_flat_view, flat = (
        measure_units(views, params, None, ["exposure"])[0] for views in ([picture], [picture, plain], [plain])
    )
    assert with_flat_view == alone
    assert flat == {"exposure": 1.0 / SIZE}


def test_non_finite_pixels_of_a_target_are_ignored() -> None:
    target = photograph((SIZE, SIZE, 3), np.random.default_rng(7))
    holed = target.copy()
    holed[4:9, 4:9] = np.nan
    renderer = grey(SIZE, SIZE, 3)
    params = renderer.parameters()
    whole, _ = measure_units([renderer], params, None, ["texels"], targets=[target])
    masked, _ = measure_units([renderer], params, None, ["texels"], targets=[holed])
    assert masked["texels"] == pytest.approx(whole["texels"], rel=0.3)


def test_an_error_while_measuring_a_unit_names_the_parameter() -> None:
    class Strict(Disks):
        def render(self, params: Any, *, seed: int = 0) -> Any:
            if np.max(params["radii"]) > 6.0:
                msg = "radius out of range"
                raise ValueError(msg)
            return super().render(params, seed=seed)

    renderer = Strict(32, 48, [[20.0, 16.0]], 6.0, [[0.9, 0.4, 0.2]])
    with pytest.raises(
        RendererError, match=r"rendering with 'radii' moved, to measure its unit, failed: .*out of range"
    ):
        measure_units([renderer], renderer.parameters(), None, ["radii"])
