"""Results as files: parameters, histories, pictures, and one page that shows them."""

from loi_core.report.output import write_results
from loi_core.report.page import write_index, write_page
from loi_core.report.running import RunningPage
from loi_core.report.tradeoff import tradeoff_lines, write_tradeoff

__all__ = ["RunningPage", "tradeoff_lines", "write_index", "write_page", "write_results", "write_tradeoff"]
