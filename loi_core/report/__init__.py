"""Results as files: parameters, histories, pictures, and one page that shows them."""

from loi_core.report.output import write_results
from loi_core.report.page import write_index, write_page

__all__ = ["write_index", "write_page", "write_results"]
