"""A ball is found from four sides by four devices, one for each: ``python -m examples.loops.with_jax_sharding``."""

import jax
import jax.numpy as jnp
from jax.sharding import AxisType, NamedSharding, PartitionSpec

import loi_jax

# The processor as four devices; leave it out where there are four. Wait then for each step: its threads are few.
jax.config.update("jax_num_cpu_devices", 4)  # type: ignore[no-untyped-call]  # untyped in JAX
height, width, views = 64, 64, 4
mesh = jax.make_mesh((4,), ("views",), axis_types=(AxisType.Auto,))
spread = NamedSharding(mesh, PartitionSpec("views"))  # type: ignore[no-untyped-call]  # untyped in JAX
angles = jax.device_put(jnp.arange(views) * (jnp.pi / views), spread)
y, x = jnp.meshgrid(jnp.arange(height) + 0.5, jnp.arange(width) + 0.5, indexing="ij")


def render(centre: jax.Array, angle: jax.Array) -> jax.Array:
    """A soft ball of radius 8 on black from one of the sides, which go round it, (height, width, 3)."""
    sharding = width / 2 + centre[0] * jnp.cos(angle) + centre[2] * jnp.sin(angle)
    inside = jax.nn.sigmoid((64 - (x - sharding) ** 2 - (y - centre[1]) ** 2) / 8)
    return inside[..., None] * jnp.array([1.0, 0.6, 0.1])


render_all = jax.jit(jax.vmap(render, in_axes=(None, 0)))
photographs = render_all(jnp.array([15.0, 45.0, -10.0]), angles)
centre = jnp.array([-15.0, 15.0, 10.0])

gradient = jax.jit(jax.grad(lambda centre, angles, views: loi_jax.loi_loss(render_all(centre, angles), views)))
for step in range(200):
    slope = gradient(centre, angles, photographs).block_until_ready()
    rate = 1.0 - step / 200  # pixels a step, along the gradient: its length says little far from the target
    centre = centre - rate * slope / jnp.maximum(jnp.linalg.norm(slope), 1e-12)

print(*(round(coordinate, 1) for coordinate in centre.tolist()))
