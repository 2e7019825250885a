"""Isophotes and local histograms of an image."""

from __future__ import annotations

from loi_core.errors import ScaleError
from loi_core.method.blurs import blur_about, gaussian_blur
from loi_core.method.scales import ScaleSpace
from loi_core.method.tonal import isophote_density
from loi_core.pixels.layout import Layout, check_channel_axis
from loi_core.pixels.nonfinite import require_finite
from loi_core.support.arrays import Array, as_floating, from_numpy, namespace, narrowed, widened
from loi_core.support.keywords import suggest_keywords
from loi_core.support.wording import shown

__all__ = ["inner_images", "isophotes", "local_histograms"]


@suggest_keywords
def inner_images(image: Array, scales: ScaleSpace, *, channel_axis: int | None = -1) -> dict[float, Array]:
    """Return the image at every inner scale (eq. 1): ``{sigma: array like image}``.

    Intensities beyond the bounds are compressed first.

    Parameters
    ----------
    image : array, shape (*batch, H, W, C)
        Real floating point and finite.
    scales : ScaleSpace
        Provides sigma, bounds and boundary.
    channel_axis : int or None
        Axis of the channels; None for images without channels.
    """
    layout = _checked(image, channel_axis)
    compressed = scales.intensity_range.apply(layout.to_planes(widened(image)))
    return {sigma: narrowed(layout.to_image(_inner(compressed, scales, sigma)), image) for sigma in scales.sigma}


@suggest_keywords
def isophotes(image: Array, scales: ScaleSpace, *, sigma: float, beta: float, channel_axis: int | None = -1) -> Array:
    """Return the soft isophotes of an image (eq. 3): the density of each intensity at each pixel.

    Parameters
    ----------
    image : array, shape (*batch, H, W, C)
        Real floating point and finite.
    scales : ScaleSpace
        Provides bounds, levels and boundary; `sigma` and `beta` must be among its scales.
    sigma, beta : float
        Inner scale in pixels, tonal scale in units of intensity.
    channel_axis : int or None
        Axis of the channels; None for images without channels.

    Returns
    -------
    array, shape (L,) + image.shape
        Densities in one over intensity, at the intensities ``scales.levels(beta)``; under the paper's convention
        their sum over levels times ``scales.spacing(beta)`` is 1 up to the mass beyond the tails.
    """
    return local_histograms(image, scales, sigma=sigma, beta=beta, alpha=0.0, channel_axis=channel_axis)


@suggest_keywords
def local_histograms(
    image: Array, scales: ScaleSpace, *, sigma: float, beta: float, alpha: float, channel_axis: int | None = -1
) -> Array:
    """Return the local histograms of an image (eq. 4): isophotes averaged over a neighbourhood of `alpha` pixels.

    Parameters and result as in :func:`isophotes`; `alpha` must be one of the scales, or 0.

    Raises
    ------
    ScaleError
        If a scale is not one of `scales`.
    """
    layout = _checked(image, channel_axis)
    for name, value, allowed in (
        ("sigma", sigma, scales.sigma),
        ("beta", beta, scales.beta),
        ("alpha", alpha, (0.0, *scales.alpha)),
    ):
        if value not in allowed:
            msg = f"`{name}` must be one of {allowed}, got {shown(value)}"
            raise ScaleError(msg)
    planes = _inner(scales.intensity_range.apply(layout.to_planes(widened(image))), scales, sigma)
    levels = from_numpy(scales.levels(beta), planes)
    extent = gaussian_blur(layout.height, layout.width, alpha, scales.boundary, like=planes, taps=scales.extent_taps)
    densities = extent.apply(isophote_density(planes, levels, beta))
    xp = namespace(densities)
    stack = xp.stack([layout.to_image(densities[index, ...]) for index in range(densities.shape[0])], axis=0)
    return narrowed(stack, image)


def _checked(image: Array, channel_axis: int | None) -> Layout:
    as_floating("image", image)
    layout = Layout.of("image", image.shape, check_channel_axis(channel_axis))
    require_finite("image", image, channel_axis)
    return layout


def _inner(compressed: Array, scales: ScaleSpace, sigma: float) -> Array:
    height, width = compressed.shape[-2:]
    blur = gaussian_blur(height, width, sigma, scales.boundary, like=compressed, taps=scales.inner_taps)
    return blur_about(blur, compressed, scales.padding)
