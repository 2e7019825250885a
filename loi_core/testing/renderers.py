"""Checks of the renderer contract, :class:`loi_core.Renderer`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Final, TypeAlias

import numpy as np

from loi_core.errors import ImageTypeError, OptionError
from loi_core.renderers.contract import Parameters, Pullback, Renderer
from loi_core.support.arrays import (
    Array,
    Host,
    arrays_equal,
    as_floating,
    epsilon,
    from_numpy,
    library_name,
    namespace,
    to_numpy,
)
from loi_core.support.keywords import suggest_keywords
from loi_core.testing.checks import Check, Slopes, measure_slopes, run_checks, slope_tolerance

__all__ = ["RENDERER_CHECKS", "RendererSubject", "check_renderer"]


MAX_ATTEMPTS: Final = 4  # to find parameters where slopes can be measured
RETRY_FRACTION: Final = 0.01  # change of the parameters between attempts
PATH_POINTS: Final = 16  # parameters along a path where the gradient is evaluated
RANDOM_SUMS: Final = 8  # random weighted sums of the pixels
MAX_UNEXPLAINED: Final = 0.3  # fraction of an image's change along a path that the gradient may leave unexplained


@suggest_keywords
@dataclass(frozen=True)
class RendererSubject:
    """A renderer under test.

    Attributes
    ----------
    renderer : Renderer
    seed : int
        Seed of the renders and of the random cotangents and directions.
    rtol : float, optional
        Largest relative error of the pullback's slopes against central differences; by default 5e-4 in float64 and
        5e-3 in float32.
    seeds : int
        Number of seeds to average slopes over; more than 1 for renderers with noise, whose differences and pullbacks
        agree only in the mean.
    """

    renderer: Renderer
    seed: int = 0
    rtol: float | None = None
    seeds: int = 1


_Check: TypeAlias = Check[RendererSubject]


@suggest_keywords
def check_renderer(
    renderer: Renderer,
    *,
    seed: int = 0,
    rtol: float | None = None,
    seeds: int = 1,
    expected_failures: Mapping[str, str] | None = None,
) -> None:
    """Check that a renderer keeps the contract, at its own parameters.

    Parameters
    ----------
    renderer : Renderer
        Small images make the checks fast; parameters should have an effect on the image.
    seed, rtol, seeds
        As in :class:`RendererSubject`. The check allows for the noise that remains in the mean over seeds; if that
        could hide an error of 5 %, the check fails with this finding.
    expected_failures : dict of str, optional
        Names of checks that are known to fail, with the reason. One that passes is an error too.

    Raises
    ------
    ConformanceError
        At the first check that fails: its name, the expected and the actual behaviour, and the rule.
    """
    if seeds < 1:
        msg = f"`seeds` must be 1 or more, got {seeds!r}"
        raise OptionError(msg)
    run_checks(RENDERER_CHECKS, RendererSubject(renderer, seed, rtol, seeds), expected_failures)


def _check_parameters(check: _Check, subject: RendererSubject) -> None:
    params = subject.renderer.parameters()
    if not isinstance(params, dict) or not params:
        check.fail(f"expected a dict of at least one parameter, got {params!r:.60}")
    for name, value in params.items():
        if not isinstance(name, str):
            check.fail(f"expected names that are strings, got {name!r}")
        try:
            as_floating(name, value)
        except ImageTypeError as error:
            check.fail(f"parameter {name!r}: {error}")
        if not np.all(np.isfinite(to_numpy(value))):
            check.fail(f"parameter {name!r} starts with values that are not finite")
    second_params = subject.renderer.parameters()
    if second_params is params or list(second_params) != list(params):
        check.fail("expected a new dict with the same names on each call")
    for name, value in params.items():
        first, second = to_numpy(value), to_numpy(second_params[name])
        if first.flags.writeable and np.shares_memory(first, second):
            check.fail(f"two calls returned the same array of {name!r}, so writes to one change the other")


def _check_image(check: _Check, subject: RendererSubject) -> None:
    params = subject.renderer.parameters()
    image = subject.renderer.render(params, seed=subject.seed)
    vjp_image, pullback = subject.renderer.render_vjp(params, seed=subject.seed)
    for method, rendered in (("render", image), ("render_vjp", vjp_image)):
        try:
            as_floating("image", rendered)
        except ImageTypeError as error:
            check.fail(f"{method} returned no image: {error}")
        if len(rendered.shape) != 3 or 0 in rendered.shape:
            check.fail(f"expected an image of shape (H, W, C) from {method}, got {tuple(rendered.shape)}")
        if not np.all(np.isfinite(to_numpy(rendered))):
            check.fail(f"{method} returned {int((~np.isfinite(to_numpy(rendered))).sum())} values that are not finite")
    image_type, vjp_image_type = (f"{library_name(rendered)} {rendered.dtype}" for rendered in (image, vjp_image))
    if image_type != vjp_image_type:
        check.fail(f"render returned an image of {image_type}, render_vjp an image of {vjp_image_type}")
    if tuple(image.shape) != tuple(vjp_image.shape):
        check.fail(f"render returned shape {tuple(image.shape)}, render_vjp {tuple(vjp_image.shape)}")
    if not callable(pullback):
        check.fail(f"expected a pullback that can be called, got {type(pullback).__name__}")
    if subject.seeds == 1 and not np.allclose(to_numpy(image), to_numpy(vjp_image), rtol=1e-4, atol=1e-5):
        worst = float(np.abs(to_numpy(image) - to_numpy(vjp_image)).max())
        check.fail(f"render and render_vjp returned images that differ by up to {worst:.3g}")


def _check_determinism(check: _Check, subject: RendererSubject) -> None:
    renderer, params = subject.renderer, subject.renderer.parameters()
    first = to_numpy(renderer.render(params, seed=subject.seed)).copy()
    second = to_numpy(renderer.render(params, seed=subject.seed))
    if not arrays_equal(first, second):
        check.fail(f"two renders with seed {subject.seed} differ by up to {float(np.abs(first - second).max()):.3g}")


def _check_no_memory(check: _Check, subject: RendererSubject) -> None:
    renderer, params = subject.renderer, subject.renderer.parameters()
    moved = _moved(params, subject.seed)
    image = to_numpy(renderer.render(params, seed=subject.seed))
    first = image.copy()
    moved_image = to_numpy(renderer.render(moved, seed=subject.seed)).copy()
    if not arrays_equal(image, first):
        check.fail("rendering other parameters wrote to an image that had been returned")
    if arrays_equal(first, moved_image):
        check.fail("a small change of all parameters left the image the same to the bit")
    repeated = to_numpy(renderer.render(params, seed=subject.seed))
    if not arrays_equal(first, repeated):
        worst = float(np.abs(first - repeated).max())
        check.fail(f"after a render of other parameters, the image at the first ones is off by up to {worst:.3g}")


def _check_no_state(check: _Check, subject: RendererSubject) -> None:
    renderer, params = subject.renderer, subject.renderer.parameters()
    image = to_numpy(renderer.render(params, seed=subject.seed)).copy()
    _, vjp_image, pullback = _rendered(subject)
    cotangent = _cotangent(vjp_image, subject.seed)
    first = {name: to_numpy(value).copy() for name, value in pullback(cotangent).items()}
    _, _, pullback = _rendered(subject)
    second = pullback(cotangent)
    repeated = to_numpy(renderer.render(params, seed=subject.seed))
    if not arrays_equal(image, repeated):
        worst = float(np.abs(image - repeated).max())
        check.fail(f"after a pullback, the image at the same parameters is off by up to {worst:.3g}")
    _expect_same(check, second, first, "after a pullback, another one at the same parameters")


def _check_no_mutation(check: _Check, subject: RendererSubject) -> None:
    renderer, params = subject.renderer, subject.renderer.parameters()
    params_copy = {name: to_numpy(value).copy() for name, value in params.items()}
    renderer.render(params, seed=subject.seed)
    image, pullback = renderer.render_vjp(params, seed=subject.seed)
    image_copy = to_numpy(image).copy()
    cotangent = _cotangent(image, subject.seed)
    cotangent_copy = to_numpy(cotangent).copy()
    pullback(cotangent)
    if list(params) != list(params_copy):
        check.fail(f"the names in the dict of parameters became {', '.join(params)}")
    for name, value in params.items():
        if not arrays_equal(to_numpy(value), params_copy[name]):
            check.fail(f"parameter {name!r} was written to")
    if not arrays_equal(to_numpy(cotangent), cotangent_copy):
        check.fail("the pullback wrote to its cotangent")
    if not arrays_equal(to_numpy(image), image_copy):
        check.fail("the pullback wrote to the image")


def _check_gradient(check: _Check, subject: RendererSubject) -> None:
    params, image, pullback = _rendered(subject)
    gradient = pullback(_cotangent(image, subject.seed))
    if not isinstance(gradient, dict) or set(gradient) != set(params):
        got = ", ".join(map(str, gradient)) if isinstance(gradient, dict) else type(gradient).__name__
        check.fail(f"expected a cotangent for each of {', '.join(params)}, got {got or 'none'}")
    for name, value in params.items():
        slope = gradient[name]
        if tuple(slope.shape) != tuple(value.shape):
            check.fail(f"cotangent of {name!r} has shape {tuple(slope.shape)}, the parameter {tuple(value.shape)}")
        if slope.dtype != value.dtype:
            check.fail(f"cotangent of {name!r} has dtype {slope.dtype}, the parameter {value.dtype}")
        if library_name(slope) != library_name(value):
            check.fail(f"cotangent of {name!r} is of {library_name(slope)}, the parameter of {library_name(value)}")
        if not np.all(np.isfinite(to_numpy(slope))):
            check.fail(f"cotangent of {name!r} is not finite")


def _check_linearity(check: _Check, subject: RendererSubject) -> None:
    _, image, pullback = _rendered(subject)
    u, v = _cotangent(image, subject.seed), _cotangent(image, subject.seed + 1)
    first, second = pullback(u), pullback(v)
    combined = pullback(2.0 * u - 3.0 * v)
    repeated = pullback(u)
    tolerance = 1e3 * epsilon(image)
    for name in combined:
        a, b, c = to_numpy(first[name]), to_numpy(second[name]), to_numpy(combined[name])
        scale = float(np.linalg.norm(a) + np.linalg.norm(b))
        error = float(np.linalg.norm(c - (2.0 * a - 3.0 * b)))
        if error > tolerance * max(scale, 1e-30) * 5.0:
            check.fail(f"pullback(2 u - 3 v) of {name!r} is off by {error:.3g}, at a size of {scale:.3g}")
        if not np.allclose(to_numpy(repeated[name]), a, rtol=tolerance, atol=tolerance * scale):
            check.fail(f"the pullback of {name!r} returned another result when called again")


def _check_pullback_memory(check: _Check, subject: RendererSubject) -> None:
    params, image, pullback = _rendered(subject)
    cotangent = _cotangent(image, subject.seed)
    first = {name: to_numpy(value).copy() for name, value in pullback(cotangent).items()}
    argument = subject.renderer.parameters()
    _, pullback = subject.renderer.render_vjp(argument, seed=subject.seed)
    moved = _moved(params, subject.seed)
    _, moved_pullback = subject.renderer.render_vjp(moved, seed=subject.seed)
    moved_pullback(cotangent)
    _expect_same(check, pullback(cotangent), first, "after a render of other parameters, an earlier pullback")
    _, pullback = subject.renderer.render_vjp(argument, seed=subject.seed)
    for name, value in argument.items():
        host = to_numpy(value)
        if host.flags.writeable:
            host[...] = to_numpy(moved[name])
    argument.clear()
    _expect_same(check, pullback(cotangent), first, "after the caller wrote to its parameters, the pullback")


def _expect_same(check: _Check, gradient: Parameters, expected_gradient: Mapping[str, Host], pullback: str) -> None:
    for name, expected in expected_gradient.items():
        slope = to_numpy(gradient[name])
        tolerance = 1e3 * epsilon(gradient[name])
        if not np.allclose(slope, expected, rtol=tolerance, atol=tolerance * np.abs(expected).max(initial=0.0)):
            check.fail(f"{pullback} returned another cotangent of {name!r}")


def _check_differences(check: _Check, subject: RendererSubject) -> None:
    # Not at the renderer's own parameters, to detect a gradient that is always evaluated there.
    params = _moved(subject.renderer.parameters(), subject.seed)
    for name, value in params.items():
        image = subject.renderer.render(params, seed=subject.seed)
        eps = max(epsilon(value), epsilon(image))
        rtol = slope_tolerance(eps) if subject.rtol is None else subject.rtol
        slopes = _slopes(subject, name, params, eps)
        for attempt in range(MAX_ATTEMPTS):
            if slopes.roughness <= 0.5 * rtol:
                break
            # An edge may just touch a pixel at these parameters; at slightly different ones it does not.
            retry = _slopes(subject, name, _moved(params, subject.seed + attempt, RETRY_FRACTION), eps)
            slopes = min(slopes, retry, key=lambda candidate: candidate.roughness)
        finding = slopes.finding(rtol)
        if finding:
            check.fail(f"{name!r}: {finding}")


def _slopes(subject: RendererSubject, name: str, params: Parameters, eps: float) -> Slopes:
    """Return the slopes of a random weighted sum of the pixels with respect to one parameter, at `params`."""
    renderer, value = subject.renderer, params[name]
    seeds = range(subject.seed, subject.seed + subject.seeds)
    rendered = [renderer.render_vjp(params, seed=seed) for seed in seeds]
    cotangent = _cotangent(rendered[0][0], subject.seed + 7)
    weights = to_numpy(cotangent).astype(np.float64)

    def weighted(argument: Host, seed: int) -> float:
        image = renderer.render({**params, name: from_numpy(argument, value)}, seed=seed)
        return float(np.sum(weights * to_numpy(image).astype(np.float64)))

    return measure_slopes(
        [partial(weighted, seed=seed) for seed in seeds],
        to_numpy(value).astype(np.float64),
        [to_numpy(pullback(cotangent)[name]).astype(np.float64) for _, pullback in rendered],
        rounded=lambda argument: to_numpy(from_numpy(argument, value)).astype(np.float64),
        epsilon=eps,
        seed=subject.seed,
    )


def _check_edges(check: _Check, subject: RendererSubject) -> None:
    """Check that the gradient, integrated along a path where edges cross pixels, equals the image's change."""
    if subject.seeds > 1:
        return  # noise would be integrated too
    renderer, start = subject.renderer, subject.renderer.parameters()
    target = _moved(start, subject.seed)
    path = {name: to_numpy(target[name]).astype(np.float64) - to_numpy(value) for name, value in start.items()}
    first, last = (renderer.render(params, seed=subject.seed) for params in (start, target))
    change = to_numpy(last).astype(np.float64) - to_numpy(first)
    cotangents = [_cotangent(first, subject.seed + 11 + index) for index in range(RANDOM_SUMS)]
    measured = np.array([np.sum(to_numpy(cotangent) * change) for cotangent in cotangents])
    claimed = np.zeros(RANDOM_SUMS)
    for fraction in (np.arange(PATH_POINTS) + 0.5) / PATH_POINTS:
        params = {name: from_numpy(to_numpy(value) + fraction * path[name], value) for name, value in start.items()}
        _, pullback = renderer.render_vjp(params, seed=subject.seed)
        gradients = [pullback(cotangent) for cotangent in cotangents]
        claimed += [
            sum(float(np.sum(to_numpy(gradient[name]) * path[name])) for name in path) / PATH_POINTS
            for gradient in gradients
        ]
    # Another check detects a gradient that is too long or too short by a constant factor.
    fitted = claimed * float(claimed @ measured) / max(float(claimed @ claimed), 1e-300)
    error, size = float(np.linalg.norm(fitted - measured)), float(np.linalg.norm(measured))
    if error > MAX_UNEXPLAINED * size:
        check.fail(
            f"on a path of 5 % of the parameters the image changes by {size:.3g}, and the integral of its gradient is "
            f"off by {error:.3g}: edges that cross pixels may have no gradient"
        )


def _check_non_finite(check: _Check, subject: RendererSubject) -> None:
    params = subject.renderer.parameters()
    for name, value in params.items():
        bad = to_numpy(value).copy()
        bad.reshape(-1)[0] = np.nan
        try:
            image = subject.renderer.render({**params, name: from_numpy(bad, value)}, seed=subject.seed)
        except Exception:  # noqa: BLE001, S112 - the renderer may raise any error
            continue
        if np.all(np.isfinite(to_numpy(image))):
            check.fail(f"a NaN in {name!r} silently gave an image that is finite everywhere")


def _rendered(subject: RendererSubject) -> tuple[Parameters, Array, Pullback]:
    params = subject.renderer.parameters()
    image, pullback = subject.renderer.render_vjp(params, seed=subject.seed)
    return params, image, pullback


def _cotangent(image: Array, seed: int) -> Array:
    """Return a random cotangent, neither uniform nor of one sign, so that no symmetry hides an error."""
    return from_numpy(np.random.default_rng(seed).standard_normal(tuple(image.shape)), image)


def _moved(params: Parameters, seed: int, fraction: float = 0.05) -> Parameters:
    rng = np.random.default_rng(seed)
    moved = {}
    for name, value in params.items():
        size = fraction * max(1.0, float(np.abs(to_numpy(value)).max(initial=0.0)))
        shift = from_numpy(rng.uniform(0.5 * size, size, tuple(value.shape)), value)
        moved[name] = namespace(value).asarray(value + shift)
    return moved


RENDERER_CHECKS: Final[tuple[_Check, ...]] = (
    Check("parameters", "parameters() returns a new dict of finite floating-point arrays", _check_parameters),
    Check("image", "render and render_vjp return the same finite image (H, W, C)", _check_image),
    Check("determinism", "the same parameters and seed give the same image", _check_determinism),
    Check("no_memory", "an image depends on its parameters, not on earlier calls", _check_no_memory),
    Check("no_state", "a pullback changes neither later images nor later gradients", _check_no_state),
    Check("no_mutation", "arguments and results are never written to", _check_no_mutation),
    Check("gradient", "a pullback returns cotangents of the parameters' shapes, dtypes and library", _check_gradient),
    Check("linearity", "a pullback is linear and can be called again", _check_linearity),
    Check(
        "pullback_memory", "a pullback belongs to its own render, whatever is rendered later", _check_pullback_memory
    ),
    Check("finite_differences", "a pullback is the transpose of the image's derivative", _check_differences),
    Check("edges", "every change of the image has a gradient, also where edges cross pixels", _check_edges),
    Check(
        "non_finite", "a parameter that is not finite raises an error, or makes pixels non-finite", _check_non_finite
    ),
)
"""The checks of `check_renderer`, in order, each with a `name` and a `rule`."""
