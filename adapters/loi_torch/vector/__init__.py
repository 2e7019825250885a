"""Vector graphics on torch: shapes that are painted by exact area, and SVG."""

from loi_torch.vector.renderer import Vector
from loi_torch.vector.shapes import Circle, Ellipse, Outline, Paint, Path, Rectangle, Shape, polygon
from loi_torch.vector.svg_reading import Drawing, read_svg
from loi_torch.vector.svg_writing import write_svg

__all__ = [
    "Circle",
    "Drawing",
    "Ellipse",
    "Outline",
    "Paint",
    "Path",
    "Rectangle",
    "Shape",
    "Vector",
    "polygon",
    "read_svg",
    "write_svg",
]
