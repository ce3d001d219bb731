"""A second bench for the criticism: other numerics, honest faults, laws that no library holds.

It shares neither formula nor constant with the package ``slipstitch``: all is derived anew from
docs/criticise-your-data.md.
"""

from support.departures.campaign import FAMILIES, draw_plan, make_case, planted

__all__ = ["FAMILIES", "draw_plan", "make_case", "planted"]
