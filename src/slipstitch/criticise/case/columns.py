"""The columns of every table of a case: unit in the name, allowed range, what may be empty."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Column:
    """One column; a text column has no range, ``choices`` limits it."""

    name: str
    lower: float = float("-inf")
    upper: float = float("inf")
    may_be_empty: bool = True
    text: bool = False
    choices: tuple[str, ...] = ()

    @property
    def allowed(self) -> str:
        """The allowed values in words."""
        if self.choices:
            return " or ".join(f"'{choice}'" for choice in self.choices)
        return f"a number from {self.lower:g} to {self.upper:g}"


def _text(name, may_be_empty=True, choices=()):
    return Column(name, may_be_empty=may_be_empty, text=True, choices=choices)


def _number(name, lower, upper, may_be_empty=False):
    return Column(name, lower, upper, may_be_empty)


_ANGLE = (-360.0, 360.0)
_COMMON = (
    _text("run_id", may_be_empty=False),
    _text("specimen_id"),
    _number("clock_min", -1e6, 1e6, True),
    _number("repeat_index", 0, 1e5, True),
    _number("orientation_deg", *_ANGLE, True),
    _number("dwell_s", 0, 1e7, True),
    _number("rh_pct", 0, 100, True),
    _number("pos_x_mm", -1e5, 1e5, True),
    _text("operator"),
)

INCLINE = (
    *_COMMON,
    _number("azimuth_deg", *_ANGLE, True),
    _number("area_cm2", 1e-3, 1e5, True),
    _number("added_mass_g", 0, 1e5, True),
    _number("angle_deg", -10, 90),
    _number("u_angle_deg", 1e-4, 20),
    _number("censored", 0, 1),
)
STRIP = (
    *_COMMON,
    _number("azimuth_deg", *_ANGLE, True),
    _number("length_mm", 1, 1e4),
    _number("width_mm", 0.1, 1e4),
    _number("ply", 1, 100),
    _number("push_speed_mm_s", 0, 1e4, True),
    _number("eps_slip", -0.2, 1.0),
    _number("u_eps", 1e-6, 0.5),
    _text("regime", may_be_empty=False, choices=("slipped", "partial")),
)
DRAG_RUNS = (
    *_COMMON,
    _number("stage_azimuth_deg", *_ANGLE, True),
    _number("area_cm2", 1e-3, 1e5),
    _number("added_mass_g", 0, 1e5),
    _number("speed_mm_s", 1e-6, 1e4, True),
    _number("u_force_mN", 1e-6, 1e5),
)
DRAG = (
    _text("run_id", may_be_empty=False),
    _number("stroke", 0, 1),
    _number("t_s", -1e7, 1e7, True),
    _number("x_stage_mm", -1e5, 1e5),
    _number("v_mm_s", -1e4, 1e4, True),
    _number("force_mN", -1e7, 1e7),
)
DROP_DRAG_RUNS = (
    *_COMMON,
    _number("stage_azimuth_deg", *_ANGLE, True),
    _number("height_mm", 1, 1e4),
    _number("speed_mm_s", 1e-6, 1e4, True),
    _number("u_pos_mm", 1e-6, 1e3),
)
DROP_DRAG = (
    _text("run_id", may_be_empty=False),
    _number("frame", 0, 1e9, True),
    _text("phase", may_be_empty=False, choices=("fwd", "rev")),
    _number("t_s", -1e7, 1e7, True),
    _number("x_stage_mm", -1e5, 1e5),
    _number("te_x_mm", -1e5, 1e5),
    _number("contact_len_mm", -1e5, 1e5),
)

SPRING_SLIDER_RUNS = (
    *_COMMON,
    _number("stage_azimuth_deg", *_ANGLE, True),
    _number("area_cm2", 1e-3, 1e5, True),
    _number("added_mass_g", 0, 1e5),
    _number("spring_N_m", 1e-3, 1e7),
    _number("speed_mm_s", 1e-6, 1e4),
    _number("u_force_mN", 1e-6, 1e5),
)
SPRING_SLIDER = (
    _text("run_id", may_be_empty=False),
    _number("t_s", -1e7, 1e7),
    _number("force_mN", -1e7, 1e7),
)

# protocol -> its tables: the one with a row a run, and that with its traces, if any
PROTOCOL_TABLES: dict[str, dict[str, tuple[Column, ...]]] = {
    "incline": {"incline": INCLINE},
    "strip": {"strip": STRIP},
    "drag": {"drag_runs": DRAG_RUNS, "drag": DRAG},
    "drop_drag": {"drop_drag_runs": DROP_DRAG_RUNS, "drop_drag": DROP_DRAG},
    "spring_slider": {"spring_slider_runs": SPRING_SLIDER_RUNS, "spring_slider": SPRING_SLIDER},
}
NOMINAL_KEYS: dict[str, tuple[str, ...]] = {
    "incline": ("rho_kg_m2",),
    "strip": ("rho_kg_m2", "B_strip_Nm", "ply_exponent", "thickness_m"),
    "drag": ("rho_kg_m2", "k_tether_N_m"),
    "drop_drag": ("rho_kg_m2", "B_Nm", "cloth_length_m"),
    "spring_slider": (),
}
