"""The loss of an image, or between two, scale by scale: maps, gradients, histograms and reach on one page."""

from loi_core.inspection.findings import Findings, inspect_pair
from loi_core.inspection.page import write_inspection
from loi_core.inspection.pair import Pair, make_pair, read_pair

__all__ = ["Findings", "Pair", "inspect_pair", "make_pair", "read_pair", "write_inspection"]
