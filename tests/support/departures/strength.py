"""How strongly a hidden effect shows: exact expected shifts over noise and scatter."""

import numpy as np

from support.departures import drag, drop_drag, incline, spring_slider, strip
from support.departures.design import rows_of
from support.departures.laws import scaled, share_of

# Effects that leave no trace in a protocol; of the others each is evaluated.
_CELL = ("incline", "strip", "drop_drag", "spring_slider")
NO_TRACE_IN = {
    "force_offset": _CELL,
    "force_gain": _CELL,
    "backlash": _CELL,
    "time_lag": ("incline", "strip", "drag", "spring_slider"),
    "camera_scale": ("incline", "drag", "spring_slider"),
    "bending_error": ("incline", "drag", "spring_slider"),
    "rate": ("incline", "strip"),
    "stribeck": ("incline", "strip"),
}
STROKE_MM, TRAVEL_MM, BACK_MM, SLIDE_MM = 50.0, 130.0, 14.0, 30.0


def rows(plan, protocol):
    """The protocol's runs in SI."""
    values = rows_of(plan.tables[protocol], protocol, plan.nominal["rho_kg_m2"])
    if protocol == "strip":
        values["area_m2"] = values["width_m"] * plan.nominal["thickness_m"]
    if protocol == "spring_slider":
        values["travel_mm"] = np.full(len(values["dwell_s"]), SLIDE_MM)
    return values


def expectation(plan, protocol, effects, shift=0.0):
    """Noise-free features (runs, features); NaN where nothing is read. ``shift``: of log mu."""
    seen = {k: v for k, v in effects.items() if protocol not in NO_TRACE_IN.get(k, ())}
    key = (protocol, repr(sorted(seen.items())), round(shift, 12))
    if key not in plan.known:
        plan.known[key] = _expectation(plan, protocol, seen, shift)
    return plan.known[key]


def _expectation(plan, protocol, effects, shift):
    table, track = rows(plan, protocol), plan.tracks.get(protocol)
    edge = protocol == "strip"
    mu = np.exp(np.log(plan.mu_edge if edge else plan.mu_face) + shift)
    mu = np.full(len(table["dwell_s"]), mu)
    if protocol == "incline":
        factor = 1.0 if track is None else track(table["place_mm"])
        angle = incline.slip_angle_deg(
            table, mu * factor, effects, plan.nominal["rho_kg_m2"], steps=45
        )
        return np.where(angle > 60, np.nan, angle)[:, None]
    if edge:
        strain, slipped = strip.slip_strain(table, mu, effects, plan.nominal)
        return np.where(slipped, strain, np.nan)[:, None]
    if protocol == "drag":
        return drag.features(table, mu, effects, plan.nominal, STROKE_MM, track=track)
    if protocol == "drop_drag":
        return drop_drag.features(table, mu, effects, plan.nominal, TRAVEL_MM, track=track)
    forces = drag.loads(table, effects, plan.nominal["rho_kg_m2"])
    return spring_slider.levels(table, mu, effects, forces, track)


def noise(plan, protocol):
    """True standard deviations of those features, scatter not included."""
    table, level = rows(plan, protocol), plan.noise[protocol] * plan.understated
    grain, grain_mm = plan.grain
    if protocol in ("incline", "strip"):
        return np.full((len(table["dwell_s"]), 1), level)
    if protocol == "drag":
        return drag.noise(
            table, plan.mu_face, plan.nominal, STROKE_MM, plan.sampling_mm, level, grain, grain_mm
        )
    if protocol == "drop_drag":
        return drop_drag.noise(table, TRAVEL_MM, plan.frame_mm, level)
    forces = drag.loads(table, {}, plan.nominal["rho_kg_m2"])
    return spring_slider.noise(table, plan.mu_face, forces, level, grain)


class Metric:
    """Whitening by noise, run and specimen; the features of all protocols as one vector."""

    def __init__(self, plan, effects):
        self.plan, self.step = plan, 0.01
        self.blocks = []
        for protocol in plan.protocols:
            base = expectation(plan, protocol, effects)
            moved = expectation(plan, protocol, effects, self.step)
            slope = ((moved - base) / self.step).ravel()
            good = np.isfinite(slope)
            slope = np.where(good, slope, 0.0)
            sd = noise(plan, protocol).ravel()
            each = base.shape[1]
            run = np.repeat(np.arange(base.shape[0]), each)
            specimen = np.repeat(
                np.unique(plan.tables[protocol]["specimen_id"], return_inverse=True)[1], each
            )
            between, within = plan.scatter[protocol]
            same_run = run[:, None] == run[None, :]
            same_specimen = specimen[:, None] == specimen[None, :]
            covariance = np.diag(sd**2) + np.outer(slope, slope) * (
                within**2 * same_run + between**2 * same_specimen
            )
            self.blocks.append((protocol, good, np.linalg.cholesky(covariance[np.ix_(good, good)])))

    def vector(self, effects, face=0.0, edge=0.0):
        """Whitened expectation; NaN where these effects leave nothing to read."""
        parts = []
        for protocol, good, root in self.blocks:
            shift = edge if protocol == "strip" else face
            y = expectation(self.plan, protocol, effects, shift).ravel()[good]
            lost = ~np.isfinite(y)
            part = np.linalg.solve(root, np.where(lost, 0.0, y))
            part[lost] = np.nan
            parts.append(part)
        return np.concatenate(parts)


def _columns(metric, base, effects, name, face, edge):
    """Derivatives by a mechanism's share of its reference (the tilt: along and across)."""
    small, columns = 0.08, []
    for azimuth in (0.0, 90.0) if name == "tilt" else (None,):
        share = small if name not in effects else share_of(name, effects[name]) + small
        more = scaled(name, share)
        if name in effects:
            more = effects[name] | {name: more[name]}
        elif azimuth is not None:
            more["tilt_azimuth"] = azimuth
        columns.append((metric.vector(effects | {name: more}, face, edge) - base) / small)
    return columns


def best_null(metric, target, effects, rounds=2):
    """(log shifts of the coefficients, whitened expectation, its columns) nearest to ``target``."""
    shifts = np.zeros(2)
    for turn in range(rounds + 1):
        base = metric.vector(effects, *shifts)
        columns = [
            (metric.vector(effects, *(shifts + one)) - base) / metric.step
            for one in metric.step * np.eye(2)
        ]
        if turn < rounds:
            shifts = shifts + np.clip(_solved(target - base, columns)[0], -1, 1)
    return shifts, base, columns


def _solved(left, columns):
    """(least-squares step, chi-square that it leaves)."""
    matrix = np.array(columns).T
    good = np.isfinite(left) & np.isfinite(matrix).all(axis=1)
    step, *_ = np.linalg.lstsq(matrix[good], left[good], rcond=1e-9)
    return step, float(np.sum((left[good] - matrix[good] @ step) ** 2))


def noncentrality(plan, effects):
    """Chi-square of the best null about exact data with ``effects``."""
    metric = Metric(plan, effects)
    target = metric.vector(effects)
    _, base, columns = best_null(metric, target, {})
    return _solved(target - base, columns)[1]


def separation(plan, effects, rivals):
    """Least such chi-square over single wrong mechanisms (linearised at the best null)."""
    metric = Metric(plan, effects)
    target = metric.vector(effects)
    shifts, base, columns = best_null(metric, target, {})
    left = [
        _solved(target - base, columns + _columns(metric, base, {}, name, *shifts))[1]
        for name in rivals
    ]
    return min(left)


def shares_of_pair(plan, effects):
    """For each of two effects: the chi-square that remains if only the other is known."""
    metric = Metric(plan, effects)
    target = metric.vector(effects)
    result = []
    for name in effects:
        others = {k: v for k, v in effects.items() if k != name}
        shifts, base, columns = best_null(metric, target, others)
        for other in others:
            columns = columns + _columns(metric, base, others, other, *shifts)
        result.append(_solved(target - base, columns)[1])
    return result
