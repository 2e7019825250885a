"""A fit that TensorBoard shows: ``python -m examples.loops.with_tensorboard``, then ``tensorboard --logdir runs``."""

import numpy as np
from torch.utils.tensorboard import SummaryWriter  # needs: pip install tensorboard

from loi_core import FitStep, Free, LOIObjective, Parameters, fit
from loi_core.renderers import Disks

renderer = Disks(64, 96, positions=[[75.0, 45.0]], radii=8.0, colours=[[1.0, 0.6, 0.1]])
objective = LOIObjective(renderer.render(renderer.parameters()))

with SummaryWriter("runs/disks") as writer:

    def write(step: FitStep, _: Parameters, image: np.ndarray) -> None:
        """Write the curves of every step, and every 25th image."""
        writer.add_scalar("value", step.value, step.step)
        writer.add_scalar("gradient norm", step.gradient_norm, step.step)
        for name, value in step.params.items():
            writer.add_scalars(name, {str(k): number for k, number in enumerate(value.ravel())}, step.step)
        if step.step % 25 == 0:
            writer.add_image("image", np.clip(image, 0.0, 1.0), step.step, dataformats="HWC")

    start = Free(initial=[[15.0, 15.0]], lower=0.0, upper=96.0)
    result = fit(renderer, objective, optimise={"positions": start}, callback=write)
    writer.add_text("verdict", str(result.diagnosis))

print(*result.best_params["positions"][0].round(1))
