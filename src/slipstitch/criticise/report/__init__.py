"""The verdict as a page for the experimenter."""

from slipstitch.criticise.report.markdown import markdown
from slipstitch.criticise.report.verdict_page import page

__all__ = ["markdown", "page"]
