"""The verdict as a page for the experimenter."""

from slipstitch.criticise.report.page import page

__all__ = ["page"]
