"""The verdict as a page for the experimenter."""

from slipstitch.criticise.report.markdown import markdown
from slipstitch.criticise.report.verdict_page import left_over, page

__all__ = ["left_over", "markdown", "page"]
