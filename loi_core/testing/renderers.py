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
    as_floating,
    epsilon,
    from_numpy,
    library_name,
    namespace,
    same,
    to_numpy,
)
from loi_core.testing.checks import Check, Slopes, measure_slopes, run_checks, slope_tolerance

__all__ = ["RENDERER_CHECKS", "RendererSubject", "check_renderer"]


ATTEMPTS: Final = 4  # to find parameters where slopes can be measured
NEARBY: Final = 0.01
POINTS: Final = 16  # of a way through the parameters, at which its gradient is taken
SUMS: Final = 8  # random ones, of the pixels
UNACCOUNTED: Final = 0.3  # of how an image changes along such a way


@dataclass(frozen=True)
class RendererSubject:
    """A renderer under test.

    Attributes
    ----------
    renderer : Renderer
    seed : int
        For the renders and for the random cotangents and directions.
    rtol : float, optional
        Largest relative error of the slopes that the pullback gives against central differences; by default 5e-4 in
        float64 and 5e-3 in float32.
    seeds : int
        How many seeds slopes are averaged over; more than 1 for renderers with noise, whose differences and
        pullbacks agree only in the mean.
    """

    renderer: Renderer
    seed: int = 0
    rtol: float | None = None
    seeds: int = 1


_Check: TypeAlias = Check[RendererSubject]


def check_renderer(
    renderer: Renderer,
    *,
    seed: int = 0,
    rtol: float | None = None,
    seeds: int = 1,
    expected_failures: Mapping[str, str] | None = None,
) -> None:
    """Check that a renderer keeps the contract, at the parameters that it has.

    Parameters
    ----------
    renderer : Renderer
        Small images make the checks fast; parameters should have an effect on the image.
    seed : int
        For renders and random directions.
    rtol : float, optional
        Largest relative error of slopes against central differences; by default 5e-4 in float64, 5e-3 in float32.
    seeds : int
        Average slopes over this many seeds, for renderers with noise. What is left of it is allowed for; if it could
        hide an error of 5 %, the check fails and says so.
    expected_failures : dict of str, optional
        Names of checks that are known to fail, with the reason. One that passes is an error too.

    Raises
    ------
    ConformanceError
        At the first check that fails: its name, what was expected and what came, and the rule.
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
    again = subject.renderer.parameters()
    if again is params or list(again) != list(params):
        check.fail("expected a new dict with the same names on each call")
    for name, value in params.items():
        first, second = to_numpy(value), to_numpy(again[name])
        if first.flags.writeable and np.shares_memory(first, second):
            check.fail(f"two calls gave the same array of {name!r}, so that writing to one changes the other")


def _check_image(check: _Check, subject: RendererSubject) -> None:
    params = subject.renderer.parameters()
    image = subject.renderer.render(params, seed=subject.seed)
    other, pullback = subject.renderer.render_vjp(params, seed=subject.seed)
    for what, one in (("render", image), ("render_vjp", other)):
        try:
            as_floating("image", one)
        except ImageTypeError as error:
            check.fail(f"{what} gave no image: {error}")
        if len(one.shape) != 3 or 0 in one.shape:
            check.fail(f"expected an image of shape (H, W, C) from {what}, got {tuple(one.shape)}")
        if not np.all(np.isfinite(to_numpy(one))):
            check.fail(f"{what} gave {int((~np.isfinite(to_numpy(one))).sum())} values that are not finite")
    if library_name(image) != library_name(other) or image.dtype != other.dtype:
        given = [f"{library_name(one)} {one.dtype}" for one in (image, other)]
        check.fail(f"render gave an image of {given[0]}, render_vjp one of {given[1]}")
    if tuple(image.shape) != tuple(other.shape):
        check.fail(f"render gave shape {tuple(image.shape)}, render_vjp {tuple(other.shape)}")
    if not callable(pullback):
        check.fail(f"expected a pullback that can be called, got {type(pullback).__name__}")
    if subject.seeds == 1 and not np.allclose(to_numpy(image), to_numpy(other), rtol=1e-4, atol=1e-5):
        worst = float(np.abs(to_numpy(image) - to_numpy(other)).max())
        check.fail(f"render and render_vjp gave images that differ by up to {worst:.3g}")


def _check_determinism(check: _Check, subject: RendererSubject) -> None:
    renderer, params = subject.renderer, subject.renderer.parameters()
    first = to_numpy(renderer.render(params, seed=subject.seed)).copy()
    second = to_numpy(renderer.render(params, seed=subject.seed))
    if not same(first, second):
        check.fail(f"two renders with seed {subject.seed} differ by up to {float(np.abs(first - second).max()):.3g}")


def _check_no_memory(check: _Check, subject: RendererSubject) -> None:
    renderer, params = subject.renderer, subject.renderer.parameters()
    moved = _moved(params, subject.seed)
    image = to_numpy(renderer.render(params, seed=subject.seed))
    first = image.copy()
    elsewhere = to_numpy(renderer.render(moved, seed=subject.seed)).copy()
    if not same(image, first):
        check.fail("rendering other parameters wrote to an image that had been returned")
    if same(first, elsewhere):
        check.fail("changing all parameters by a little left the image the same to the bit")
    back = to_numpy(renderer.render(params, seed=subject.seed))
    if not same(first, back):
        worst = float(np.abs(first - back).max())
        check.fail(f"after rendering other parameters, the first ones gave an image off by up to {worst:.3g}")


def _check_no_mutation(check: _Check, subject: RendererSubject) -> None:
    renderer, params = subject.renderer, subject.renderer.parameters()
    kept = {name: to_numpy(value).copy() for name, value in params.items()}
    renderer.render(params, seed=subject.seed)
    image, pullback = renderer.render_vjp(params, seed=subject.seed)
    seen = to_numpy(image).copy()
    cotangent = _cotangent(image, subject.seed)
    given = to_numpy(cotangent).copy()
    pullback(cotangent)
    if list(params) != list(kept):
        check.fail(f"the dict of parameters came back with the names {', '.join(params)}")
    for name, value in params.items():
        if not same(to_numpy(value), kept[name]):
            check.fail(f"parameter {name!r} was written to")
    if not same(to_numpy(cotangent), given):
        check.fail("the pullback wrote to its cotangent")
    if not same(to_numpy(image), seen):
        check.fail("the pullback wrote to the image")


def _check_gradient(check: _Check, subject: RendererSubject) -> None:
    params, image, pullback = _rendered(subject)
    gradient = pullback(_cotangent(image, subject.seed))
    if not isinstance(gradient, dict) or set(gradient) != set(params):
        got = ", ".join(map(str, gradient)) if isinstance(gradient, dict) else type(gradient).__name__
        check.fail(f"expected a cotangent for each of {', '.join(params)}, got {got or 'none'}")
    for name, value in params.items():
        one = gradient[name]
        if tuple(one.shape) != tuple(value.shape):
            check.fail(f"cotangent of {name!r} has shape {tuple(one.shape)}, the parameter {tuple(value.shape)}")
        if one.dtype != value.dtype:
            check.fail(f"cotangent of {name!r} has dtype {one.dtype}, the parameter {value.dtype}")
        if library_name(one) != library_name(value):
            check.fail(f"cotangent of {name!r} is of {library_name(one)}, the parameter of {library_name(value)}")
        if not np.all(np.isfinite(to_numpy(one))):
            check.fail(f"cotangent of {name!r} is not finite")


def _check_linearity(check: _Check, subject: RendererSubject) -> None:
    _, image, pullback = _rendered(subject)
    one, other = _cotangent(image, subject.seed), _cotangent(image, subject.seed + 1)
    first, second = pullback(one), pullback(other)
    both = pullback(2.0 * one - 3.0 * other)
    again = pullback(one)
    tolerance = 1e3 * epsilon(image)
    for name in both:
        a, b, c = to_numpy(first[name]), to_numpy(second[name]), to_numpy(both[name])
        scale = float(np.linalg.norm(a) + np.linalg.norm(b))
        off = float(np.linalg.norm(c - (2.0 * a - 3.0 * b)))
        if off > tolerance * max(scale, 1e-30) * 5.0:
            check.fail(f"pullback(2 u - 3 v) of {name!r} is off by {off:.3g}, at a size of {scale:.3g}")
        if not np.allclose(to_numpy(again[name]), a, rtol=tolerance, atol=tolerance * scale):
            check.fail(f"the pullback of {name!r} gave something else when called again")


def _check_pullback_memory(check: _Check, subject: RendererSubject) -> None:
    params, image, pullback = _rendered(subject)
    cotangent = _cotangent(image, subject.seed)
    first = {name: to_numpy(value).copy() for name, value in pullback(cotangent).items()}
    given = subject.renderer.parameters()
    _, pullback = subject.renderer.render_vjp(given, seed=subject.seed)
    moved = _moved(params, subject.seed)
    _, other = subject.renderer.render_vjp(moved, seed=subject.seed)
    other(cotangent)
    _expect_same(check, pullback(cotangent), first, "after rendering other parameters, an earlier pullback")
    _, pullback = subject.renderer.render_vjp(given, seed=subject.seed)
    for name, value in given.items():
        host = to_numpy(value)
        if host.flags.writeable:
            host[...] = to_numpy(moved[name])
    given.clear()
    _expect_same(check, pullback(cotangent), first, "after the caller wrote to what it had given, the pullback")


def _expect_same(check: _Check, pulled: Parameters, before: Mapping[str, Host], which: str) -> None:
    for name, wanted in before.items():
        found = to_numpy(pulled[name])
        tolerance = 1e3 * epsilon(pulled[name])
        if not np.allclose(found, wanted, rtol=tolerance, atol=tolerance * np.abs(wanted).max(initial=0.0)):
            check.fail(f"{which} gave another cotangent of {name!r}")


def _check_differences(check: _Check, subject: RendererSubject) -> None:
    # Not at the renderer's own, so that a gradient which is always of these is found out.
    params = _moved(subject.renderer.parameters(), subject.seed)
    for name, value in params.items():
        image = subject.renderer.render(params, seed=subject.seed)
        coarsest = max(epsilon(value), epsilon(image))
        rtol = slope_tolerance(coarsest) if subject.rtol is None else subject.rtol
        slopes = _slopes(subject, name, params, coarsest)
        for attempt in range(ATTEMPTS):
            if slopes.roughness <= 0.5 * rtol:
                break
            # An edge may just touch a pixel here; a little aside it does not.
            other = _slopes(subject, name, _moved(params, subject.seed + attempt, NEARBY), coarsest)
            slopes = min(slopes, other, key=lambda each: each.roughness)
        finding = slopes.finding(rtol)
        if finding:
            check.fail(f"{name!r}: {finding}")


def _slopes(subject: RendererSubject, name: str, params: Parameters, coarsest: float) -> Slopes:
    """Slopes by one parameter of a random sum over the image, at `params`."""
    renderer, value = subject.renderer, params[name]
    seeds = range(subject.seed, subject.seed + subject.seeds)
    rendered = [renderer.render_vjp(params, seed=one) for one in seeds]
    cotangent = _cotangent(rendered[0][0], subject.seed + 7)
    weights = to_numpy(cotangent).astype(np.float64)

    def weighted(moved: Host, one: int) -> float:
        there = {**params, name: from_numpy(moved, value)}
        return float(np.sum(weights * to_numpy(renderer.render(there, seed=one)).astype(np.float64)))

    return measure_slopes(
        [partial(weighted, one=one) for one in seeds],
        to_numpy(value).astype(np.float64),
        [to_numpy(pullback(cotangent)[name]).astype(np.float64) for _, pullback in rendered],
        rounded=lambda moved: to_numpy(from_numpy(moved, value)).astype(np.float64),
        epsilon=coarsest,
        seed=subject.seed,
    )


def _check_edges(check: _Check, subject: RendererSubject) -> None:
    """Along a way on which edges pass over pixels, the gradient has to sum up to how the image changes."""
    if subject.seeds > 1:
        return  # noise would be summed up as well
    renderer, start = subject.renderer, subject.renderer.parameters()
    end = _moved(start, subject.seed)
    way = {name: to_numpy(end[name]).astype(np.float64) - to_numpy(value) for name, value in start.items()}
    first, last = (renderer.render(params, seed=subject.seed) for params in (start, end))
    change = to_numpy(last).astype(np.float64) - to_numpy(first)
    sums = [_cotangent(first, subject.seed + 11 + k) for k in range(SUMS)]
    measured = np.array([np.sum(to_numpy(one) * change) for one in sums])
    claimed = np.zeros(SUMS)
    for point in (np.arange(POINTS) + 0.5) / POINTS:
        there = {name: from_numpy(to_numpy(value) + point * way[name], value) for name, value in start.items()}
        _, pullback = renderer.render_vjp(there, seed=subject.seed)
        pulled = [pullback(one) for one in sums]
        claimed += [sum(float(np.sum(to_numpy(one[name]) * way[name])) for name in way) / POINTS for one in pulled]
    # A gradient that is too long or too short throughout is for another check to find.
    fitted = claimed * float(claimed @ measured) / max(float(claimed @ claimed), 1e-300)
    off, size = float(np.linalg.norm(fitted - measured)), float(np.linalg.norm(measured))
    if off > UNACCOUNTED * size:
        check.fail(
            f"on a way of 5 % of the parameters the image changes by {size:.3g}, and the sum of its gradient is off by "
            f"{off:.3g}: edges that pass over pixels may have none"
        )


def _check_non_finite(check: _Check, subject: RendererSubject) -> None:
    params = subject.renderer.parameters()
    for name, value in params.items():
        bad = to_numpy(value).copy()
        bad.reshape(-1)[0] = np.nan
        try:
            image = subject.renderer.render({**params, name: from_numpy(bad, value)}, seed=subject.seed)
        except Exception:  # noqa: BLE001, S112 - any refusal will do; its wording is the renderer's own
            continue
        if np.all(np.isfinite(to_numpy(image))):
            check.fail(f"a NaN in {name!r} gave an image that is finite everywhere, as if nothing were wrong")


def _rendered(subject: RendererSubject) -> tuple[Parameters, Array, Pullback]:
    params = subject.renderer.parameters()
    image, pullback = subject.renderer.render_vjp(params, seed=subject.seed)
    return params, image, pullback


def _cotangent(image: Array, seed: int) -> Array:
    """Neither uniform nor of one sign, so that no error hides in a symmetry."""
    return from_numpy(np.random.default_rng(seed).standard_normal(tuple(image.shape)), image)


def _moved(params: Parameters, seed: int, share: float = 0.05) -> Parameters:
    rng = np.random.default_rng(seed)
    moved = {}
    for name, value in params.items():
        size = share * max(1.0, float(np.abs(to_numpy(value)).max(initial=0.0)))
        shift = from_numpy(rng.uniform(0.5 * size, size, tuple(value.shape)), value)
        moved[name] = namespace(value).asarray(value + shift)
    return moved


RENDERER_CHECKS: Final[tuple[_Check, ...]] = (
    Check("parameters", "parameters() gives a new dict of finite floating-point arrays", _check_parameters),
    Check("image", "render and render_vjp give the same finite image (H, W, C)", _check_image),
    Check("determinism", "the same parameters and seed give the same image", _check_determinism),
    Check("no_memory", "an image depends on the parameters given, not on earlier calls", _check_no_memory),
    Check("no_mutation", "nothing that is given or returned is written to", _check_no_mutation),
    Check("gradient", "a pullback gives each parameter a cotangent of its shape, dtype and library", _check_gradient),
    Check("linearity", "a pullback is linear and can be called again", _check_linearity),
    Check(
        "pullback_memory", "a pullback belongs to its own render, whatever is rendered after", _check_pullback_memory
    ),
    Check("finite_differences", "a pullback is the transpose of the image's derivative", _check_differences),
    Check("edges", "what changes the image has a gradient, also where edges pass over pixels", _check_edges),
    Check("non_finite", "a parameter that is not finite is refused, or seen in the image", _check_non_finite),
)
"""What `check_renderer` checks, in its order: each has a `name` and the `rule` that it holds a renderer to."""
