"""Reading and checking a case folder."""

from slipstitch.criticise.case.reader import Case, read_case

__all__ = ["Case", "read_case"]
