"""The conformance kit as pytest parameters."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from loi_core.errors import ConformanceError, OptionError
from loi_core.support.keywords import suggest_keywords
from loi_core.testing.objectives import OBJECTIVE_CHECKS, ObjectiveSubject
from loi_core.testing.renderers import RENDERER_CHECKS, RendererSubject

__all__ = ["parametrize_with_checks"]


@suggest_keywords
def parametrize_with_checks(
    subjects: Iterable[RendererSubject | ObjectiveSubject], *, expected_failures: Mapping[str, str] | None = None
) -> Callable[[Any], Any]:
    """Return a decorator that runs a test with arguments ``check`` and ``subject`` for all checks of all subjects.

    Parameters
    ----------
    subjects : iterable of RendererSubject or ObjectiveSubject
        At least one.
    expected_failures : dict of str, optional
        Names of checks that are known to fail for every subject, with the reason. They are marked as strict expected
        failures, so a check that passes fails the test.

    Raises
    ------
    OptionError
        If there is no subject, or `expected_failures` names a check that none of them has.

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
        label = type(subject.renderer).__name__ if isinstance(subject, RendererSubject) else "objective"
        for check in checks:
            reason = (expected_failures or {}).get(check.name)
            marks = () if reason is None else (pytest.mark.xfail(raises=ConformanceError, strict=True, reason=reason),)
            cases.append(pytest.param(check, subject, id=f"{number}-{label}-{check.name}", marks=marks))
    if not cases:
        msg = "`subjects` must hold at least one subject, got none"
        raise OptionError(msg)
    names = dict.fromkeys(str(case.values[0]) for case in cases)
    for name in expected_failures or {}:
        if name not in names:
            msg = f"`expected_failures` names {name!r}; the checks are {', '.join(names)}"
            raise OptionError(msg)
    return pytest.mark.parametrize(("check", "subject"), cases)
