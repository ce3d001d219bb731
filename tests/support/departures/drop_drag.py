"""Cloth hanging from a moving clamp on to the substrate: planar elastica, quasi-static steps.

Lengths in units of the clamp's height h, forces a width in w h (w: weight an area). From the
touchdown the lifted part obeys ``beta theta'' = H(s) sin(theta) - V(s) cos(theta)`` with
``V = s - R0`` and ``H = H0 - q s`` (q: share of the weight that leans along the drag), moment-free
at both ends; R0 is the point load under the touchdown.
"""

from functools import lru_cache

import numpy as np
from scipy.interpolate import CubicSpline

from support.departures.laws import GRAVITY_M_S2, friction_limit, tilt_of
from support.departures.strip import chebyshev

NODES = 32
FIFTHS = np.array([[0.1], [0.3], [0.5], [0.7], [0.9]])  # middles of five parts of the contact


@lru_cache(maxsize=4096)
def lifted(beta, lean):
    """(H0, length, span, R0) of the lifted part, from no tension upwards; arrays."""
    s, D, w = chebyshev(NODES)
    D2, n = D @ D, NODES
    tensions = np.concatenate([[6.0, 4.5, 3.3, 2.5], np.geomspace(1.9, 0.02, 26), [0.01, 0.0]])
    # A catenary of the strongest tension to begin with.
    H = tensions[0]
    length = np.sqrt(1 + 2 * H)
    theta, R0 = np.arctan(s * length / H), 0.05
    theta *= np.minimum(1, s / 0.1)
    stiff = max(beta, 0.05)
    for value in np.geomspace(stiff, beta, 2 + int(4 * np.log10(stiff / beta))):
        theta, length, R0 = _shape(theta, length, R0, H, value, lean, s, D, D2, w, n)
    rows, before = [], None
    for i, H in enumerate(tensions):
        guess = (theta, length, R0)
        if before is not None and i > 4:
            share = (H - tensions[i - 1]) / (tensions[i - 1] - tensions[i - 2])
            guess = tuple(a + share * (a - b) for a, b in zip(guess, before, strict=True))
        before = (theta, length, R0)
        theta, length, R0 = _shape(*guess, H, beta, lean, s, D, D2, w, n)
        rows.append((H, length, length * (w @ np.cos(theta)), R0))
    return np.array(rows[::-1]).T


def _shape(theta, length, R0, H0, beta, lean, s, D, D2, w, n):
    for _ in range(60):
        sin, cos = np.sin(theta), np.cos(theta)
        pull, lift = H0 - lean * length * s, length * s - R0
        residual = np.empty(n + 3)
        residual[: n + 1] = beta * (D2 @ theta) - length**2 * (pull * sin - lift * cos)
        residual[0], residual[n] = theta[0], D[n] @ theta
        residual[n + 1], residual[n + 2] = D[0] @ theta, length * (w @ sin) - 1
        jacobian = np.zeros((n + 3, n + 3))
        jacobian[: n + 1, : n + 1] = beta * D2 - np.diag(length**2 * (pull * cos + lift * sin))
        jacobian[: n + 1, n + 1] = -2 * length * (pull * sin - lift * cos) - length**2 * (
            -lean * s * sin - s * cos
        )
        jacobian[: n + 1, n + 2] = -(length**2) * cos
        for row, line in ((0, np.eye(n + 1)[0]), (n, D[n])):
            jacobian[row, : n + 1], jacobian[row, n + 1 :] = line, 0.0
        jacobian[n + 1] = np.append(D[0], [0.0, 0.0])
        jacobian[n + 2] = np.concatenate([length * w * cos, [w @ sin, 0.0]])
        step = np.linalg.solve(jacobian, residual)
        damp = min(1.0, 0.5 / np.abs(step).max())
        theta, length, R0 = theta - damp * step[:-2], length - damp * step[-2], R0 - damp * step[-1]
        if np.abs(step).max() < 1e-9:
            return theta, length, R0
    raise ArithmeticError(f"no shape of the cloth at beta {beta}, tension {H0}")


class Cloth:
    """Tension, contact length and point load of one run's cloth by gap, clamp less edge (m)."""

    def __init__(self, height_m, lean, effects, nominal):
        rho = nominal["rho_kg_m2"] * (1 + effects.get("mass_error", {}).get("mass_error", 0.0))
        rigidity = nominal["B_Nm"] * (1 + effects.get("bending_error", {}).get("bending_error", 0))
        self.weight = rho * GRAVITY_M_S2 * np.cos(lean)  # N/m^2, across the floor
        beta = rigidity / (self.weight * height_m**3)
        H, length, span, R0 = lifted(float(f"{beta:.8g}"), float(f"{np.tan(lean):.8g}"))
        fine = np.concatenate([np.linspace(0, 0.05, 60), np.geomspace(0.0505, H[-1], 500)])
        # In this root of the tension all of these are smooth.
        length, span, R0 = (
            CubicSpline(np.sqrt(H + 0.05), y)(np.sqrt(fine + 0.05)) for y in (length, span, R0)
        )
        self.tension = fine * self.weight * height_m  # N/m
        self.contact = nominal["cloth_length_m"] - length * height_m
        self.gap = self.contact + span * height_m
        self.point = R0 * self.weight * height_m  # N/m
        self.lean = np.tan(lean) * self.weight

    def gap_where_it_gives(self, row, coefficient, effects, track, moving, edge_mm):
        """Gap (m) at which pull and friction of the part that lies are in balance."""
        contact = np.maximum(self.contact, 1e-6)
        spots = row["place_mm"] + edge_mm + 1e3 * contact * FIFTHS
        values = row | {
            "load_N": self.weight * contact + self.point,
            "area_m2": contact,
            "place_mm": spots,
        }
        friction = friction_limit(values, coefficient, effects, moving)
        factor = np.ones_like(spots) if track is None else track(spots)
        friction = np.mean(friction * factor, axis=0)
        left = friction - self.tension - self.lean * contact
        over = np.argmax(left < 0) if (left < 0).any() else len(left) - 1
        if over == 0:
            return self.gap[0]
        share = left[over - 1] / (left[over - 1] - left[over])
        return self.gap[over - 1] + min(share, 1.0) * (self.gap[over] - self.gap[over - 1])


def runs(rows, coefficient, effects, nominal, travel_mm, back_mm, step_mm, track=None):
    """Trailing edge and contact length along the drag, then over the start of the way back.

    Returns
    -------
    dict
        ``stage_mm`` (steps,), ``back`` (steps,), ``edge_mm`` and ``contact_mm`` (steps, runs), edge
        from its start, in true lengths; ``first_mm`` (runs,): the stage at the first motion.
    """
    tilt, towards = tilt_of(effects, rows["azimuth_deg"])
    leans = np.arctan(np.tan(np.radians(tilt)) * towards)
    out = np.arange(round(travel_mm / step_mm) + 1) * step_mm
    rev = travel_mm - np.arange(1, round(back_mm / step_mm) + 1) * step_mm
    stage = np.concatenate([out, rev])
    number = len(leans)
    edge, contact = np.zeros((len(stage), number)), np.empty((len(stage), number))
    first = np.empty(number)
    uneven = track is not None or {"patch", "periodic"} & set(effects)
    cloths = {}
    for j in range(number):
        key = (rows["height_m"][j], leans[j])
        if key not in cloths:
            cloths[key] = Cloth(*key, effects, nominal)
        cloth = cloths[key]
        one = {k: (v[j] if np.ndim(v) else v) for k, v in rows.items()}
        law = (one, coefficient[j], effects, track)
        held = (cloth.gap_where_it_gives(*law, False, 0.0) - cloth.gap[0]) * 1e3
        sliding = (cloth.gap_where_it_gives(*law, True, 0.0) - cloth.gap[0]) * 1e3
        first[j] = held
        x = 0.0
        for i in np.flatnonzero(out > held):
            if uneven:
                sliding = (cloth.gap_where_it_gives(*law, True, x) - cloth.gap[0]) * 1e3
            x = max(x, out[i] - sliding)
            edge[i, j] = x
        edge[len(out) :, j] = x
        gap = cloth.gap[0] + (stage - edge[:, j]) * 1e-3
        contact[:, j] = np.interp(gap, cloth.gap, cloth.contact) * 1e3
    back = np.repeat([False, True], [len(out), len(rev)])
    found = {"stage_mm": stage, "back": back, "edge_mm": edge}
    return found | {"contact_mm": contact, "first_mm": first}


WINDOWS, START_MM = 3, 8.0


def features(rows, coefficient, effects, nominal, travel_mm, track=None):
    """Exact expectation of lag and contact length in three windows, first motion, first contact.

    All in mm; the first contact is the mean over the start of the way, where every cloth sticks.
    """
    trace = runs(rows, coefficient, effects, nominal, travel_mm, 0.0, 2.0, track)
    scale = effects.get("camera_scale", {}).get("camera_scale", 1.0)
    delay = effects.get("time_lag", {}).get("time_lag", 0.0) * rows["speed_mm_s"]
    stage = trace["stage_mm"][:, None]
    late = slice(int(0.55 * len(stage)), None)
    lag = (stage - scale * (trace["edge_mm"] - delay))[late]
    contact = scale * trace["contact_mm"][late]
    columns = [part.mean(axis=0) for part in np.array_split(lag, WINDOWS)]
    columns += [part.mean(axis=0) for part in np.array_split(contact, WINDOWS)]
    columns.append(trace["first_mm"] + delay)
    columns.append(scale * trace["contact_mm"][stage[:, 0] <= START_MM].mean(axis=0))
    return np.array(columns).T


def noise(rows, travel_mm, frame_mm, u_mm):
    """Standard deviations of those features."""
    frames = 0.45 * travel_mm / frame_mm / WINDOWS
    mean = np.full(len(rows["height_m"]), u_mm / np.sqrt(frames))
    first = np.full(len(mean), np.hypot(u_mm, frame_mm / np.sqrt(12)))
    return np.array([mean] * (2 * WINDOWS) + [first]).T
