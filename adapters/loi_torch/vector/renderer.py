"""Vector graphics as a renderer: shapes with positions, sizes, colours, strokes and control points to optimise."""

from __future__ import annotations

import pathlib
from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from loi_core.errors import ParameterError
from loi_core.pixels.encoding import Encoding, check_encoding, encode_srgb
from loi_core.renderers.contract import RendererCapabilities
from loi_core.renderers.rasterization import IndexArray
from loi_core.renderers.validation import FloatArray, check_floats, check_size
from loi_core.support.arrays import to_numpy
from loi_core.support.keywords import suggest_keywords
from loi_core.support.wording import shown
from loi_torch.compositing import composite_fragments
from loi_torch.painted import Painted, Tensors
from loi_torch.vector.coverage import Edges, Painting, check_near, cover
from loi_torch.vector.outlines import Ring, Rings, ragged_arange, ring_points
from loi_torch.vector.shapes import Shape
from loi_torch.vector.strokes import stroke_points
from loi_torch.vector.svg_reading import read_svg
from loi_torch.vector.table import Layer, ShapeParameters

__all__ = ["Vector"]


@suggest_keywords
class Vector(Painted):
    """Shapes over a background, the later ones on top.

    Parameters
    ----------
    height, width : int
        Size of the image in pixels. Pixel (0, 0) covers the unit square at the origin.
    shapes : sequence of Shape
        Circles, ellipses, rectangles and paths; or give `svg`.
    background : array, shape (3,) or (height, width, 3), optional
        Linear RGB; by default the background of `svg`, otherwise white.
    svg : Path, optional
        An SVG file to read the shapes from; its view box is fitted into the image.
    encoding : {"linear", "sRGB"}
        Encoding of the image and of the mixing of shapes: linear light as a camera, or "sRGB" as browsers, where they
        overlap in part or are not opaque. Either way the brightness of a shape does not change as it moves between
        pixels. A target that is a PNG is decoded for "linear" in scene files, and elsewhere by
        :func:`loi_core.read_target`.
    dtype : {"float64", "float32"}
        Of parameters and images; the arithmetic inside is float64.
    device : str
        Where torch computes; one that has float64.

    Raises
    ------
    ParameterError
        If a value has a wrong shape or is not finite, or torch cannot use the device.
    SvgError
        If the file cannot be read, or has what is not supported.

    Notes
    -----
    Coverage is the exact area of outlines of chords, which stay within 0.01 pixels of the curves, so the area of a
    shape does not change as it moves between pixels. Only pixels that shapes meet are painted; which they are, and the
    areas, are found on the host.

    The parameters, of those kinds of shape that there are:

    ``positions`` (n, 2)
        Centres in pixels. Of a path, where the centre of its control points was at first.
    ``sizes`` (n, 2)
        Radii of circles and ellipses, half the sides of rectangles, in pixels; of paths factors, 1 at first.
    ``rotations`` (n,)
        In degrees, clockwise as seen.
    ``roundings``
        Radii of the corners of each rectangle, in pixels.
    ``points`` (m, 2)
        Control points of all paths relative to their positions, in pixels, before they are scaled and turned.
    ``fills`` (f, 4), ``blends`` (b, 4, 4), ``strokes`` (s, 4)
        Linear RGB and opacity of plain fills, corners of bilinear ones, and strokes, each in the order of the shapes.
    ``widths`` (s,)
        Of the strokes, in pixels.
    """

    image_encoding: ClassVar[Encoding] = "linear"
    """The encoding of image options in scene files."""

    def __init__(
        self,
        height: int,
        width: int,
        shapes: Sequence[Shape] | None = None,
        background: Sequence[float] | FloatArray | None = None,
        *,
        svg: pathlib.Path | None = None,
        encoding: str = "linear",
        dtype: str = "float64",
        device: str = "cpu",
    ) -> None:
        self._size = check_size("height", height), check_size("width", width)
        if (shapes is None) == (svg is None):
            msg = "`shapes` and `svg` exclude each other; give one of them"
            raise ParameterError(msg)
        self._encoding = check_encoding(encoding)
        paper: FloatArray = np.ones(3)
        if svg is not None:
            if not isinstance(svg, str | pathlib.Path):
                msg = f"`svg` must be the path of an SVG file, got {shown(svg)}"
                raise ParameterError(msg)
            drawing = read_svg(pathlib.Path(svg), *self._size)
            shapes, paper = drawing.shapes, drawing.background
        backdrop = paper if background is None else background
        self.background = check_floats("background", backdrop, (*self._size, 3) if np.ndim(backdrop) == 3 else (3,))
        self._table = ShapeParameters(shapes or [], dtype)
        super().__init__(self._table, dtype, device)
        backdrop = self.background if self.background.ndim == 1 else self.background.reshape(-1, 3)
        self._behind = self._encoded(torch.as_tensor(backdrop, device=self._device))

    @property
    def capabilities(self) -> RendererCapabilities:
        """The encoding of the image, and ``project``, which a fit calls after every step."""
        return RendererCapabilities(project=self.project, encoding=self._encoding)

    def shapes(self, params: Mapping[str, object]) -> list[Shape]:
        """The shapes that have these parameters, to be looked at or written with :func:`write_svg`."""
        return self._table.shapes({name: to_numpy(value) for name, value in params.items()})

    def _paint(self, scene: Tensors) -> Tensor:
        rings = ring_points(self._table, scene)
        check_near(rings.points)
        points, edges = self._edges(rings, scene)
        painting = cover(points, edges, self._size)
        # Colours are encoded, not the image: a share of a pixel would be brighter than its area is.
        colours = self._encoded_colours(painting, rings, scene)
        share = painting.coverage * colours[:, 3]
        pixels = torch.as_tensor(painting.pixels, device=self._device)
        count = self._size[0] * self._size[1]
        image = composite_fragments(share, colours[:, :3], self._behind, pixels, painting.sheets, count)
        return image.reshape(*self._size, 3)

    def _encoded(self, colours: Tensor) -> Tensor:
        """Return linear RGB, with an optional opacity, in the image's encoding: shape (..., 3) or (..., 4)."""
        if self._encoding == "linear":
            return colours
        return torch.cat([encode_srgb(colours[..., :3]), colours[..., 3:]], dim=-1)

    def _edges(self, rings: Rings, scene: Tensors) -> tuple[Tensor, Edges]:
        """The edges of all layers, and the points that they join."""
        layers = self._table.layers
        of_shape: dict[int, list[Ring]] = {}
        for ring in rings.rings:
            of_shape.setdefault(ring.shape, []).append(ring)
        filled, strokes = [], []
        for index, painted in enumerate(layers):
            if painted.kind == "stroke":
                strokes.append((index, painted, of_shape[painted.shape]))
            else:
                filled += [(index, ring.first, ring.beyond) for ring in of_shape[painted.shape]]
        layer, first, beyond = np.array(filled, dtype=np.int64).reshape(-1, 3).T
        points = rings.points
        if strokes:
            styles = [(painted.paint, shape_rings) for _, painted, shape_rings in strokes]
            stroke_outline, stroke, stroke_stops = stroke_points(rings, styles, scene["widths"])
            layer = np.append(layer, np.array([index for index, _, _ in strokes])[stroke])
            beyond = np.append(beyond, stroke_stops + len(points))
            first = np.append(first, np.append(0, stroke_stops[:-1])[: len(stroke_stops)] + len(points))
            points = torch.cat([points, stroke_outline])
        ring_of, index_in_ring = ragged_arange(beyond - first)
        following = np.where(index_in_ring + 1 < (beyond - first)[ring_of], index_in_ring + 1, 0)
        evenodd = np.array([painted.kind != "stroke" and painted.paint.rule == "evenodd" for painted in layers])
        return points, Edges(first[ring_of] + index_in_ring, first[ring_of] + following, layer[ring_of], evenodd)

    def _encoded_colours(self, painting: Painting, rings: Rings, scene: Tensors) -> Tensor:
        """RGB in the image's encoding, and opacity, of every fragment."""
        tables = [scene[name] for name in ("fills", "strokes") if name in scene]
        first = {"fill": 0, "stroke": len(scene["fills"]) if "fills" in scene else 0, "blend": 0}
        rows = np.array([first[layer.kind] + layer.row if layer.kind != "blend" else 0 for layer in self._table.layers])
        plain = self._encoded(torch.cat([*tables, torch.zeros((1, 4), dtype=torch.float64, device=self._device)]))
        colours = plain.index_select(0, torch.as_tensor(rows[painting.layer], device=self._device))
        for index, layer in enumerate(self._table.layers):
            if layer.kind == "blend":
                where = np.flatnonzero(painting.layer == index)
                blend = self._blend(layer, painting.pixels[where], rings, scene)
                colours = colours.index_copy(0, torch.as_tensor(where, device=self._device), blend)
        return colours

    def _blend(self, layer: Layer, pixels: IndexArray, rings: Rings, scene: Tensors) -> Tensor:
        """Colours of a bilinear fill at the centres of pixels; browsers mix encoded corners as well."""
        outline = torch.cat(
            [rings.local[ring.first : ring.beyond] for ring in rings.rings if ring.shape == layer.shape]
        )
        lower, upper = outline.amin(dim=0), outline.amax(dim=0)
        row, column = np.divmod(pixels, self._size[1])
        centres = torch.as_tensor(np.stack([column + 0.5, row + 0.5], axis=1), device=self._device)
        x, y = (centres - scene["positions"][layer.shape]).unbind(dim=1)
        angle = torch.deg2rad(scene["rotations"][layer.shape])
        cos, sin = torch.cos(angle), torch.sin(angle)
        local = torch.stack([cos * x + sin * y, cos * y - sin * x], dim=1)
        span = upper - lower
        position = torch.clamp((local - lower) / torch.where(span > 0.0, span, torch.ones_like(span)), 0.0, 1.0)
        u, v = position[:, :1], position[:, 1:]
        left_top, right_top, left_bottom, right_bottom = self._encoded(scene["blends"][layer.row])
        top = left_top + u * (right_top - left_top)
        bottom = left_bottom + u * (right_bottom - left_bottom)
        colours: Tensor = top + v * (bottom - top)
        return colours
