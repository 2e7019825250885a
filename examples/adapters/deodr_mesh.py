"""An adapter for DEODR, a compiled mesh rasterizer with its own adjoint.

DEODR (https://github.com/martinResearch/DEODR) draws triangles from and to NumPy arrays, with the derivative of its
image by the vertices in the image plane and by their colours. The adapter differentiates from there to the parameters
of a rigid pose, and keeps the contract of :class:`loi_core.Renderer`.

It needs ``pip install DEODR trimesh``; DEODR imports trimesh without requiring it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Final

import numpy as np
from deodr import ColoredTriMesh, Scene2D

from loi_core.errors import ImageError, ParameterError, RendererError
from loi_core.renderers.validation import FloatArray, check_floats, check_parameters, check_size

__all__ = ["DeodrMesh", "sphere"]

EDGE_WIDTH_PX: Final = 1.0  # width of the blend of an outline into the background
NEAREST: Final = 1e-2  # world units; DEODR clips nothing, so a vertex at the camera would land anywhere
FARTHEST: Final = 32000.0  # pixels; DEODR counts them in 16 bits and writes outside the image when they overflow


class DeodrMesh:
    """A rigid, unlit triangle mesh with a colour at each vertex, before a plain background.

    The camera is at the origin and looks along +z, x to the right and y down; pixel (0, 0) covers the unit square at
    the upper left corner of the image.

    Parameters
    ----------
    height, width : int
        Size of the image in pixels.
    vertices : array, shape (n, 3)
        In the mesh's own frame, world units.
    faces : array of int, shape (m, 3)
        Vertices of each triangle, counterclockwise as seen from outside. Faces seen from behind are not drawn.
    colours : array, shape (n, 3)
        Linear RGB of each vertex.
    background : array, shape (3,)
        Linear RGB.
    translation : array, shape (3,)
        Where the mesh's origin is, world units.
    rotation : array, shape (3,)
        Axis of the rotation about the mesh's origin, times its angle in radians.
    field_of_view : float
        Angle in degrees that the image's height spans.

    Raises
    ------
    ParameterError
        If a value has a wrong shape, is not finite, or is not allowed.
    RendererError
        If DEODR refuses the mesh, such as for faces that are wound the other way round.

    Notes
    -----
    DEODR leaves the image and the adjoint's sums in its scene. Every render here makes a scene of its own, which only
    its pullback ever sees again, so renders and pullbacks may be called in any order. Of DEODR only the rasterizer is
    used: the adjoint of its camera class (0.2.3) applies a rotation where it should apply the inverse.
    """

    def __init__(
        self,
        height: int,
        width: int,
        vertices: Sequence[Sequence[float]] | FloatArray,
        faces: Sequence[Sequence[int]] | np.ndarray[Any, Any],
        colours: Sequence[Sequence[float]] | FloatArray,
        background: Sequence[float] | FloatArray = (0.0, 0.0, 0.0),
        translation: Sequence[float] | FloatArray = (0.0, 0.0, 5.0),
        rotation: Sequence[float] | FloatArray = (0.0, 0.0, 0.0),
        field_of_view: float = 45.0,
    ) -> None:
        self._height = check_size("height", height)
        self._width = check_size("width", width)
        self._vertices = check_floats("vertices", vertices, (None, 3))
        count = len(self._vertices)
        self._faces = _checked_faces(faces, count)
        self._background = check_floats("background", background, (3,))
        self._pose = {
            "translation": check_floats("translation", translation, (3,)),
            "rotation": check_floats("rotation", rotation, (3,)),
            "colours": check_floats("colours", colours, (count, 3)),
        }
        if not 0.0 < field_of_view < 180.0:
            msg = f"`field_of_view` must be between 0 and 180 degrees, got {field_of_view!r}"
            raise ParameterError(msg)
        self._focal = 0.5 * self._height / np.tan(0.5 * np.radians(field_of_view))
        with _reported():
            # Only its table of neighbours is kept; on the way DEODR checks the mesh.
            adjacent = ColoredTriMesh(self._faces, self._vertices, colors=self._pose["colours"]).adjacencies
        if not adjacent.is_manifold:
            msg = "`faces` must be wound alike and meet two at an edge, got an edge where they do not"
            raise ParameterError(msg)
        self._edges_by_face = np.asarray(adjacent.faces_edges)
        self._faces_by_edge = adjacent.edges_faces_ones.tocsr()

    def parameters(self) -> dict[str, FloatArray]:
        """``translation`` (3,) world units, ``rotation`` (3,) radians and ``colours`` (n, 3), float64."""
        return {name: value.copy() for name, value in self._pose.items()}

    def render(self, params: dict[str, FloatArray], *, seed: int = 0) -> FloatArray:
        """The image, shape (height, width, 3), float64; `seed` is not needed, nothing is random."""
        return self.render_vjp(params, seed=seed)[0]

    def render_vjp(
        self, params: dict[str, FloatArray], *, seed: int = 0
    ) -> tuple[FloatArray, Callable[[FloatArray], dict[str, FloatArray]]]:
        """The image and its pullback; see :class:`loi_core.Renderer`."""
        pose = check_parameters(params, self._pose)
        rotation_matrix = _rotation_matrix(pose["rotation"])
        points = self._vertices @ rotation_matrix.T + pose["translation"]
        depths = points[:, 2]
        if np.any(depths < NEAREST):
            msg = f"`translation` must keep all vertices at z >= {NEAREST}, got one at z = {depths.min():.6g}"
            raise ParameterError(msg)
        slopes = points[:, :2] / depths[:, None]
        corners = self._focal * slopes + 0.5 * np.array([self._width, self._height])
        if np.abs(corners).max() > FARTHEST:
            msg = f"`translation` must keep all vertices within {FARTHEST:.0f} pixels, got {np.abs(corners).max():.6g}"
            raise ParameterError(msg)
        scene = self._scene(corners, depths, pose["colours"])
        with _reported():
            image, _ = scene.render(EDGE_WIDTH_PX)

        def pullback(cotangent: FloatArray) -> dict[str, FloatArray]:
            arriving = np.array(cotangent, dtype=np.float64, order="C")  # DEODR works in the array that it is given
            if arriving.shape != image.shape:  # and reads beyond the end of one that is too small
                msg = f"`cotangent` must have the image's shape {image.shape}, got {arriving.shape}"
                raise ImageError(msg)
            scene.clear_gradients()
            with _reported():
                scene.render_backward(arriving)
            by_slope = self._focal * scene.ij_b / depths[:, None]
            by_point = np.column_stack([by_slope, -np.sum(by_slope * slopes, axis=1)])
            # A small turn d after R moves R v by R (d x v), so its gradient is v x (R^T g).
            by_turn = np.sum(np.cross(self._vertices, by_point @ rotation_matrix), axis=0)
            return {
                "translation": by_point.sum(axis=0),
                "rotation": _right_jacobian(pose["rotation"]).T @ by_turn,
                "colours": scene.colors_b.copy(),
            }

        return image.copy(), pullback  # the scene keeps its own, which the adjoint needs unchanged

    def _scene(self, corners: FloatArray, depths: FloatArray, colours: FloatArray) -> Scene2D:
        count = len(corners)
        none = np.zeros(len(self._faces), dtype=bool)
        return Scene2D(
            faces=self._faces,
            faces_uv=self._faces,
            ij=corners,
            depths=depths,
            textured=none,
            uv=np.zeros((count, 2)),
            shade=np.zeros(count),
            colors=colours,
            shaded=none,
            edgeflags=self._outlines(corners),
            height=self._height,
            width=self._width,
            nb_colors=3,
            texture=np.zeros((0, 0)),
            background_color=self._background,
            clockwise=False,
            backface_culling=True,  # without it DEODR has no adjoint
            integer_pixel_centers=False,
        )

    def _outlines(self, corners: FloatArray) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """Whether each edge of each face is on the outline, (m, 3): it has one visible face, not two or none.

        DEODR's own `edge_on_silhouette` does the same with a call that NumPy 2 deprecates.
        """
        first, second, third = (corners[self._faces[:, k]] for k in range(3))
        u, v = second - first, third - first
        visible = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0] < 0.0
        on_outline = self._faces_by_edge @ visible.astype(np.float64) == 1.0
        return np.asarray(on_outline[self._edges_by_face], dtype=bool)


@contextmanager
def _reported() -> Iterator[None]:
    """Turn what DEODR raises into a `RendererError`; it raises bare ``BaseException``, which escapes most handlers."""
    try:
        yield
    except (KeyboardInterrupt, SystemExit, MemoryError):
        raise
    except BaseException as error:
        msg = f"DEODR refused: {str(error) or type(error).__name__}"
        raise RendererError(msg) from error


def _checked_faces(faces: object, count: int) -> np.ndarray[Any, np.dtype[np.uint32]]:
    array = np.asarray(faces)
    if array.dtype.kind not in "iu" or array.ndim != 2 or array.shape[1] != 3 or not len(array):
        msg = f"`faces` must be whole numbers of shape (m, 3), got {array.dtype} of shape {array.shape}"
        raise ParameterError(msg)
    if array.min() < 0 or array.max() >= count:
        msg = f"`faces` must name vertices 0 to {count - 1}, got {array.min()} to {array.max()}"
        raise ParameterError(msg)
    return array.astype(np.uint32)


def _cross_matrix(vector: FloatArray) -> FloatArray:
    """The matrix (3, 3) that takes u to `vector` x u."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _rotation_matrix(vector: FloatArray) -> FloatArray:
    """Rodrigues' formula, with factors that are finite at no rotation."""
    angle, cross = float(np.linalg.norm(vector)), _cross_matrix(vector)
    return np.eye(3) + np.sinc(angle / np.pi) * cross + 0.5 * np.sinc(0.5 * angle / np.pi) ** 2 * cross @ cross


def _right_jacobian(vector: FloatArray) -> FloatArray:
    """Return the matrix J (3, 3) with R(vector + d) = R(vector) R(J d) up to second order in d."""
    angle, cross = float(np.linalg.norm(vector)), _cross_matrix(vector)
    # (a - sin a) / a^3 cancels at small angles; three terms of its series are exact in float64 below this one.
    squared = angle * angle
    cubic = (
        (angle - np.sin(angle)) / (squared * angle)
        if angle > 0.02
        else 1.0 / 6.0 - squared / 120.0 + squared * squared / 5040.0
    )
    return np.eye(3) - 0.5 * np.sinc(0.5 * angle / np.pi) ** 2 * cross + cubic * cross @ cross


def sphere(subdivisions: int = 3) -> tuple[FloatArray, np.ndarray[Any, np.dtype[np.int64]], FloatArray]:
    """Return a unit sphere with colours by direction, for :class:`DeodrMesh`.

    Parameters
    ----------
    subdivisions : int
        How often each triangle of an octahedron is cut into four.

    Returns
    -------
    vertices : array, shape (n, 3)
    faces : array of int, shape (m, 3)
        Counterclockwise as seen from outside.
    colours : array, shape (n, 3)
        In [0, 1].
    """
    signs = np.array([[x, y, z] for x in (1, -1) for y in (1, -1) for z in (1, -1)])
    corners = signs[:, :, None] * np.eye(3)
    mirrored = np.prod(signs, axis=1) < 0
    corners[mirrored] = corners[mirrored][:, ::-1]
    for _ in range(subdivisions):
        a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
        ab, bc, ca = a + b, b + c, c + a
        corners = np.stack([a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca], axis=1).reshape(-1, 3, 3)
        corners /= np.linalg.norm(corners, axis=-1, keepdims=True)
    # Halves of the same edge come out of two faces with the same digits or nearly so; rounding makes them one.
    vertices, faces = np.unique(np.round(corners.reshape(-1, 3), 12) + 0.0, axis=0, return_inverse=True)
    return vertices, faces.reshape(-1, 3), 0.5 + 0.5 * vertices
