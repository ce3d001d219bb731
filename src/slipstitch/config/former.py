"""Former keys of the configuration: each became a constant beside its use.

Files and records that name one with the value of the constant are still accepted.
"""

import json
from collections.abc import Mapping
from typing import Any

# Section -> key -> the value of the constant, as JSON has it.
FORMER_KEYS: dict[str, dict[str, Any]] = {
    "train": {
        "architecture": "lrcn",
        "input_scaling": "standardised",
        "padding": "same",
        "readout": "pool",
        "batch_norm": "all",
        "material_units": None,
        "outputs": "last",
        "rho": 0.95,
        "epsilon": 1e-7,
        "gradient_norm_max": None,
        "lstm_units": 256,
        "fc_units": 256,
        "dropout": 0.2,
        "view_order": None,
        "reflective_seeds": [0],
        "annealed_share": 0.05,
        "plateau_epochs": 40,
    },
    "calibrate": {
        "strip_slip_strain": 6e-3,
        "strip_friction": 5e-3,
        "strip_young_moduli_Pa": [6.5e8, 6.5e9],
        "incline_frictions": [0.1, 0.5, 1.2],
        "incline_margin": 1e-3,
        "incline_steep": 1.5,
        "incline_creep_m": 1e-6,
        "incline_acceleration": 1e-3,
        "flat_drag_frictions": [0.1, 0.5, 1.0],
        "flat_drag_pull": 5e-3,
        "strip_drag_frictions": [0.1, 0.3, 0.6, 1.0, 1.5],
        "strip_drag_gravity_length_m": 0.02,
        "strip_drag_pull": 0.01,
        "strip_drag_tail_m": 1e-3,
    },
    "compute": {"batch": 1},
    "grid": {"test_replicates": 1},
    "simulation": {"halvings_max": 12, "bending_stiffness_at_end": ["tango-red-jet-set"]},
    "instrument": {
        "position_channels": 16,
        "components": 3,
        "weight_decay": 0.02,
        "material_weight": 0.1,
        "points_noise_m": 0.0015,
        "points_videos": 32,
        "order_weight": 0.1,
        "coverage": 0.9,
        "false_alarms": 0.05,
        "recurrent_units": 96,
        "friction_step": 0.01,
        "blur_px": 0.7,
        "noise": 0.1,
    },
    "evaluate": {"viewpoints": "training", "friction_step": 0.1, "batch_size": 8},
    "ablate": {"textures_per_simulation": 1},
    "captures": {
        "bench_variation": 1.5,
        "friction_sd_rel": 0.03,
        "frame_rate_hz": 12.0,
        "camera_turn_deg": 2.0,
        "lens_k1": -0.12,
        "camera_error_m": 0.001,
        "exposure_drift_stops": 0.25,
        "colour_cast": 0.06,
        "noise": 0.02,
        "quality_crf": 26,
        "incline_error_deg": 0.3,
        "own_cameras": False,
    },
    "render": {"crop": "follow", "threads": 1},
    "render.interpolation": {"from_friction": 0.4, "fabric": 0.0},
    "render.bench_camera": {
        "yaw_deg": 15.0,
        "pitch_deg": 8.0,
        "distance": 0.2,
        "calibrated_share": 1 / 3,
        "roll_deg": 2.0,
        "aim_m": 0.01,
        "rotation_error_deg": 0.05,
        "position_error_m": 0.001,
        "focal_error": 0.001,
        "start_error_s": 0.02,
    },
    "convergence": {"frame_rate_hz": 12.0, "seed": 0, "mean_distance_m": 1e-3, "halvings": 2},
}
#: Sections of which every key is a former one.
FORMER_SECTIONS = ("evaluate",)


def without_former_keys(section: str, values: Any) -> Any:
    """Return the values of a section, and of sections in it, without former keys.

    FormerKeyError if a former key has another value than the constant that it became.

    Parameters
    ----------
    section : str
        Its name, e.g. ``render``; empty for the whole configuration.
    values
        As read from a file; what is no mapping is returned as it is.
    """
    if not isinstance(values, Mapping):
        return values
    former = FORMER_KEYS.get(section, {})
    kept = {}
    for key, value in values.items():
        name = f"{section}.{key}" if section else key
        if key not in former:
            inner = without_former_keys(name, value)
            if name not in FORMER_SECTIONS or inner:
                kept[key] = inner
        elif json.loads(json.dumps(value)) != former[key]:
            raise FormerKeyError(name, former[key], value)
    return kept


class FormerKeyError(ValueError):
    """A former key with another value than the constant that it became."""

    def __init__(self, name: str, fixed: Any, given: Any):
        fixed, given = json.dumps(fixed), json.dumps(given)
        super().__init__(f"{name}: no longer a key; it is always {fixed}, not {given}")
        self.location = tuple(name.split("."))
