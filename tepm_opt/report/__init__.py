"""Self-contained HTML pages of what jobs found."""

from tepm_opt.report.pages import write_discrepancy_page, write_page
from tepm_opt.report.paper import write_paper_page

__all__ = ["write_discrepancy_page", "write_page", "write_paper_page"]
