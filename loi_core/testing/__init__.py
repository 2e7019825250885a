"""The conformance kit: named checks of the contracts of renderers and objectives.

>>> from loi_core.renderers import Disks
>>> from loi_core.testing import check_renderer
>>> check_renderer(Disks(16, 16, [[5.3, 9.1]], 3.0, [[1.0, 0.5, 0.2]]))
"""

from loi_core.errors import ConformanceError
from loi_core.testing.objectives import OBJECTIVE_CHECKS, ObjectiveSubject, check_objective
from loi_core.testing.pytest import parametrize_with_checks
from loi_core.testing.renderers import RENDERER_CHECKS, RendererSubject, check_renderer

__all__ = [
    "OBJECTIVE_CHECKS",
    "RENDERER_CHECKS",
    "ConformanceError",
    "ObjectiveSubject",
    "RendererSubject",
    "check_objective",
    "check_renderer",
    "parametrize_with_checks",
]
