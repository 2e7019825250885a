"""Read photographs with their cameras."""

from __future__ import annotations

from pathlib import Path

from loi_core.cameras.colmap import is_colmap_model, read_colmap
from loi_core.cameras.lenses import Distortion, check_distortion_option
from loi_core.cameras.posed_image import PosedImage
from loi_core.cameras.transforms import read_transforms
from loi_core.errors import CameraError
from loi_core.support.keywords import suggest_keywords
from loi_core.support.wording import shown

__all__ = ["read_posed_images"]


@suggest_keywords
def read_posed_images(
    path: Path | str, images: Path | str | None = None, *, distortion: Distortion = "refuse"
) -> dict[str, PosedImage]:
    """Read the cameras of photographs, from COLMAP, NeRF's Blender scenes, instant-ngp or nerfstudio.

    Parameters
    ----------
    path : path or str
        A JSON file such as ``transforms.json``; or the folder of a COLMAP model, text or binary, such as ``sparse/0``.
    images : path or str, optional
        Folder of the image files. The default is the folder of the JSON file, or the folder ``images`` that COLMAP and
        nerfstudio put beside or above the model.
    distortion : {"refuse", "ignore"}
        Whether a lens that distorts is an error, or its distortion left out.

    Returns
    -------
    dict of PosedImage
        By the names of the images, which are relative to the folder. Image files need not exist, except that the first
        is read if the file has no image size.

    Raises
    ------
    CameraError
        If a file is missing or damaged, names an image twice, or has a camera that is no pinhole.
    ImageFileError
        If the file has no image size, and its first image cannot be read.
    OptionError
        If `distortion` is not allowed.

    Examples
    --------
    >>> import loi_core
    >>> views = loi_core.read_posed_images("transforms.json")  # doctest: +SKIP
    """
    check_distortion_option(distortion)
    if not isinstance(path, Path | str):
        msg = f"`path` must be a path, got {shown(path)}"
        raise CameraError(msg)
    path = Path(path)
    folder = None if images is None else Path(images)
    if path.suffix.lower() == ".json":
        pairs = read_transforms(path, folder, distortion)
    elif is_colmap_model(path):
        pairs = read_colmap(path, folder, distortion)
    else:
        msg = f"{path}: must be a JSON file of transforms, or a folder with COLMAP's cameras and images, .txt or .bin"
        raise CameraError(msg)
    posed: dict[str, PosedImage] = {}
    for name, image in pairs:
        if name in posed:
            msg = f"{path}: names the image {shown(name)} twice"
            raise CameraError(msg)
        posed[name] = image
    if not posed:
        msg = f"{path}: has no images"
        raise CameraError(msg)
    return posed
