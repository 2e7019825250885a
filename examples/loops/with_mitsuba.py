"""The loop of the README on Mitsuba, as a whole program: ``python -m examples.loops.with_mitsuba``."""

import loi_mitsuba  # before drjit and mitsuba

# isort: split
import drjit as dr
import mitsuba as mi

from loi_core import ScaleSpace

mi.set_variant("llvm_ad_rgb")
height, width = 36, 48
view = mi.ScalarTransform4f().look_at([0, 0, 8], [0, 0, 0], [0, 1, 0])
film = {"type": "hdrfilm", "width": width, "height": height, "sample_border": True}
scene = mi.load_dict(
    {
        "type": "scene",
        # Follows outlines, which `path` and `prb` do not; no samples for the outlines of shadows, as there are none.
        "integrator": {"type": "direct_boundaries", "sppi": 0},
        "camera": {"type": "perspective", "fov": 40, "to_world": view, "film": film},
        "light": {"type": "constant"},
        "ball": {"type": "sphere", "radius": 0.5, "bsdf": {"type": "diffuse"}},
    }
)
params = mi.traverse(scene)
shape = mi.Transform4f(params["ball.to_world"])


def move(position: mi.Point3f) -> None:
    """Put the ball there."""
    params["ball.to_world"] = mi.Transform4f().translate(position) @ shape
    params.update()


move(mi.Point3f(1.5, -1.0, 0.0))
photograph = mi.render(scene, spp=64)
optimizer = mi.ad.Adam(lr=0.05)
optimizer["place"] = mi.Point3f(-1.5, 1.0, 0.0)

scales = ScaleSpace.for_image(height, width, beta=0.25)
for step in range(300):  # arrives after 80 to 150 steps, depending on the noise, overshoots, and settles
    move(optimizer["place"])
    dr.backward(loi_mitsuba.loi_loss(mi.render(scene, params, seed=step, spp=32), photograph, scales))
    optimizer.step()

print(*(round(float(coordinate[0]), 1) for coordinate in list(optimizer["place"])[:2]))
