"""Columns of a case's tables: unit in the name, allowed range, what may be empty."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Column:
    """One column; a text column has no range, ``choices`` limits it.

    What is ``measured`` may be missing in the run table of a design.
    """

    name: str
    lower: float = float("-inf")
    upper: float = float("inf")
    may_be_empty: bool = True
    text: bool = False
    choices: tuple[str, ...] = ()
    measured: bool = False

    @property
    def allowed(self) -> str:
        """The allowed values in words."""
        if self.choices:
            return " or ".join(f"'{choice}'" for choice in self.choices)
        return f"a number from {self.lower:g} to {self.upper:g}"


def text(name, may_be_empty=True, choices=(), measured=False) -> Column:
    """A column of words."""
    return Column(name, may_be_empty=may_be_empty, text=True, choices=choices, measured=measured)


def number(name, lower, upper, may_be_empty=False, measured=False) -> Column:
    """A column of numbers."""
    return Column(name, lower, upper, may_be_empty, measured=measured)


ANGLE_DEG = (-360.0, 360.0)
# Of every table of runs.
RUN_COLUMNS = (
    text("run_id", may_be_empty=False),
    text("specimen_id"),
    number("clock_min", -1e6, 1e6, True),
    number("repeat_index", 0, 1e5, True),
    number("orientation_deg", *ANGLE_DEG, True),
    number("dwell_s", 0, 1e7, True),
    number("rh_pct", 0, 100, True),
    number("pos_x_mm", -1e5, 1e5, True),
    text("operator"),
)
