"""Blurring in parameter space gives the gradient of the blurred image, whatever the renderer."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from loi_core import Free, LOIObjective, PixelL2, fit
from loi_core.errors import OptionError, ParameterError
from loi_core.renderers import BlurredRenderer, Disks
from loi_core.renderers.contract import RendererCapabilities, capabilities_of
from loi_core.testing import check_renderer
from tests.strategies import thorough


@dataclass
class Steps:
    """An image whose pixels jump as a sum of parameters passes them: its own gradient is 0 nearly everywhere."""

    edges: Any = field(default_factory=lambda: np.linspace(-2.0, 2.0, 12).reshape(2, 2, 3))
    seeds: list[int] = field(default_factory=list)

    def parameters(self) -> dict[str, Any]:
        return {"a": np.array(0.3), "b": np.array([-0.2, 0.5])}

    def render(self, params: dict[str, Any], *, seed: int = 0) -> Any:
        self.seeds.append(seed)
        return (self.edges < params["a"] + np.sin(params["b"]).sum()).astype(float)

    def render_vjp(self, params: dict[str, Any], *, seed: int = 0) -> Any:
        return self.render(params, seed=seed), lambda _: {"a": np.array(7.0), "b": np.zeros(2)}


COTANGENT = np.random.default_rng(0).standard_normal((2, 2, 3))
SIGMA = {"a": 0.4, "b": 0.7}


def quadrature(renderer: Any, params: dict[str, Any], sigma: dict[str, float]) -> dict[str, Any]:
    """The gradient of the blurred image times the cotangent, on a fine grid over all three numbers."""
    offsets = np.linspace(-5.0, 5.0, 161)
    density = np.exp(-0.5 * offsets**2)
    density /= density.sum()
    gradient = {"a": np.zeros(()), "b": np.zeros(2)}
    for z1, p1 in zip(offsets, density, strict=True):
        # The image is a function of a sum, so that two of the three offsets make a grid at once.
        inner = np.sin(params["b"][0] + sigma["b"] * offsets)[:, None] + np.sin(params["b"][1] + sigma["b"] * offsets)
        total = params["a"] + sigma["a"] * z1 + inner
        value = np.zeros(total.shape)
        for edge, weight in zip(renderer.edges.ravel(), COTANGENT.ravel(), strict=True):
            value += weight * (edge < total)
        weighed = p1 * value * density[:, None] * density
        gradient["a"] += z1 * weighed.sum() / sigma["a"]
        gradient["b"][0] += (weighed * offsets[:, None]).sum() / sigma["b"]
        gradient["b"][1] += (weighed * offsets).sum() / sigma["b"]
    return gradient


@pytest.mark.parametrize("together", [False, True])
def test_the_gradient_is_that_of_the_blurred_image(together: bool) -> None:
    renderer = Steps()
    params = renderer.parameters()
    blurred = BlurredRenderer(renderer, SIGMA, together=together)
    drawn = [blurred.render_vjp(params, seed=seed)[1](COTANGENT) for seed in range(4000)]
    wanted = quadrature(renderer, params, SIGMA)
    for name, value in wanted.items():
        own = np.array([one[name] for one in drawn])
        error = own.std(axis=0, ddof=1) / np.sqrt(len(own))
        assert np.all(np.abs(own.mean(axis=0) - value) < 4.0 * error), name
        assert np.all(error < 0.1 * np.abs(wanted["a"]))


def loss_of(image: Any) -> float:
    """Far from linear in the image."""
    return float(np.sum(COTANGENT * image) ** 2 + np.sum(image) ** 1.5)


def blurred_loss(renderer: Any, params: dict[str, Any], sigma: dict[str, float]) -> dict[str, Any]:
    """The gradient of the blurred loss, on a grid over all three numbers."""
    offsets = np.linspace(-4.5, 4.5, 46)
    density = np.exp(-0.5 * offsets**2)
    density /= density.sum()
    gradient = {"a": np.zeros(()), "b": np.zeros(2)}
    for (i, z1), (j, z2), (k, z3) in itertools.product(list(enumerate(offsets)), repeat=3):
        moved = {"a": params["a"] + sigma["a"] * z1, "b": params["b"] + sigma["b"] * np.array([z2, z3])}
        value = density[i] * density[j] * density[k] * loss_of(renderer.render(moved))
        gradient["a"] += value * z1 / sigma["a"]
        gradient["b"] += value * np.array([z2, z3]) / sigma["b"]
    return gradient


@pytest.mark.parametrize("together", [True, pytest.param(False, marks=thorough)])
def test_where_losses_are_compared_the_gradient_is_that_of_the_blurred_loss(together: bool) -> None:
    renderer = Steps()
    params = renderer.parameters()
    wanted = blurred_loss(Steps(), params, SIGMA)
    blurred = BlurredRenderer(renderer, SIGMA, together=together, compare="losses")
    drawn = [blurred.render_loss_vjp(params, seed=seed)[1](loss_of, COTANGENT) for seed in range(3000)]
    for name, value in wanted.items():
        own = np.array([one[name] for one in drawn])
        error = own.std(axis=0, ddof=1) / np.sqrt(len(own))
        assert np.all(np.abs(own.mean(axis=0) - value) < 4.0 * error + 0.01 * np.abs(value)), name


def test_both_is_the_mean_of_images_and_losses_and_a_cotangent_alone_is_of_images() -> None:
    renderer = Steps()
    params = renderer.parameters()
    found = {}
    for compare in ("images", "losses", "both"):
        blurred = BlurredRenderer(renderer, SIGMA, compare=compare)
        found[compare] = blurred.render_loss_vjp(params, seed=5)[1](loss_of, COTANGENT)
        found[f"{compare}, linear"] = blurred.render_vjp(params, seed=5)[1](COTANGENT)
    for name in params:
        np.testing.assert_allclose(found["both"][name], 0.5 * (found["images"][name] + found["losses"][name]))
        for compare in ("images", "losses", "both"):
            np.testing.assert_array_equal(found[f"{compare}, linear"][name], found["images"][name])
    assert np.any(found["losses"]["b"] != found["images"]["b"])


def test_a_fit_compares_losses_where_it_is_asked_to() -> None:
    asked = []

    class Watched(PixelL2):
        def value(self, image: Any) -> Any:
            asked.append(image)
            return super().value(image)

    disks = Disks(16, 16, positions=[[4.0, 4.0]], radii=2.0, colours=[[1.0, 1.0, 1.0]])
    objective = Watched(disks.render({**disks.parameters(), "positions": np.array([[9.0, 9.0]])}))
    for compare in ("images", "losses"):
        asked.clear()
        fit(BlurredRenderer(disks, 2.0, names=["positions"], pairs=2, compare=compare), objective, steps=15)
        assert (len(asked) >= 4 * 15) == (compare == "losses")  # four images in each step


@pytest.mark.parametrize("pairs", [2, 3, 5])
def test_pairs_are_at_right_angles_and_each_is_from_a_gaussian(pairs: int) -> None:
    """Of a linear image, as many pairs as numbers leave no other noise than that of their lengths."""

    class Linear:
        def parameters(self) -> dict[str, Any]:
            return {"a": np.zeros(2), "b": np.zeros(())}

        def render(self, params: dict[str, Any], *, seed: int = 0) -> Any:
            seen.append(np.array([*params["a"], params["b"]]))
            return np.zeros((1, 1, 3)) + params["a"][0]

        def render_vjp(self, params: dict[str, Any], *, seed: int = 0) -> Any:
            return self.render(params), lambda _: params

    seen: list[Any] = []
    blurred = BlurredRenderer(Linear(), 1.0, pairs=pairs)
    drawn = []
    for seed in range(400):
        seen.clear()
        blurred.vjp(blurred.parameters(), np.ones((1, 1, 3)), seed=seed)
        offsets = np.array(seen[::2])
        drawn.append(offsets)
        together = offsets[: min(pairs, 3)]
        angles = together @ together.T
        np.testing.assert_allclose(angles - np.diag(np.diag(angles)), 0.0, atol=1e-9)
    every = np.concatenate(drawn)
    np.testing.assert_allclose(every.mean(axis=0), 0.0, atol=4.0 / np.sqrt(len(every)))
    np.testing.assert_allclose(np.cov(every.T), np.eye(3), atol=4.0 * np.sqrt(2.0 / len(every)))


@pytest.mark.parametrize(("names", "best"), [(["a"], False), (["a", "b"], True)])
def test_the_default_is_the_less_noisy_way_for_the_same_images(names: list[str], best: bool) -> None:
    renderer = Steps()
    params = renderer.parameters()
    noise = {}
    for together in (False, True):
        count = 3 if together and len(names) > 1 else 1  # as many images as three numbers one by one take
        blurred = BlurredRenderer(renderer, 0.5, names=names, together=together, pairs=count)
        drawn = [float(blurred.render_vjp(params, seed=seed)[1](COTANGENT)["a"]) for seed in range(1000)]
        noise[together] = np.std(drawn)
    assert noise[best] < noise[not best]
    assert BlurredRenderer(renderer, 0.5, names=names)._together == best


def test_the_image_is_sharp_and_a_pair_shares_its_seed() -> None:
    renderer = Steps()
    params = renderer.parameters()
    blurred = BlurredRenderer(renderer, 0.5, pairs=2, together=False)
    image, pullback = blurred.render_vjp(params, seed=5)
    np.testing.assert_array_equal(image, renderer.render(params))
    del renderer.seeds[:]
    first = pullback(COTANGENT)
    assert len(renderer.seeds) == 2 * 2 * 3  # two pairs for each of three numbers
    assert renderer.seeds[::2] == renderer.seeds[1::2]
    assert len(set(renderer.seeds)) == 6
    again = blurred.render_vjp(params, seed=5)[1](2.0 * COTANGENT)
    for name, value in first.items():
        np.testing.assert_allclose(again[name], 2.0 * value)  # the same draws, and linear


def test_what_is_not_blurred_has_the_gradient_of_the_renderer() -> None:
    blurred = BlurredRenderer(Steps(), 0.5, names=["b"])
    pulled = blurred.render_vjp(blurred.parameters())[1](COTANGENT)
    assert pulled["a"] == 7.0
    assert np.any(pulled["b"])


def test_sigma_is_held_and_then_falls_to_its_last_value() -> None:
    blurred = BlurredRenderer(Steps(), 0.5, final_sigma=0.1)
    assert blurred.sigma["a"] == 0.5
    seen = []
    for step in range(100):
        blurred.at_step(step, 100, None)
        seen.append(blurred.sigma["a"])
    assert seen[:50] == [0.5] * 50
    assert np.all(np.diff(seen[50:]) < 0.0)
    assert blurred.sigma["b"] == pytest.approx(0.1)


def test_a_fit_finds_what_has_no_gradient_of_its_own() -> None:
    """Hard pixels: a square that is drawn at whole pixels, with pixel loss and with ours."""

    class Square:
        def parameters(self) -> dict[str, Any]:
            return {"place": np.array([9.0, 8.0])}

        def render(self, params: dict[str, Any], *, seed: int = 0) -> Any:
            x, y = np.meshgrid(np.arange(32), np.arange(32))
            a, b = np.round(params["place"])
            return np.repeat(((np.abs(x - a) <= 3) & (np.abs(y - b) <= 3)).astype(float)[..., None], 3, axis=2)

        def render_vjp(self, params: dict[str, Any], *, seed: int = 0) -> Any:
            return self.render(params), lambda _: {"place": np.zeros(2)}

    truth = {"place": np.array([20.0, 21.0])}
    square = Square()
    target = square.render(truth)
    for objective in (LOIObjective(target), PixelL2(target)):
        blurred = BlurredRenderer(square, 6.0, final_sigma=0.7, pairs=2)
        found = fit(blurred, objective, steps=150, learning_rate=0.6)
        np.testing.assert_allclose(found.params["place"], truth["place"], atol=1.0)


@pytest.mark.parametrize(
    ("start", "pairs", "seeds"), [([0.3], 20, 50), pytest.param([0.3, 0.6], 100, 200, marks=thorough)]
)
def test_it_keeps_the_contract(start: list[float], pairs: int, seeds: int) -> None:
    """Of an image that is linear in its parameters, the blurred image is the sharp one."""

    class Linear:
        def parameters(self) -> dict[str, Any]:
            return {"a": np.array(start)}

        def render(self, params: dict[str, Any], *, seed: int = 0) -> Any:
            basis = np.linspace(0.1, 1.0, 8 * 8 * 3 * len(start)).reshape(8, 8, 3, len(start))
            return basis @ params["a"]

        def render_vjp(self, params: dict[str, Any], *, seed: int = 0) -> Any:  # not asked for
            raise AssertionError

    check_renderer(BlurredRenderer(Linear(), 0.1, pairs=pairs), seeds=seeds)


@pytest.mark.parametrize(
    ("options", "error", "says"),
    [
        ({"sigma": 0.0}, OptionError, r"`sigma` of 'positions' must be a finite number, more than 0, or .*, got 0\.0"),
        (
            {"sigma": {"positions": 1.0}},
            OptionError,
            "`sigma` must have 'positions', 'radii', 'colours', got",
        ),
        ({"sigma": 1.0, "pairs": 0}, OptionError, "`pairs` must be a whole number, 1 or more, got 0"),
        ({"sigma": 1.0, "final_sigma": -0.1}, OptionError, "`final_sigma` of 'positions' must be a finite number"),
        (
            {"sigma": 1.0, "names": ["speed"]},
            ParameterError,
            "`names` must be of positions, radii, colours, got 'speed'",
        ),
        ({"names": []}, ParameterError, "`names` must be of positions, radii, colours, got none"),
        ({"names": "radii"}, OptionError, "`names` must be a list of names of parameters, got 'radii'"),
        ({"sigma": "4 miles"}, OptionError, r"more than 0, or pixels as in '2 px', got '4 miles'"),
        ({"together": 1}, OptionError, "`together` must be true or false, got 1"),
        ({"compare": "image"}, OptionError, r"`compare` must be 'images', 'losses' or 'both', got 'image'"),
    ],
)
def test_options_are_checked(options: dict[str, Any], error: type[Exception], says: str) -> None:
    disks = Disks(16, 16, [[8.0, 8.0]], 4.0, [[1.0, 1.0, 1.0]])
    with pytest.raises(error, match=says):
        BlurredRenderer(disks, **options)


def test_what_the_renderer_says_of_itself_is_passed_on() -> None:
    @dataclass
    class Capable(Steps):
        told: list[Any] = field(default_factory=list)

        @property
        def capabilities(self) -> RendererCapabilities:
            return RendererCapabilities(encoding="sRGB", unabridged=Steps, at_step=self.at_step)

        def at_step(self, step: int, steps: int, value: float | None) -> None:
            self.told.append((step, steps, value))

    blurred = BlurredRenderer(Capable(), 0.5)
    capabilities = capabilities_of(blurred)
    assert capabilities.encoding == "sRGB"
    assert capabilities.unabridged is Steps
    blurred.at_step(3, 9, 0.5)
    assert blurred.renderer.told == [(3, 9, 0.5)]  # type: ignore[attr-defined]
    assert capabilities_of(BlurredRenderer(Steps(), 0.5)).encoding is None


def test_blurred_parameters_stay_legal() -> None:
    disks = Disks(16, 16, [[8.0, 8.0]], 0.5, [[1.0, 1.0, 1.0]], confine=True)
    start = {"positions": Free(), "radii": Free()}
    blurred = BlurredRenderer(disks, 4.0, names=list(start))
    image, pullback = blurred.render_vjp(blurred.parameters())
    assert all(np.all(np.isfinite(one)) for one in pullback(image).values())


def test_a_width_in_pixels_is_measured_in_each_parameters_own_unit() -> None:
    disks = Disks(64, 64, [[30.0, 30.0]], 12.0, [[1.0, 1.0, 1.0]])
    blurred = BlurredRenderer(disks, {"positions": "3 px", "radii": 0.5}, names=["positions", "radii"])
    assert blurred.sigma["positions"] == pytest.approx(3.0, rel=0.3)
    assert blurred.sigma["radii"] == 0.5
    blurred.at_step(9, 10, None)
    assert blurred.sigma["radii"] == 0.25  # half


def test_what_leaves_no_trace_has_no_pixels() -> None:
    away = Disks(16, 16, [[900.0, 900.0]], 1.0, [[1.0, 1.0, 1.0]])
    blurred = BlurredRenderer(away, names=["colours"])
    with pytest.raises(OptionError, match="`sigma` of 'colours' is in pixels, but the image does not change"):
        blurred.render_vjp(blurred.parameters())
