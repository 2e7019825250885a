"""Contributions of the terms of a gradient, relative to the whole gradient, from independent draws of each."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import TypeAlias

from loi_core.effects.statistics import SIGNIFICANT_ERRORS, Draws

__all__ = ["GradientNorms", "fraction_bound", "largest_fraction", "relative_variance", "significant_norms"]

GradientNorms: TypeAlias = Mapping[str, tuple[float, float]]
"""Norm of the gradient of each parameter and its standard error; the norm is 0 if it is not significant."""


def significant_norms(gradient: Draws, significant: Collection[str]) -> GradientNorms:
    """Return the norms of a gradient for :func:`fraction_bound`; 0 for parameters that are not `significant`."""
    return {
        name: (gradient.debiased_norm(name) if name in significant else 0.0, gradient.standard_error(name))
        for name in gradient.gradients
    }


def fraction_bound(term: Draws, norms: GradientNorms, n_errors: float = SIGNIFICANT_ERRORS) -> float:
    """Return an upper bound of a term's fraction of the whole gradient, the maximum over parameters.

    The bound is the estimated fraction plus `n_errors` standard errors, which come from the term and from the whole. If
    the whole is lost in noise, the bound is infinite, unless the term is exactly 0 in every draw.
    """
    bounds = [0.0]
    for name, (norm, error) in norms.items():
        if term.is_zero(name):
            continue
        if norm == 0.0:
            return math.inf
        fraction = term.debiased_norm(name) / norm
        bounds.append(fraction + n_errors * math.hypot(term.standard_error(name), fraction * error) / norm)
    return max(bounds)


def largest_fraction(term: Draws, whole: Draws, significant: Collection[str]) -> float | None:
    """Return the largest fraction among the `significant` parameters; None if there are none."""
    return max((term.norm(name) / whole.norm(name) for name in significant), default=None)


def relative_variance(term: Draws, whole: Draws, significant: Collection[str]) -> float:
    """Return the variance of a draw of a term, each `significant` parameter relative to the squared gradient norm."""
    return sum(term.variance(name) / whole.norm(name) ** 2 for name in significant)
