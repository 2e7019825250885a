"""Blurring in parameter space gives the gradient of the blurred image, whatever the renderer."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
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
    """Step functions of a sum of parameters: the gradient of the image is 0 almost everywhere."""

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
    """Return the gradient of the blurred image times the cotangent by quadrature over all three scalars."""
    offsets = np.linspace(-5.0, 5.0, 161)
    density = np.exp(-0.5 * offsets**2)
    density /= density.sum()
    gradient = {"a": np.zeros(()), "b": np.zeros(2)}
    for z1, p1 in zip(offsets, density, strict=True):
        # The image is a function of a sum, so one grid covers two of the three offsets.
        inner = np.sin(params["b"][0] + sigma["b"] * offsets)[:, None] + np.sin(params["b"][1] + sigma["b"] * offsets)
        total = params["a"] + sigma["a"] * z1 + inner
        value = np.zeros(total.shape)
        for edge, weight in zip(renderer.edges.ravel(), COTANGENT.ravel(), strict=True):
            value += weight * (edge < total)
        weighted = p1 * value * density[:, None] * density
        gradient["a"] += z1 * weighted.sum() / sigma["a"]
        gradient["b"][0] += (weighted * offsets[:, None]).sum() / sigma["b"]
        gradient["b"][1] += (weighted * offsets).sum() / sigma["b"]
    return gradient


@pytest.mark.parametrize("together", [False, True])
def test_the_gradient_is_the_gradient_of_the_blurred_image(together: bool) -> None:
    renderer = Steps()
    params = renderer.parameters()
    blurred = BlurredRenderer(renderer, SIGMA, together=together)
    draws = [blurred.render_vjp(params, seed=seed)[1](COTANGENT) for seed in range(4000)]
    expected = quadrature(renderer, params, SIGMA)
    for name, value in expected.items():
        gradients = np.array([draw[name] for draw in draws])
        error = gradients.std(axis=0, ddof=1) / np.sqrt(len(gradients))
        assert np.all(np.abs(gradients.mean(axis=0) - value) < 4.0 * error), name
        assert np.all(error < 0.1 * np.abs(expected["a"]))


def loss_of(image: Any) -> float:
    """Return a loss that is far from linear in the image."""
    return float(np.sum(COTANGENT * image) ** 2 + np.sum(image) ** 1.5)


def blurred_loss(renderer: Any, params: dict[str, Any], sigma: dict[str, float]) -> dict[str, Any]:
    """Return the gradient of the blurred loss by quadrature over all three scalars."""
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
def test_compared_losses_give_the_gradient_of_the_blurred_loss(together: bool) -> None:
    renderer = Steps()
    params = renderer.parameters()
    expected = blurred_loss(Steps(), params, SIGMA)
    blurred = BlurredRenderer(renderer, SIGMA, together=together, compare="losses")
    draws = [blurred.render_loss_vjp(params, seed=seed)[1](loss_of, COTANGENT) for seed in range(3000)]
    for name, value in expected.items():
        gradients = np.array([draw[name] for draw in draws])
        error = gradients.std(axis=0, ddof=1) / np.sqrt(len(gradients))
        assert np.all(np.abs(gradients.mean(axis=0) - value) < 4.0 * error + 0.01 * np.abs(value)), name


def test_both_is_the_mean_of_images_and_losses_and_a_cotangent_uses_images() -> None:
    renderer = Steps()
    params = renderer.parameters()
    gradients = {}
    for compare in ("images", "losses", "both"):
        blurred = BlurredRenderer(renderer, SIGMA, compare=compare)
        gradients[compare] = blurred.render_loss_vjp(params, seed=5)[1](loss_of, COTANGENT)
        gradients[f"{compare}, linear"] = blurred.render_vjp(params, seed=5)[1](COTANGENT)
    for name in params:
        np.testing.assert_allclose(
            gradients["both"][name], 0.5 * (gradients["images"][name] + gradients["losses"][name])
        )
        for compare in ("images", "losses", "both"):
            np.testing.assert_array_equal(gradients[f"{compare}, linear"][name], gradients["images"][name])
    assert np.any(gradients["losses"]["b"] != gradients["images"]["b"])


def test_a_fit_compares_losses_if_the_option_says_so() -> None:
    evaluated = []

    class Watched(PixelL2):
        def value(self, image: Any, *, weights: Any = None) -> Any:
            evaluated.append(image)
            return super().value(image, weights=weights)

    disks = Disks(16, 16, positions=[[4.0, 4.0]], radii=2.0, colours=[[1.0, 1.0, 1.0]])
    objective = Watched(disks.render({**disks.parameters(), "positions": np.array([[9.0, 9.0]])}))
    for compare in ("images", "losses"):
        evaluated.clear()
        fit(BlurredRenderer(disks, 2.0, names=["positions"], pairs=2, compare=compare), objective, steps=15)
        assert (len(evaluated) >= 4 * 15) == (compare == "losses")  # four images per step


@pytest.mark.parametrize("pairs", [2, 3, 5])
def test_pairs_are_orthogonal_and_each_is_gaussian(pairs: int) -> None:
    """For a linear image, as many pairs as scalars leave only the noise of their lengths."""

    class Linear:
        def parameters(self) -> dict[str, Any]:
            return {"a": np.zeros(2), "b": np.zeros(())}

        def render(self, params: dict[str, Any], *, seed: int = 0) -> Any:
            rendered.append(np.array([*params["a"], params["b"]]))
            return np.zeros((1, 1, 3)) + params["a"][0]

        def render_vjp(self, params: dict[str, Any], *, seed: int = 0) -> Any:
            return self.render(params), lambda _: params

    rendered: list[Any] = []
    blurred = BlurredRenderer(Linear(), 1.0, pairs=pairs)
    draws = []
    for seed in range(400):
        rendered.clear()
        blurred.vjp(blurred.parameters(), np.ones((1, 1, 3)), seed=seed)
        offsets = np.array(rendered[::2])
        draws.append(offsets)
        together = offsets[: min(pairs, 3)]
        angles = together @ together.T
        np.testing.assert_allclose(angles - np.diag(np.diag(angles)), 0.0, atol=1e-9)
    samples = np.concatenate(draws)
    np.testing.assert_allclose(samples.mean(axis=0), 0.0, atol=4.0 / np.sqrt(len(samples)))
    np.testing.assert_allclose(np.cov(samples.T), np.eye(3), atol=4.0 * np.sqrt(2.0 / len(samples)))


@pytest.mark.parametrize(("names", "best"), [(["a"], False), (["a", "b"], True)])
def test_the_default_has_less_noise_for_the_same_number_of_images(names: list[str], best: bool) -> None:
    renderer = Steps()
    params = renderer.parameters()
    noise = {}
    for together in (False, True):
        count = 3 if together and len(names) > 1 else 1  # as many images as three scalars one by one
        blurred = BlurredRenderer(renderer, 0.5, names=names, together=together, pairs=count)
        draws = [float(blurred.render_vjp(params, seed=seed)[1](COTANGENT)["a"]) for seed in range(1000)]
        noise[together] = np.std(draws)
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
    assert len(renderer.seeds) == 2 * 2 * 3  # two pairs for each of three scalars
    assert renderer.seeds[::2] == renderer.seeds[1::2]
    assert len(set(renderer.seeds)) == 6
    doubled = blurred.render_vjp(params, seed=5)[1](2.0 * COTANGENT)
    for name, value in first.items():
        np.testing.assert_allclose(doubled[name], 2.0 * value)  # the same draws, and linear


def test_a_parameter_that_is_not_blurred_has_the_gradient_of_the_renderer() -> None:
    blurred = BlurredRenderer(Steps(), 0.5, names=["b"])
    gradient = blurred.render_vjp(blurred.parameters())[1](COTANGENT)
    assert gradient["a"] == 7.0
    assert np.any(gradient["b"])


def test_sigma_is_constant_for_half_a_fit_and_then_falls_to_its_final_value() -> None:
    blurred = BlurredRenderer(Steps(), 0.5, final_sigma=0.1)
    assert blurred.sigma["a"] == 0.5
    sigmas = []
    for step in range(100):
        blurred = blurred.revisit(step, 100)
        sigmas.append(blurred.sigma["a"])
    assert sigmas[:50] == [0.5] * 50
    assert np.all(np.diff(sigmas[50:]) < 0.0)
    assert blurred.sigma["b"] == pytest.approx(0.1)


def test_a_fit_converges_though_the_renderer_has_no_gradient() -> None:
    """A square at whole pixels, without anti-aliasing, with pixel loss and LOI."""

    class Square:
        def parameters(self) -> dict[str, Any]:
            return {"position": np.array([9.0, 8.0])}

        def render(self, params: dict[str, Any], *, seed: int = 0) -> Any:
            x, y = np.meshgrid(np.arange(32), np.arange(32))
            a, b = np.round(params["position"])
            return np.repeat(((np.abs(x - a) <= 3) & (np.abs(y - b) <= 3)).astype(float)[..., None], 3, axis=2)

        def render_vjp(self, params: dict[str, Any], *, seed: int = 0) -> Any:
            return self.render(params), lambda _: {"position": np.zeros(2)}

    truth = {"position": np.array([20.0, 21.0])}
    square = Square()
    target = square.render(truth)
    for objective in (LOIObjective(target), PixelL2(target)):
        blurred = BlurredRenderer(square, 6.0, final_sigma=0.7, pairs=2)
        result = fit(blurred, objective, steps=150, learning_rate=0.6)
        np.testing.assert_allclose(result.params["position"], truth["position"], atol=1.0)


@pytest.mark.parametrize(
    ("start", "pairs", "seeds"), [([0.3], 20, 50), pytest.param([0.3, 0.6], 100, 200, marks=thorough)]
)
def test_a_blurred_renderer_keeps_the_contract(start: list[float], pairs: int, seeds: int) -> None:
    """For an image that is linear in its parameters, the blurred image is the sharp image."""

    class Linear:
        def parameters(self) -> dict[str, Any]:
            return {"a": np.array(start)}

        def render(self, params: dict[str, Any], *, seed: int = 0) -> Any:
            basis = np.linspace(0.1, 1.0, 8 * 8 * 3 * len(start)).reshape(8, 8, 3, len(start))
            return basis @ params["a"]

        def render_vjp(self, params: dict[str, Any], *, seed: int = 0) -> Any:  # never called
            raise AssertionError

    check_renderer(BlurredRenderer(Linear(), 0.1, pairs=pairs), seeds=seeds)


@pytest.mark.parametrize(
    ("options", "error", "message"),
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
def test_options_of_a_blurred_renderer_are_checked(
    options: dict[str, Any], error: type[Exception], message: str
) -> None:
    disks = Disks(16, 16, [[8.0, 8.0]], 4.0, [[1.0, 1.0, 1.0]])
    with pytest.raises(error, match=message):
        BlurredRenderer(disks, **options)


def test_capabilities_of_the_renderer_are_forwarded() -> None:
    @dataclass
    class Capable(Steps):
        calls: list[Any] = field(default_factory=list)

        @property
        def capabilities(self) -> RendererCapabilities:
            return RendererCapabilities(encoding="sRGB", unabridged=Steps, start=self.start, revisit=self.revisit)

        def start(self, params: Any, cotangent: Any, *, optimise: Iterable[str], seed: int = 0) -> Capable:
            return replace(self, calls=[*self.calls, tuple(optimise)])

        def revisit(self, *arguments: Any, seed: int = 0) -> Capable:
            return replace(self, calls=[*self.calls, (*arguments, seed)])

    blurred = BlurredRenderer(Capable(), 0.5)
    capabilities = capabilities_of(blurred)
    assert capabilities.encoding == "sRGB"
    assert capabilities.unabridged is Steps
    params, cotangent = blurred.parameters(), np.ones((1, 1, 1))
    later: Any = blurred.start(params, cotangent, optimise=params).revisit(3, 9, 0.5, params, cotangent, seed=2)
    assert later.renderer.calls == [(3, 9, 0.5, params, cotangent, 2)]  # all parameters are blurred: it is not started
    partly: Any = BlurredRenderer(Capable(), 0.5, names=["a"]).start(params, cotangent, optimise=params)
    assert partly.renderer.calls == [("b",)]
    assert blurred.renderer.calls == []  # type: ignore[attr-defined]
    without = capabilities_of(BlurredRenderer(Steps(), 0.5))
    assert without.encoding is None
    assert without.start is None


def test_blurred_parameters_stay_legal() -> None:
    disks = Disks(16, 16, [[8.0, 8.0]], 0.5, [[1.0, 1.0, 1.0]], confine=True)
    start = {"positions": Free(), "radii": Free()}
    blurred = BlurredRenderer(disks, 4.0, names=list(start))
    image, pullback = blurred.render_vjp(blurred.parameters())
    assert all(np.all(np.isfinite(value)) for value in pullback(image).values())


def test_a_sigma_in_pixels_is_converted_to_the_unit_of_each_parameter() -> None:
    disks = Disks(64, 64, [[30.0, 30.0]], 12.0, [[1.0, 1.0, 1.0]])
    blurred = BlurredRenderer(disks, {"positions": "3 px", "radii": 0.5}, names=["positions", "radii"])
    assert blurred.sigma["positions"] == pytest.approx(3.0, rel=0.3)
    assert blurred.sigma["radii"] == 0.5
    assert blurred.revisit(9, 10).sigma["radii"] == 0.25  # half
    assert blurred.sigma["radii"] == 0.5


def test_a_parameter_that_does_not_change_the_image_has_no_unit() -> None:
    hidden = Disks(16, 16, [[900.0, 900.0]], 1.0, [[1.0, 1.0, 1.0]])
    blurred = BlurredRenderer(hidden, names=["colours"])
    with pytest.raises(OptionError, match="`sigma` of 'colours' is in pixels, but the image does not change"):
        blurred.render_vjp(blurred.parameters())
