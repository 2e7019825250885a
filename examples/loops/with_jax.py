"""The loop of the README on JAX, as a whole program: ``python -m examples.loops.with_jax``."""

import jax
import jax.numpy as jnp

import loi_jax

height, width = 64, 96
x, y = jnp.arange(width) + 0.5, jnp.arange(height)[:, None] + 0.5


def render(centre: jax.Array) -> jax.Array:
    """A soft disk of radius 8 on black, (height, width, 3)."""
    inside = jax.nn.sigmoid((64 - (x - centre[0]) ** 2 - (y - centre[1]) ** 2) / 8)
    return inside[..., None] * jnp.array([1.0, 0.6, 0.1])


photograph = render(jnp.array([75.0, 45.0]))
centre = jnp.array([15.0, 15.0])

gradient = jax.jit(jax.grad(lambda centre: loi_jax.loi_loss(render(centre), photograph)))
for step in range(200):
    slope = gradient(centre)
    rate = 1.0 - step / 200  # pixels a step, along the gradient: its length says little far from the target
    centre = centre - rate * slope / jnp.maximum(jnp.linalg.norm(slope), 1e-12)

print(*(round(coordinate, 1) for coordinate in centre.tolist()))
