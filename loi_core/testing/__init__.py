"""The conformance kit, which tells whether a renderer or an objective keeps the contract.

>>> from loi_core.renderers import Disks
>>> from loi_core.testing import check_renderer
>>> check_renderer(Disks(16, 16, [[5.3, 9.1]], 3.0, [[1.0, 0.5, 0.2]]))
"""

from loi_core.errors import ConformanceError
from loi_core.testing.bounds import Allowed, allowed
from loi_core.testing.case import HardCase
from loi_core.testing.cases import hard_cases
from loi_core.testing.direct import direct
from loi_core.testing.objectives import OBJECTIVE_CHECKS, ObjectiveSubject, check_objective
from loi_core.testing.pytest import parametrize_with_checks
from loi_core.testing.renderers import RENDERER_CHECKS, RendererSubject, check_renderer
from loi_core.testing.stability import PROPERTIES, StabilityProperty, StabilityRow, stability_rows

__all__ = [
    "OBJECTIVE_CHECKS",
    "PROPERTIES",
    "RENDERER_CHECKS",
    "Allowed",
    "ConformanceError",
    "HardCase",
    "ObjectiveSubject",
    "RendererSubject",
    "StabilityProperty",
    "StabilityRow",
    "allowed",
    "check_objective",
    "check_renderer",
    "direct",
    "hard_cases",
    "parametrize_with_checks",
    "stability_rows",
]
