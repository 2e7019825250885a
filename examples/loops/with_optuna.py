"""Settings of a fit by Optuna, with pruned trials: ``python -m examples.loops.with_optuna``."""

import numpy as np
import optuna  # needs: pip install optuna

from loi_core import FitStep, Free, LOIObjective, Parameters, PixelL2, ScaleSpace, fit
from loi_core.renderers import Disks

renderer = Disks(48, 64, positions=[[50.0, 30.0]], radii=6.0, colours=[[1.0, 0.6, 0.1]])
photograph = renderer.render(renderer.parameters())
free = {"positions": Free([[10.0, 10.0]], lower=0.0, upper=64.0)}


def misfit(trial: optuna.Trial) -> float:
    """Return the mean squared difference that a fit with the settings of a trial leaves."""
    scales = ScaleSpace(1.0, trial.suggest_float("alpha", 1.0, 30.0), beta=0.125)
    rate = trial.suggest_float("rate", 0.2, 5.0, log=True)

    def prune(step: FitStep, _: Parameters, image: np.ndarray) -> bool:
        """End the fit of a trial that falls behind, by a value that trials with other scales have as well."""
        trial.report(float(PixelL2(photograph).value(image)), step.step)
        return step.step >= 10 and trial.should_prune()

    result = fit(
        renderer, LOIObjective(photograph, scales), steps=40, learning_rate=rate, optimise=free, callback=prune
    )
    if len(result.history) < 40:
        raise optuna.TrialPruned
    return float(PixelL2(photograph).value(result.image))


study = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=0))
study.optimize(misfit, n_trials=20)
print(study.best_params, study.best_value)
