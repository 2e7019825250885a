"""A misspelt keyword is answered by the name that it means, as a misspelt key of a scene file is."""

from __future__ import annotations

import doctest
import inspect
import pickle
from collections.abc import Callable
from typing import Any

import pytest

import loi_core
from loi_core import Free, LOIObjective, ScaleSpace, fit, loi_loss, read_target
from loi_core.errors import UnknownOptionError
from loi_core.renderers import BlurredRenderer, Disks, Warp
from tests.frameworks import loi_torch, torch
from tests.public_names import PACKAGES

CALLS: list[tuple[Callable[..., Any], str, str]] = [
    (fit, "lr", "`learning_rate`"),
    (fit, "optimize", "`optimise`"),
    (fit, "n_iter", "`steps`"),
    (loi_loss, "mask", "`weights`"),
    (loi_loss, "channels_axis", "`channel_axis`"),
    (LOIObjective, "mask", "`weights`"),
    (LOIObjective, "target", "`reference`"),
    (loi_core.PixelL2, "nan_polcy", "`nan_policy`"),
    (loi_core.GaussianPyramid, "level", "`levels`"),
    (loi_core.MSSSIM, "mask", "`weights`"),
    (ScaleSpace, "sigmas", "`sigma`"),
    (Free, "bounds", "`lower` and `upper`"),
    (Free, "init", "`initial`"),
    (loi_core.FarToNear, "stage", "`stages`"),
    (read_target, "mask", "`weights`"),
    (Disks, "colors", "`colours`"),
    (Warp, "translate", "`translation`"),
    (BlurredRenderer, "name", "`names`"),
    (ScaleSpace.for_image, "bound", "`bounds`"),
]

RESULTS = {
    "Allowed",
    "Diagnosis",
    "Drawing",
    "Evaluation",
    "FitResult",
    "FitStep",
    "HardCase",
    "LinearExposure",
    "ReferencePlanes",
    "RunResult",
    "SceneParameter",
    "StabilityRow",
    "Standing",
    "SweepResult",
    "Verification",
}  # made by the library, not by its users


def takes_keywords(subject: Any) -> bool:
    """Return whether users call a public object with several arguments, without options that it passes on."""
    if not callable(subject) or not subject.__module__.startswith("loi_") or subject.__name__ in RESULTS:
        return False
    if inspect.isabstract(subject) or getattr(subject, "_is_protocol", False):
        return False
    if inspect.isclass(subject) and issubclass(subject, BaseException):
        return False
    parameters = inspect.signature(subject).parameters.values()
    return len(parameters) > 1 and all(parameter.kind is not parameter.VAR_KEYWORD for parameter in parameters)


@pytest.mark.parametrize("package", [package for package in PACKAGES if package.startswith("loi_")])
def test_every_public_function_and_class_guesses_keywords(package: str) -> None:
    module = pytest.importorskip(package)
    subjects = [getattr(module, name) for name in module.__all__ if takes_keywords(getattr(module, name))]
    assert subjects
    for subject in subjects:
        with pytest.raises(UnknownOptionError, match=rf"^{subject.__name__}\(\) takes no keyword `qwerty`"):
            subject(qwerty=1)


@pytest.mark.parametrize(("function", "keyword", "meaning"), CALLS)
def test_a_misspelt_keyword_is_answered_by_its_meaning(
    function: Callable[..., Any], keyword: str, meaning: str
) -> None:
    with pytest.raises(UnknownOptionError, match=rf"`{keyword}`; did you mean {meaning}\?"):
        function(**{keyword: 1})


def test_a_keyword_without_a_likely_meaning_is_answered_by_all_keywords() -> None:
    with pytest.raises(TypeError, match=r"Free\(\) takes no keyword `qwerty`; known are initial, lower, upper"):
        Free(qwerty=1)  # type: ignore[call-arg]


def test_a_missing_argument_is_named_by_python() -> None:
    with pytest.raises(TypeError, match="missing 1 required positional argument: 'reference'"):
        LOIObjective(weights=None)  # type: ignore[call-arg]


@pytest.mark.parametrize("name", ["loi_loss", "LOILoss", "TorchObjective"])
def test_misspelt_keywords_on_torch_are_answered_by_their_meaning(name: str) -> None:
    with pytest.raises(UnknownOptionError, match=r"did you mean `channel_axis`\?"):
        getattr(loi_torch, name)(channels_first=True)


def test_a_misspelt_option_of_an_optimiser_of_torch_is_answered_by_its_meaning() -> None:
    with pytest.raises(UnknownOptionError, match="SGD takes no option `momentun`; did you mean `momentum`"):
        loi_torch.TorchOptimiser(torch.optim.SGD, momentun=0.9)


def test_functions_with_guesses_keep_their_signature_and_can_be_pickled() -> None:
    assert list(inspect.signature(fit).parameters)[:2] == ["renderer", "objective"]
    assert list(inspect.signature(Free).parameters) == ["initial", "lower", "upper", "learning_rate"]
    assert pickle.loads(pickle.dumps(loi_loss)) is loi_loss  # noqa: S301


def test_the_examples_of_functions_with_guesses_run() -> None:
    original = inspect.unwrap(loi_loss)  # doctest overlooks functions that are wrapped elsewhere
    (examples,) = doctest.DocTestFinder(recurse=False).find(original, "loi_loss", globs=original.__globals__)
    assert examples.examples
    assert doctest.DocTestRunner().run(examples).failed == 0
