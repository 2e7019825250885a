"""Gradient transformations of optax in a fit, for renderers of any library."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from loi_core.errors import OptionError
from loi_core.fitting.optimiser import Memory, require_shapes
from loi_core.renderers.contract import Parameters
from loi_core.support.arrays import Host, from_numpy, namespace, to_numpy
from loi_core.support.wording import described, shown

__all__ = ["OptaxOptimiser"]


class OptaxOptimiser:
    """A gradient transformation of optax, for :func:`loi_core.fit`.

    Parameters
    ----------
    transformation : optax.GradientTransformation
        Created with a learning rate of 1: the fit multiplies its updates by the rate of each parameter.

    Raises
    ------
    OptionError
        If it lacks ``init`` or ``update``.

    Examples
    --------
    >>> import optax
    >>> optimiser = OptaxOptimiser(optax.lion(1.0))
    >>> # fit(renderer, objective, optimiser=optimiser)
    """

    def __init__(self, transformation: Any) -> None:
        if not callable(getattr(transformation, "init", None)) or not callable(getattr(transformation, "update", None)):
            msg = f"`transformation` must be an optax transformation, e.g. optax.adam(1.0), got {shown(transformation)}"
            raise OptionError(msg)
        self._transformation = transformation
        self._update = jax.jit(transformation.update)

    def start(self, params: Parameters, previous: Memory | None = None) -> Memory:  # noqa: ARG002  # the state starts afresh
        """See :class:`loi_core.Optimiser`."""
        return _flat(self._transformation.init(_live(params)))

    def step(
        self, params: Parameters, gradient: Parameters, memory: Memory, rates: Mapping[str, float]
    ) -> tuple[Parameters, Memory]:
        """See :class:`loi_core.Optimiser`."""
        moving = _live({name: params[name] for name in rates})
        shapes = jax.eval_shape(self._transformation.init, moving)
        leaves = [_like(memory[str(index)], leaf) for index, leaf in enumerate(jax.tree.leaves(shapes))]
        state = jax.tree.unflatten(jax.tree.structure(shapes), leaves)
        slopes = {name: jnp.asarray(to_numpy(gradient[name]), dtype=moving[name].dtype) for name in rates}
        updates, state = self._update(slopes, state, moving)
        moved = dict(params)
        for name, rate in rates.items():
            value = params[name]
            update = rate * np.asarray(updates[name], dtype=np.float64)
            moved[name] = value + namespace(value).astype(from_numpy(update, value), value.dtype)
        return moved, _flat(state)

    def identity(self, params: Parameters) -> str:
        """See :class:`loi_core.Optimiser`. The traced computation identifies a transformation, which has no name.

        Raises
        ------
        OptionError
            If it needs more than these parameters and a gradient, such as a line search or the value.
        """
        live = _live(params)
        try:
            computed = str(jax.make_jaxpr(self._transformation.update)(live, self._transformation.init(live), live))
        except Exception as error:  # a transformation may raise anything when it lacks an argument
            msg = (
                f"`optimiser` must be a transformation of the gradient alone, without value or line search, for the "
                f"parameters {', '.join(params)}; optax says {described(error):.200}"
            )
            raise OptionError(msg) from error
        return f"optax {hashlib.sha256(re.sub('0x[0-9a-f]+', '', computed).encode()).hexdigest()[:16]}"

    def restore(self, params: Parameters, stored: Mapping[str, Host]) -> Memory:
        """See :class:`loi_core.Optimiser`."""
        fresh = self.start(params)
        require_shapes(stored, fresh)
        return {name: jnp.asarray(value, dtype=fresh[name].dtype) for name, value in stored.items()}


def _live(params: Parameters) -> dict[str, jax.Array]:
    """Return the parameters in float32 at least, because the epsilons of optimisers are 0 in 16 bits."""
    arrays = {name: jnp.asarray(to_numpy(value)) for name, value in params.items()}
    return {name: array.astype(jnp.float32) if array.dtype.itemsize < 4 else array for name, array in arrays.items()}


def _flat(state: Any) -> dict[str, jax.Array]:
    """Return the arrays of a state by index, as a checkpoint holds them; random keys as their data."""
    leaves = [jnp.asarray(leaf) for leaf in jax.tree.leaves(state)]
    return {str(index): jax.random.key_data(leaf) if _is_key(leaf) else leaf for index, leaf in enumerate(leaves)}


def _like(stored: Any, leaf: Any) -> Any:
    return jax.random.wrap_key_data(stored) if _is_key(leaf) else stored


def _is_key(leaf: Any) -> bool:
    return bool(jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key))
