"""The conformance kit as pytest parameters."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from loi_core.errors import OptionError
from loi_core.testing.objectives import OBJECTIVE_CHECKS, ObjectiveSubject
from loi_core.testing.renderers import RENDERER_CHECKS, RendererSubject

__all__ = ["parametrize_with_checks"]


def parametrize_with_checks(subjects: Iterable[RendererSubject | ObjectiveSubject]) -> Callable[[Any], Any]:
    """Make one test per subject and check of a function that takes ``check`` and ``subject``.

    Parameters
    ----------
    subjects : iterable of RendererSubject or ObjectiveSubject
        At least one.

    Examples
    --------
    ::

        @parametrize_with_checks([RendererSubject(MyRenderer())])
        def test_contract(check, subject):
            check(subject)
    """
    import pytest

    cases = []
    for number, subject in enumerate(subjects):
        checks: tuple[Any, ...] = RENDERER_CHECKS if isinstance(subject, RendererSubject) else OBJECTIVE_CHECKS
        what = type(subject.renderer).__name__ if isinstance(subject, RendererSubject) else "objective"
        cases += [pytest.param(check, subject, id=f"{number}-{what}-{check.name}") for check in checks]
    if not cases:
        msg = "`subjects` must hold at least one subject, got none"
        raise OptionError(msg)
    return pytest.mark.parametrize(("check", "subject"), cases)
