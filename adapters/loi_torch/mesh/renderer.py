"""Triangle meshes as a renderer: named parameters to an image, and a pullback."""

from __future__ import annotations

import copy
import pathlib
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

from torch import Tensor

from loi_core.errors import OptionError, ParameterError
from loi_core.renderers.checks import check_dtype, check_size
from loi_core.renderers.contract import RendererCapabilities
from loi_core.renderers.handles import Target, targets_of
from loi_core.scenes.target import read_target
from loi_core.support.wording import shown
from loi_torch.mesh.cameras import Camera
from loi_torch.mesh.drawing import draw, draw_places
from loi_torch.mesh.lighting import Environment, Light
from loi_torch.mesh.meshes import Material, Mesh
from loi_torch.mesh.reading import read_mesh
from loi_torch.mesh.tensors import colours_behind
from loi_torch.mesh.values import Scene, Values
from loi_torch.painted import Painted, Tensors

__all__ = ["MeshRenderer"]

NEEDED: Final[dict[type[Any], tuple[str, ...]]] = {Camera: ("position",), Mesh: ("vertices", "faces")}


class MeshRenderer(Painted):
    """Triangle meshes whose named parameters can be fitted; keeps the contract of :class:`loi_core.Renderer`.

    Parameters
    ----------
    height, width : int
        Size of the image in pixels.
    meshes : dict of Mesh, path or table
        By name. Paths are read by :func:`read_mesh`.
    camera : Camera or table
        A table has the arguments of :class:`Camera`.
    parameters : dict of str or handle
        What each parameter stands for, by its name: an entry of the scene (:meth:`entries` shows all), or
        :class:`Translate`, :class:`Rotate` or :class:`Scale` of a mesh. Several handles may share a mesh. Scene files,
        which have no classes, spell a handle as a table, ``{ Translate = "duck", axis = [1, 0, 0] }``.
    textures : dict of array or path, optional
        Of meshes with texture coordinates, by the mesh's name: linear RGB, shape (h, w, 3), or an image file.
    materials : dict of Material or table, optional
        By the mesh's name; a table has the arguments of :class:`Material`.
    lights : dict of Light or table, optional
        By name. One at the camera, named ``light``, by default; an empty dict shows colours as they are.
    environment : Environment, path or array, optional
        What mirrors show: an image of longitude and latitude, linear RGB, or a cube map, shape (6, s, s, 3).
    background : float, array of shape (3,) or (height, width, 3), path, or Environment
        Linear RGB behind all meshes; an image file is decoded.
    places : bool
        Whether the image has x and y of what it shows as two further channels, and jagged outlines: for RGBXY.
    dtype : {"float64", "float32"}
        Of parameters and images; the arithmetic inside is float64.
    device : str
        Where torch computes; one that has float64.

    Raises
    ------
    ParameterError
        If a value has a wrong shape or is not finite, or a target is not there.
    MeshError
        If a file cannot be read.

    Notes
    -----
    Coverage of outlines is exact; see ``loi_torch.mesh.coverage``. What is seen where is found on the host, compiled
    if Numba is installed. Shadows and mirrored meshes are not drawn.

    Examples
    --------
    >>> from loi_torch.mesh import Camera, MeshRenderer, Translate, sphere
    >>> renderer = MeshRenderer(48, 64, {"ball": sphere()}, Camera((0, 0, 6)), {"place": Translate("ball")})
    >>> tuple(renderer.render(renderer.parameters()).shape)
    (48, 64, 3)
    """

    def __init__(
        self,
        height: int,
        width: int,
        meshes: Mapping[str, Mesh | pathlib.Path | Mapping[str, Any]],
        camera: Camera | Mapping[str, Any],
        parameters: Mapping[str, Target | Mapping[str, Any]],
        *,
        textures: Mapping[str, Any | pathlib.Path] | None = None,
        materials: Mapping[str, Material | Mapping[str, Any]] | None = None,
        lights: Mapping[str, Light | Mapping[str, Any]] | None = None,
        environment: Environment | pathlib.Path | Any = None,
        background: Environment | pathlib.Path | Any = 0.0,
        places: bool = False,
        dtype: str = "float64",
        device: str = "cpu",
    ) -> None:
        self._size = check_size("height", height), check_size("width", width)
        if lights is not None and not isinstance(lights, Mapping):
            msg = f"`lights` must be a dict of names and lights, got {shown(lights)}"
            raise ParameterError(msg)
        made = {name: _made(Light, "lights", name, value) for name, value in (lights or {}).items()}
        if lights is None:
            made = {"light": Light()}
        if environment is not None and not isinstance(environment, Environment):
            environment = Environment(_image(environment))
        scene = Scene(
            _meshes(meshes, textures or {}, materials or {}),
            _made(Camera, "camera", None, camera),
            made,
            environment,
            background if isinstance(background, Environment) else colours_behind(_image(background), *self._size),
        )
        clashing = [*scene.meshes, *scene.lights, "camera", "environment", "background"]
        for name in clashing:
            if clashing.count(name) > 1 or "." in name:
                msg = f"`meshes` and `lights` must have names of their own, without dots, got {name!r}"
                raise ParameterError(msg)
        check_dtype(dtype)
        self._values = Values(scene, targets_of(parameters))
        self._places = bool(places)
        super().__init__(self._values, dtype, device)

    @property
    def capabilities(self) -> RendererCapabilities:
        """The image is linear, and a fit calls :meth:`project` after every step."""
        return RendererCapabilities(project=self.project, encoding="linear")

    def entries(self) -> dict[str, tuple[int, ...]]:
        """The shapes of everything that a parameter may stand for, by its name."""
        return {name: tuple(value.shape) for name, value in self._values.scene.entries().items()}

    def scene(self, params: Tensors) -> Scene:
        """The meshes, camera and lights that have these parameters."""
        return self._values.scene_of(self._checked(params))

    def looking(self, camera: Camera) -> MeshRenderer:
        """The same meshes and parameters under another camera: a view for :func:`loi_core.fit`.

        Raises
        ------
        OptionError
            If a parameter is the camera's own.
        ParameterError
            If `camera` is none.
        """
        if not isinstance(camera, Camera):
            msg = f"`camera` must be a Camera, got {shown(camera)}"
            raise ParameterError(msg)
        targets = self._values.targets
        held = [name for name, target in targets.items() if isinstance(target, str) and target.startswith("camera.")]
        if held:
            msg = f"`camera` must not change under a parameter of its own, {held[0]!r}"
            raise OptionError(msg)
        other = copy.copy(self)
        other._values = Values(replace(self._values.scene, camera=camera), targets)
        other._scene = other._values
        return other

    def _paint(self, scene: Tensors) -> Tensor:
        made = self._values.scene_of(scene)
        how = draw_places if self._places else draw
        return how(
            list(made.meshes.values()),
            made.camera,
            *self._size,
            lights=list(made.lights.values()),
            environment=made.environment,
            background=made.background,
        )


def _made(kind: type[Any], argument: str, name: str | None, value: Any) -> Any:
    """`value` as a camera, light or material; tables of scene files are their arguments."""
    where = argument if name is None else f"{argument}[{name!r}]"
    if isinstance(value, kind):
        return value
    if not isinstance(value, Mapping):
        msg = f"`{where}` must be a {kind.__name__} or a table of its arguments, got {shown(value)}"
        raise ParameterError(msg)
    known = list(kind.__dataclass_fields__)
    for key in value:
        if key not in known:
            msg = f"`{where}`: unknown key `{key}`; {kind.__name__} takes {', '.join(known)}"
            raise ParameterError(msg)
    for key in NEEDED.get(kind, ()):
        if key not in value:
            msg = f"`{where}`: `{key}` is missing"
            raise ParameterError(msg)
    try:
        return kind(**value)
    except ParameterError as error:
        msg = f"`{where}`: {error}"
        raise ParameterError(msg) from None


def _meshes(meshes: Any, textures: Mapping[str, Any], materials: Mapping[str, Any]) -> dict[str, Mesh]:
    if not isinstance(meshes, Mapping):
        msg = f"`meshes` must be a dict of names and meshes, got {shown(meshes)}"
        raise ParameterError(msg)
    for argument, table in (("textures", textures), ("materials", materials)):
        for name in table:
            if name not in meshes:
                msg = f"`{argument}[{name!r}]` is of no mesh; they are {', '.join(map(str, meshes)) or 'none'}"
                raise ParameterError(msg)
    made = {}
    for name, given in meshes.items():
        options: dict[str, Any] = {}
        if name in textures:
            options["texture"] = _image(textures[name])
        if name in materials:
            options["material"] = _made(Material, "materials", name, materials[name])
        if isinstance(given, Mesh):
            made[name] = replace(given, **options)
        elif isinstance(given, pathlib.Path | str):
            made[name] = read_mesh(given, **options)
        else:
            made[name] = _made(Mesh, "meshes", name, given)
            made[name] = replace(made[name], **options) if options else made[name]
    return made


def _image(value: Any) -> Any:
    """Linear RGB: an array as it is, a file decoded."""
    return read_target(value, to="linear", alpha="ignore").image if isinstance(value, pathlib.Path | str) else value
