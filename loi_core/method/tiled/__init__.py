"""The exact loss of planes that do not fit into memory, tile by tile.

A pixel moves the loss as far away as kernels reach, so tiles cannot be compared on their own. There are two cases:

* A narrow kernel (:mod:`loi_core.method.tiled.narrow`): a tile is compared together with a *halo* as wide as the
  kernel reaches. Each tile counts only what its own pixels cost; what that says of pixels in the halo is added there.
* A wide kernel (:mod:`loi_core.method.tiled.wide`): a Gaussian passes through a coarse sampling of the whole plane,
  which all tiles share, since that is small. Tiles are gathered there, compared from there, and pulled back from there.

Both are what :mod:`loi_core.method.planner` does with whole planes, and exact to rounding for the same reasons.
"""
