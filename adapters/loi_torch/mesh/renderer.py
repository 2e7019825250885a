"""Triangle meshes as a renderer: from named parameters to an image and its pullback."""

from __future__ import annotations

import copy
import pathlib
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar, Final

from torch import Tensor

from loi_core.errors import OptionError, ParameterError
from loi_core.pixels.encoding import Encoding
from loi_core.renderers.contract import RendererCapabilities
from loi_core.renderers.poses import ParameterTarget, parse_targets
from loi_core.renderers.validation import check_dtype, check_size
from loi_core.scenes.target import read_target
from loi_core.support.keywords import suggest_keywords
from loi_core.support.wording import shown
from loi_torch.mesh.cameras import Camera
from loi_torch.mesh.drawing import draw, draw_positions
from loi_torch.mesh.lighting import Environment, Light
from loi_torch.mesh.meshes import Material, Mesh
from loi_torch.mesh.parameters import MeshScene, SceneParameters
from loi_torch.mesh.reading import read_mesh
from loi_torch.mesh.tensors import background_tensor
from loi_torch.painted import Painted, Tensors

__all__ = ["MeshRenderer"]

REQUIRED_KEYS: Final[dict[type[Any], tuple[str, ...]]] = {Camera: ("position",), Mesh: ("vertices", "faces")}


@suggest_keywords
class MeshRenderer(Painted):
    """Renderer of triangle meshes with named parameters; implements :class:`loi_core.Renderer`.

    Parameters
    ----------
    height, width : int
        Size of the image in pixels.
    meshes : dict of Mesh, path or table
        By name. Paths are read by :func:`read_mesh`.
    camera : Camera or table
        A table has the arguments of :class:`Camera`.
    parameters : dict of str or handle
        For each parameter, the entry of the scene that it sets (:meth:`entries` lists all), or a :class:`Translate`,
        :class:`Rotate` or :class:`Scale` of a mesh. Several handles may share a mesh. Scene files, which have no
        classes, spell a handle as a table, ``{ Translate = "duck", axis = [1, 0, 0] }``.
    textures : dict of array or path, optional
        For meshes with texture coordinates, by the mesh's name: linear RGB, shape (h, w, 3), or an image file.
    materials : dict of Material or table, optional
        By the mesh's name; a table has the arguments of :class:`Material`.
    lights : dict of Light or table, optional
        By name. The default is one light at the camera, named ``light``. With an empty dict, meshes show their colours
        unshaded.
    environment : Environment, path or array, optional
        Reflected by mirrors: a map of longitude and latitude, linear RGB, or a cube map, shape (6, s, s, 3).
    background : float, array of shape (3,) or (height, width, 3), path, or Environment
        Linear RGB behind all meshes; an image file is decoded.
    positions : bool
        Whether the image has the x and y of surface points as two further channels, and aliased outlines: for RGBXY.
    dtype : {"float64", "float32"}
        Of parameters and images; the arithmetic inside is float64.
    device : str
        Torch device of parameters and image, which must support float64. Meshes are drawn on the processor.

    Raises
    ------
    ParameterError
        If a value has a wrong shape or is not finite, or a target does not exist.
    MeshError
        If a file cannot be read.

    Notes
    -----
    Coverage of outlines is exact, see ``loi_torch.mesh.coverage``. Visibility is computed on the host and needs Numba.
    Shadows and mirrored meshes are not drawn.

    Examples
    --------
    >>> from loi_torch.mesh import Camera, MeshRenderer, Translate, sphere
    >>> renderer = MeshRenderer(48, 64, {"ball": sphere()}, Camera((0, 0, 6)), {"position": Translate("ball")})
    >>> tuple(renderer.render(renderer.parameters()).shape)
    (48, 64, 3)
    """

    image_encoding: ClassVar[Encoding] = "linear"
    """The encoding of image options in scene files."""

    def __init__(
        self,
        height: int,
        width: int,
        meshes: Mapping[str, Mesh | pathlib.Path | Mapping[str, Any]],
        camera: Camera | Mapping[str, Any],
        parameters: Mapping[str, ParameterTarget | Mapping[str, Any]],
        *,
        textures: Mapping[str, Any | pathlib.Path] | None = None,
        materials: Mapping[str, Material | Mapping[str, Any]] | None = None,
        lights: Mapping[str, Light | Mapping[str, Any]] | None = None,
        environment: Environment | pathlib.Path | Any = None,
        background: Environment | pathlib.Path | Any = 0.0,
        positions: bool = False,
        dtype: str = "float64",
        device: str = "cpu",
    ) -> None:
        self._size = check_size("height", height), check_size("width", width)
        lights = {"light": Light()} if lights is None else lights
        if not isinstance(lights, Mapping):
            msg = f"`lights` must be a dict of names and lights, got {shown(lights)}"
            raise ParameterError(msg)
        if environment is not None and not isinstance(environment, Environment):
            environment = Environment(_linear_image(environment))
        if not isinstance(background, Environment):
            background = background_tensor(_linear_image(background), *self._size)
        scene = MeshScene(
            _scene_meshes(meshes, textures or {}, materials or {}),
            _from_table(Camera, "camera", None, camera),
            {name: _from_table(Light, "lights", name, light) for name, light in lights.items()},
            environment,
            background,
        )
        names = [*scene.meshes, *scene.lights, "camera", "environment", "background"]
        for name in names:
            if names.count(name) > 1 or "." in name:
                msg = f"`meshes` and `lights` must have distinct names without dots, got {name!r}"
                raise ParameterError(msg)
        check_dtype(dtype)
        self._scene_parameters = SceneParameters(scene, parse_targets(parameters))
        self._draws_positions = bool(positions)
        super().__init__(self._scene_parameters, dtype, device)

    @property
    def capabilities(self) -> RendererCapabilities:
        """The image is linear, and a fit calls ``project`` after every step."""
        return RendererCapabilities(project=self.project, encoding="linear")

    def entries(self) -> dict[str, tuple[int, ...]]:
        """Return the shapes of all entries that a parameter may set, by name."""
        return {name: tuple(value.shape) for name, value in self._scene_parameters.scene.entries().items()}

    def with_camera(self, camera: Camera) -> MeshRenderer:
        """Return a renderer of the same meshes and parameters with another camera: a view for :func:`loi_core.fit`.

        Raises
        ------
        OptionError
            If a parameter sets an entry of the camera.
        ParameterError
            If `camera` is not a Camera.
        """
        if not isinstance(camera, Camera):
            msg = f"`camera` must be a Camera, got {shown(camera)}"
            raise ParameterError(msg)
        targets = self._scene_parameters.targets
        for name, target in targets.items():
            if isinstance(target, str) and target.startswith("camera."):
                msg = f"`camera` must not replace a camera that the parameter {name!r} sets"
                raise OptionError(msg)
        view = copy.copy(self)
        view._scene_parameters = SceneParameters(replace(self._scene_parameters.scene, camera=camera), targets)
        view._scene = view._scene_parameters
        return view

    def _paint(self, scene: Tensors) -> Tensor:
        mesh_scene = self._scene_parameters.scene_of(scene)
        drawer = draw_positions if self._draws_positions else draw
        image = drawer(
            list(mesh_scene.meshes.values()),
            mesh_scene.camera,
            *self._size,
            lights=list(mesh_scene.lights.values()),
            environment=mesh_scene.environment,
            background=mesh_scene.background,
        )
        return image.to(self._device)


def _from_table(table_type: type[Any], argument: str, name: str | None, value: Any) -> Any:
    """Return `value` as a camera, light, material or mesh; a table of a scene file has the arguments of its class."""
    where = argument if name is None else f"{argument}[{name!r}]"
    if isinstance(value, table_type):
        return value
    if not isinstance(value, Mapping):
        msg = f"`{where}` must be a {table_type.__name__} or a table of its arguments, got {shown(value)}"
        raise ParameterError(msg)
    allowed = list(table_type.__dataclass_fields__)
    for key in value:
        if key not in allowed:
            msg = f"`{where}`: unknown key `{key}`; {table_type.__name__} takes {', '.join(allowed)}"
            raise ParameterError(msg)
    for key in REQUIRED_KEYS.get(table_type, ()):
        if key not in value:
            msg = f"`{where}`: `{key}` is missing"
            raise ParameterError(msg)
    try:
        return table_type(**value)
    except ParameterError as error:
        msg = f"`{where}`: {error}"
        raise ParameterError(msg) from None


def _scene_meshes(meshes: Any, textures: Mapping[str, Any], materials: Mapping[str, Any]) -> dict[str, Mesh]:
    if not isinstance(meshes, Mapping):
        msg = f"`meshes` must be a dict of names and meshes, got {shown(meshes)}"
        raise ParameterError(msg)
    for argument, table in (("textures", textures), ("materials", materials)):
        for name in table:
            if name not in meshes:
                names = ", ".join(map(str, meshes)) or "none"
                msg = f"`{argument}` must have names of meshes, {names}, got {name!r}"
                raise ParameterError(msg)
    scene_meshes = {}
    for name, value in meshes.items():
        options: dict[str, Any] = {}
        if name in textures:
            options["texture"] = _linear_image(textures[name])
        if name in materials:
            options["material"] = _from_table(Material, "materials", name, materials[name])
        if isinstance(value, pathlib.Path | str):
            scene_meshes[name] = read_mesh(value, **options)
        else:
            mesh = _from_table(Mesh, "meshes", name, value)
            scene_meshes[name] = replace(mesh, **options) if options else mesh
    return scene_meshes


def _linear_image(value: Any) -> Any:
    """Return linear RGB: an array as it is, an image file decoded."""
    return read_target(value, to="linear", alpha="ignore").image if isinstance(value, pathlib.Path | str) else value
