"""What a fit, or a loop of one's own, writes for TensorBoard: scalars, pictures, and the verdict."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, Protocol, runtime_checkable

import numpy as np

from loi_core.errors import OptionError
from loi_core.fitting.history import FitStep
from loi_core.fitting.notebook import numbers
from loi_core.fitting.state import FitResult
from loi_core.fitting.views import Images, by_view
from loi_core.objectives import ImageObjective, LOIObjective, Objective, TiledLOIObjective
from loi_core.pixels.display import Display
from loi_core.pixels.thumbnail import shown_pixels
from loi_core.renderers.contract import Parameters
from loi_core.support.arrays import Array, detached, to_numpy
from loi_core.support.values import whole_number
from loi_core.support.wording import shown

__all__ = ["SummaryWriter", "TensorBoardCallback"]

MOST_PARAMETERS: Final = 16  # numbers, each a curve of its own


@runtime_checkable
class SummaryWriter(Protocol):
    """What writes: that of ``torch.utils.tensorboard``, of ``tensorboardX``, or another with these methods."""

    def add_scalar(self, tag: str, scalar_value: Any, global_step: int | None = None) -> Any:
        """A number of a step."""

    def add_image(self, tag: str, img_tensor: Any, global_step: int | None = None, *, dataformats: str = "CHW") -> Any:
        """An image of a step, floating point in [0, 1]."""

    def add_text(self, tag: str, text_string: str, global_step: int | None = None) -> Any:
        """A text of a step, in Markdown."""


class TensorBoardCallback:
    """Writes what a fit does for TensorBoard: a `callback` of :func:`loi_core.fit`, usable in other loops as well.

    Every step writes the value, the norm of the gradient, the rate, the stage, and the free parameters if they are 16
    numbers or fewer. Every `every` steps, beginning with the first, write the image, and what each scale adds to the
    value.

    Parameters
    ----------
    writer : SummaryWriter
        That of ``torch.utils.tensorboard`` or ``tensorboardX``, or another with their methods. Whoever made it closes
        it.
    objective : Objective, optional
        What the images are compared by: brings the reference as a picture, and each scale's share of the value, which
        takes one more evaluation every `every` steps. For fits of one view.
    every : int
        Steps from one image to the next, 1 or more.

    Raises
    ------
    OptionError
        If an argument is not allowed.

    Examples
    --------
    >>> from torch.utils.tensorboard import SummaryWriter                              # doctest: +SKIP
    >>> with SummaryWriter("runs/disks") as writer:                                    # doctest: +SKIP
    ...     board = TensorBoardCallback(writer, objective)
    ...     board.result(fit(renderer, objective, callback=board))
    """

    def __init__(self, writer: SummaryWriter, objective: Objective | None = None, *, every: int = 25) -> None:
        if not isinstance(writer, SummaryWriter) or isinstance(writer, type):
            msg = f"`writer` must have add_scalar, add_image and add_text, as SummaryWriter has, got {shown(writer)}"
            raise OptionError(msg)
        if objective is not None and (not isinstance(objective, Objective) or isinstance(objective, type)):
            msg = f"`objective` must have value and value_and_grad, got {shown(objective)}"
            raise OptionError(msg)
        steps = whole_number(every)
        if steps is None or steps < 1:
            msg = f"`every` must be a whole number of steps, 1 or more, got {shown(every)}"
            raise OptionError(msg)
        self._writer, self._objective, self._every = writer, objective, steps
        self._displays: dict[str, Display] = {}  # of each view: one exposure, so that its pictures can be compared
        self._has_reference = False

    def __call__(self, step: FitStep, _: Parameters, image: Images, /) -> None:
        """Write a step of a fit; what :func:`loi_core.fit` calls."""
        more = {"gradient norm": step.gradient_norm, "rate": step.rate, "stage": float(step.stage)}
        self.step(step.step, step.value, image, params=step.params, **more)

    def step(
        self,
        step: int,
        value: Any,
        image: Images | None = None,
        *,
        params: Mapping[str, Array] | None = None,
        **scalars: Any,
    ) -> None:
        """Write a step of any loop.

        Parameters
        ----------
        step : int
            Counted from 0.
        value : float or array, shape ()
            The objective.
        image : array, shape (H, W, C), or dict of arrays
            Written every `every` steps; of several views, by their names.
        params : dict of arrays
            Written if they are 16 numbers or fewer.
        **scalars : float or array, shape ()
            More curves, by their names.
        """
        for name, number in {"value": value, **scalars}.items():
            self._writer.add_scalar(f"fit/{name}", _number(number), step)
        self._write_parameters(params or {}, step)
        if image is not None and step % self._every == 0:
            self._write_reference(step)
            for view, one in by_view(image).items():
                self._write_image(f"image/{view}" if view else "image", view, one, step)
            self._write_scales(image, step)

    def result(self, result: FitResult) -> None:
        """Write what came of a fit: the verdict, the numbers and the parameters as text, and the image found."""
        lines = [f"**{result.diagnosis or 'cut short'}**", f"best value {result.best_value:.6g}"]
        lines += [] if result.psnr is None else [f"PSNR {result.psnr:.2f} dB"]
        lines += [f"{name}: {numbers(np.asarray(to_numpy(result.best_params[name])))}" for name in result.rates]
        self._writer.add_text("verdict", "\n\n".join(lines), len(result.history))
        for view, one in by_view(result.image).items():
            self._write_image(f"found/{view}" if view else "found", view, one, result.best_step)

    def _write_parameters(self, params: Mapping[str, Array], step: int) -> None:
        host = {name: np.asarray(to_numpy(value)) for name, value in params.items()}
        if sum(value.size for value in host.values()) > MOST_PARAMETERS:
            return
        for name, value in host.items():
            for index in np.ndindex(value.shape):
                place = "".join(f"[{one}]" for one in index)
                self._writer.add_scalar(f"parameters/{name}{place}", float(value[index]), step)

    def _write_reference(self, step: int) -> None:
        if not self._has_reference and isinstance(self._objective, ImageObjective | TiledLOIObjective):
            self._has_reference = True
            self._write_image("reference", "", self._objective.reference, step)

    def _write_image(self, tag: str, view: str, image: Array, step: int) -> None:
        axis = self._objective.channel_axis if isinstance(self._objective, ImageObjective) else "unknown"
        pixels = shown_pixels(image, axis)
        if pixels is not None:
            display = self._displays.setdefault(view, Display.of(pixels, None))
            self._writer.add_image(tag, display.show(pixels), step, dataformats="HWC")

    def _write_scales(self, image: Images, step: int) -> None:
        if isinstance(image, Mapping) or not isinstance(self._objective, LOIObjective | TiledLOIObjective):
            return
        for (alpha, beta, sigma), term in self._objective.terms(detached(image)).items():
            tag = f"scales/sigma {sigma:g}, alpha {alpha:g}, beta {beta:g}"
            self._writer.add_scalar(tag, _number(term), step)


def _number(value: Any) -> float:
    """The number that an array of any library holds."""
    return float(np.asarray(to_numpy(value)).item())
