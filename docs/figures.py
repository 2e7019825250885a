"""Draw the pictures of the README: ``python docs/figures.py DEMO``, with a folder written by ``loi demo``."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any, Final

import numpy as np

from examples.plots import new_figure
from loi_core import ScaleSpace, inner_images, isophotes, local_histograms
from loi_core.io.images import read_image
from loi_core.pixels.encoding import encode_srgb

IMAGES: Final = Path(__file__).parent / "images"
COLUMNS: Final = (
    ("start", "initial.png"),
    ("target", "target.png"),
    ("pixel L2", "compare/pixel_l2/final.png"),
    ("Gaussian pyramid", "compare/gaussian_pyramid/final.png"),
    ("loi", "final.png"),
)


def show_demo(demo: Path) -> None:
    """Draw both scenes of the demo: start, target, and the result of each objective."""
    figure = new_figure(11.0, 4.3)
    axes = figure.subplots(2, len(COLUMNS), height_ratios=[1.0, 0.78])
    for row, name in enumerate(("disks", "photograph")):
        for column, (title, file) in enumerate(COLUMNS):
            _picture(axes[row, column], read_image(demo / name / "result" / file))
            if row == 0:
                axes[row, column].set_title(title, fontweight="bold" if title == "loi" else "normal")
        trials = json.loads((demo / name / "result" / "result.json").read_text())["trials"]
        for column, objective in ((2, "pixel_l2"), (3, "gaussian_pyramid"), (4, "loi")):
            quality = next(trial["psnr"] for trial in trials if trial["objective"] == objective)
            axes[row, column].set_xlabel(f"{quality:.1f} dB")
    figure.savefig(IMAGES / "demo.png", dpi=90)


def show_scales(demo: Path) -> None:
    """Draw the three scales on the photograph of the demo."""
    image = read_image(demo / "photograph" / "target.png").mean(axis=-1)
    scales = ScaleSpace(sigma=(0, 2, 6), alpha=(3, 8, 20), beta=0.08)
    inner = inner_images(image, scales, channel_axis=None)
    density = isophotes(image, scales, sigma=0, beta=0.08, channel_axis=None)
    levels = scales.levels(0.08)
    figure = new_figure(11.0, 6.2)
    axes = figure.subplots(3, 4, width_ratios=[0.55, 1, 1, 1])
    texts = (
        ("inner scale sigma", "blur the image:\nhow fine is a pixel?"),
        ("tonal scale beta", "split it by intensity:\neach pixel becomes a\nsoft histogram"),
        ("extent scale alpha", "gather the histograms of a\nneighbourhood (here, around\nthe cross); compare those"),
    )
    for row, (name, text) in enumerate(texts):
        axes[row, 0].axis("off")
        axes[row, 0].text(0.0, 0.62, name, fontweight="bold", transform=axes[row, 0].transAxes)
        axes[row, 0].text(0.0, 0.22, text, fontsize=9, transform=axes[row, 0].transAxes)
    for axis, sigma in zip(axes[0, 1:], scales.sigma, strict=True):
        _picture(axis, inner[sigma])
        axis.set_title(f"sigma = {sigma:g}", fontsize=10)
    for axis, level in zip(axes[1, 1:], (0.1, 0.3, 0.6), strict=True):
        index = int(np.argmin(np.abs(levels - level)))
        _picture(axis, density[index], cmap="magma", vmax=density.max())
        axis.set_title(f"how much each pixel is {levels[index]:.2f}", fontsize=10)
    row, column = 34, 84
    for axis, alpha in zip(axes[2, 1:], scales.alpha, strict=True):
        local = local_histograms(image, scales, sigma=0, beta=0.08, alpha=alpha, channel_axis=None)
        axis.bar(levels, local[:, row, column] * scales.spacing(0.08), width=0.07, color="#c2410c")
        axis.set(xlim=(-0.2, 1.1), xticks=(0.0, 0.5, 1.0), yticks=[], xlabel="intensity")
        axis.set_title(f"alpha = {alpha:g}", fontsize=10)
    axes[0, 1].plot(column, row, "+", color="#c2410c", markersize=14, markeredgewidth=2)
    figure.savefig(IMAGES / "scales.png", dpi=90)


def show_mesh() -> None:
    """Draw a teapot that does not overlap its photograph: start, target, and the result of the fit."""
    import torch

    from examples.paper.table3.teapot import teapot
    from loi_core import LOIObjective, fit
    from loi_core.fitting.loop import Free
    from loi_torch.mesh import Camera, Light, MeshRenderer, Rotate, Translate, quad

    checks = 0.35 + 0.3 * (np.indices((8, 8)).sum(axis=0) % 2.0)[..., None] * np.ones(3)
    floor = quad((-6, -0.75, 4), (6, -0.75, 4), (6, -0.75, -6), (-6, -0.75, -6), texture=np.repeat(checks, 8, axis=1))
    renderer = MeshRenderer(
        108,
        192,
        {"teapot": teapot(1.2, colours=(0.9, 0.45, 0.2)), "floor": floor},
        Camera((0.0, 2.5, 7.0), fov=35.0),
        {"position": Translate("teapot"), "angle": Rotate("teapot", (0, 1, 0))},
        lights={"sun": Light(direction=(-1, -2, -2))},
        background=(0.55, 0.7, 0.9),
    )
    truth = {"position": torch.tensor([2.0, 0.0, 0.6]), "angle": torch.tensor(40.0)}
    target = renderer.render({name: value.double() for name, value in truth.items()})
    free = {"position": Free((-2.2, 0.0, -1.0), (-3.0, 0.0, -3.0), (3.0, 0.0, 2.0)), "angle": Free(0.0, -90.0, 90.0)}
    start = renderer.render({"position": torch.tensor([-2.2, 0.0, -1.0]).double(), "angle": torch.tensor(0.0).double()})
    result = fit(renderer, LOIObjective(target), steps=200, optimise=free)
    print(result.params, result.diagnosis)
    figure = new_figure(11.0, 2.3)
    axes = figure.subplots(1, 3)
    for axis, title, image in zip(axes, ("start", "photograph", "result"), (start, target, result.image), strict=True):
        _picture(axis, encode_srgb(np.clip(image.numpy(), 0.0, 1.0)))
        axis.set_title(title)
    figure.savefig(IMAGES / "mesh.png", dpi=90)


def show_kornia() -> None:
    """Draw a disk that kornia's registrator moves onto another: source, target, and the results of two losses."""
    import torch
    from kornia.geometry import ImageRegistrator

    from loi_torch.kornia import RegistrationLoss

    rows, columns = np.indices((64, 64)) + 0.5

    def disk(x: float, y: float) -> torch.Tensor:
        return torch.tensor(0.2 + 0.6 * np.clip(5.5 - np.hypot(columns - x, rows - y), 0.0, 1.0))[None, None].float()

    source, target = disk(44.0, 42.0), disk(20.0, 23.0)
    losses: dict[str, Any] = {"L1": torch.nn.functional.l1_loss, "loi": RegistrationLoss()}
    pictures = {"source": source, "target": target}
    shifts = {}
    for name, loss in losses.items():
        registrator = ImageRegistrator("translation", loss_fn=loss, lr=0.01)
        model = registrator.register(source, target)
        assert isinstance(model, torch.Tensor)
        shifts[name] = -32.0 * model.detach()[0, :2, 2]
        # Fill the uncovered border with the grey of the background, so that only the disk appears to move.
        pictures[name] = registrator.warp_src_into_dst(source - 0.2).detach() + 0.2
    figure = new_figure(11.0, 3.4)
    for axis, (name, image) in zip(figure.subplots(1, 4), pictures.items(), strict=True):
        _picture(axis, image[0, 0].numpy())
        axis.set_title(name, fontweight="bold" if name == "loi" else "normal")
        axis.plot(20.0 - 0.5, 23.0 - 0.5, "+", color="#c2410c", markersize=14)
        if name in shifts:
            axis.set_xlabel("moved by ({:.1f}, {:.1f})".format(*shifts[name].tolist()))
    figure.savefig(IMAGES / "kornia.png", dpi=90)


def _picture(axis: Any, image: Any, cmap: str = "gray", vmax: float = 1.0) -> None:
    axis.imshow(image, cmap=cmap, vmin=0.0, vmax=vmax, interpolation="nearest")
    axis.set(xticks=[], yticks=[])


if __name__ == "__main__":
    show_demo(Path(sys.argv[1]))
    show_scales(Path(sys.argv[1]))
    show_mesh()
    show_kornia()
