"""How strongly a hidden effect shows: exact expected shifts over noise and scatter.

The noncentrality (lambda) is the chi-square that plain friction leaves of exact data, its
coefficients fitted. What it is conditional on: the scatter between specimens and runs, the track
and the far runs are known; a slip of a drag is only known to lie between two readings. On a sound
bench the noise and every zero of a sensor are known as well. On a bench with faults, the noise is
that of its own sensors, with their tails, rounding and gaps, and every zero, scale, drift and delay
that the catalogue of faults lists for its protocols is open, with a normal prior of its usual size:
only the data tell which sensors are right. The separation and the shares of a pair are conditional
on the same.
"""

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import minimize

from support.departures import drag, drop_drag, incline, spring_slider, strip
from support.departures.design import rows_of
from support.departures.laws import scaled, share_of
from support.departures.sensors import CATALOGUE, Faults, since_middle

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
# Columns that sensors write.
READ = {
    "incline": ("angle_deg",),
    "strip": ("eps_slip",),
    "drag": ("force_mN",),
    "drop_drag": ("te_x_mm", "contact_len_mm"),
    "spring_slider": ("force_mN",),
}
PEAKS = [0, 1 + drag.WINDOWS]
CONTACT_LENGTHS = np.array([0, 0, 0, 1, 1, 1, 0], bool)
# The least error of a location under Student's t of 3 degrees, over its scale.
T3_ERROR = np.sqrt(1.5)
# Uncertainties are stated up to this much too small without that being a fault.
MOST_UNDERSTATED = 1.5


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
    key = (protocol, repr(sorted(seen.items())), round(shift, 12), bool(plan.faults))
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
        both = drop_drag.features(table, mu, effects, plan.nominal, TRAVEL_MM, track=track)
        return both if plan.faults else both[:, :-1]
    forces = drag.loads(table, effects, plan.nominal["rho_kg_m2"])
    return spring_slider.levels(table, mu, effects, forces, track)


def _sensor_noise(plan, protocol, column):
    """True standard deviation of a reading; of the column's own sensor on a bench with faults."""
    faults = Faults(plan.faults, protocol)
    level = plan.noise[protocol] * plan.understated * faults.size(column, "noise", 1.0)
    if faults.size(column, "tails"):
        level = level * T3_ERROR
    level = np.hypot(level, faults.size(column, "quantised") / np.sqrt(12))
    return level / np.sqrt(1 - faults.size("t_s", "dropped"))


def noise(plan, protocol, sampled):
    """True standard deviations of those features, scatter not included; see :class:`Metric`."""
    table = rows(plan, protocol)
    level, *others = (_sensor_noise(plan, protocol, column) for column in READ[protocol])
    grain, grain_mm = plan.grain
    if protocol in ("incline", "strip"):
        return np.full((len(table["dwell_s"]), 1), level)
    if protocol == "drag":
        found = drag.noise(
            table, plan.mu_face, plan.nominal, STROKE_MM, plan.sampling_mm, level, grain, grain_mm
        )
        if sampled:  # the force rises by this much from one reading to the next: where is the peak?
            rise = plan.nominal["k_tether_N_m"] * plan.sampling_mm / np.sqrt(12)
            found[:, PEAKS] = np.hypot(found[:, PEAKS], rise)
        return found
    if protocol == "drop_drag":
        edge, contact = (
            drop_drag.noise(table, TRAVEL_MM, plan.frame_mm, one) for one in (level, *others)
        )
        found = np.where(CONTACT_LENGTHS, contact, edge)
        if not plan.faults:
            return found
        frames = 0.8 * expectation(plan, protocol, {})[:, 6] / plan.frame_mm
        return np.column_stack([found, others[0] / np.sqrt(np.maximum(frames, 1.0))])
    forces = drag.loads(table, {}, plan.nominal["rho_kg_m2"])
    return spring_slider.noise(table, plan.mu_face, forces, level, grain)


def _open_faults(plan, protocol, features):
    """What each fault of usual size does to the features: (quantity, kind) -> (runs, features)."""
    table, found = rows(plan, protocol), {}
    speed, since = table["speed_mm_s"], since_middle(table["clock_min"])
    lengths = [3, 4, 5, 7]  # of the contact in drop-and-drag
    for _, column, kind, low, high, *_ in CATALOGUE[protocol] if plan.faults else ():
        change = np.zeros_like(features)
        if protocol in ("incline", "strip"):
            change += {"zero": 1.0, "scale": features}.get(kind, 0.0)
        elif kind == "drift":
            change[:, : 10 if protocol == "drag" else 1] = since[:, None]
        elif (protocol, kind) == ("drag", "delay"):
            change[:, -1] = speed
        elif (protocol, column, kind) == ("drop_drag", "x_stage_mm", "zero"):
            change[:, [0, 1, 2, 6]] = 1.0
        elif column == "contact_len_mm" and kind in ("zero", "scale"):
            change[:, lengths] = 1.0 if kind == "zero" else features[:, lengths]
        elif column == "contact_len_mm" and kind == "delay":
            # The contact falls about evenly from its first length to that of the first motion.
            way = features[:, 6] - drop_drag.START_MM / 2
            change[:, 7] = speed * (features[:, 7] - features[:, 3]) / np.maximum(way, 1.0)
        if change.any():
            usual = np.sqrt((low**2 + low * high + high**2) / 3)  # of sizes from low to high
            found[column, kind] = usual, change
    return found


class Metric:
    """Whitening by noise, run and specimen; the features of all protocols as one vector.

    ``sampled``: a slip lies somewhere between two readings of the force.
    """

    def __init__(self, plan, effects, sampled=True):
        self.plan, self.step = plan, 0.01
        self.blocks, self.fault_names, faults = [], [], []
        for protocol in plan.protocols:
            base = expectation(plan, protocol, effects)
            moved = expectation(plan, protocol, effects, self.step)
            slope = ((moved - base) / self.step).ravel()
            good = np.isfinite(slope)
            slope = np.where(good, slope, 0.0)
            sd = noise(plan, protocol, sampled).ravel()
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
            root = np.linalg.cholesky(covariance[np.ix_(good, good)])
            self.blocks.append((protocol, good, root))
            opened = _open_faults(plan, protocol, np.nan_to_num(base))
            self.fault_names += [(protocol, *name) for name in opened]
            columns = [usual * change.ravel()[good] for usual, change in opened.values()]
            columns = np.array(columns).reshape(len(columns), good.sum())
            faults.append(np.linalg.solve(root, columns.T))
        self.faults = block_diag(*faults)

    def solved(self, left, columns):
        """(least-squares step, chi-square that it leaves), beside the open faults."""
        matrix, faults = np.array(columns).T, self.faults
        good = np.isfinite(left) & np.isfinite(matrix).all(axis=1)
        prior = np.eye(faults.shape[1])
        whole = np.block(
            [[matrix[good], faults[good]], [np.zeros((len(prior), len(columns))), prior]]
        )
        target = np.append(left[good], np.zeros(len(prior)))
        step, *_ = np.linalg.lstsq(whole, target, rcond=1e-9)
        return step[: len(columns)], float(np.sum((target - whole @ step) ** 2))

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
            shifts = shifts + np.clip(metric.solved(target - base, columns)[0], -1, 1)
    return shifts, base, columns


def noncentrality(plan, effects, sampled=True):
    """Chi-square of the best null about exact data with ``effects``."""
    metric = Metric(plan, effects, sampled)
    target = metric.vector(effects)
    _, base, columns = best_null(metric, target, {})
    return metric.solved(target - base, columns)[1]


def separation(plan, effects, rivals):
    """Least such chi-square over single wrong mechanisms (linearised at the best null)."""
    metric = Metric(plan, effects)
    target = metric.vector(effects)
    shifts, base, columns = best_null(metric, target, {})
    left = [
        metric.solved(target - base, columns + _columns(metric, base, {}, name, *shifts))[1]
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
        result.append(metric.solved(target - base, columns)[1])
    return result


def fault_strength(plan, fault):
    """Noncentrality of one fault of a sensor beside the coefficients and the other open faults.

    The noise of a trace tells itself, and so does a turn that the edge shows: infinite. That of
    single readings is told from scatter between runs only by what scatter does more to some
    readings than to others. Where the way of a drag counts from is of no consequence: zero.
    """
    protocol, column, kind, size = (fault[k] for k in ("protocol", "quantity", "kind", "size"))
    if kind == "noise" and protocol in ("incline", "strip"):
        return _of_noise(plan, protocol)
    if kind in ("noise", "turn"):
        return np.inf
    metric = Metric(plan, plan.effects)
    if (protocol, column, kind) not in metric.fault_names:
        return 0.0
    which = metric.fault_names.index((protocol, column, kind))
    base = metric.vector(plan.effects)
    columns = [
        (metric.vector(plan.effects, *one) - base) / metric.step for one in metric.step * np.eye(2)
    ]
    usual = _open_faults(plan, protocol, np.nan_to_num(expectation(plan, protocol, plan.effects)))
    own = metric.faults[:, which] * size / usual[column, kind][0]
    metric.faults = np.delete(metric.faults, which, axis=1)
    return metric.solved(own, columns)[1]


def _of_noise(plan, protocol):
    """Twice the log-likelihood by which noise exceeds what is usual, scatters fitted in both."""
    metric = Metric(plan, plan.effects)
    ((_, good, root),) = (block for block in metric.blocks if block[0] == protocol)
    covariance, usual = root @ root.T, plan.noise[protocol] * MOST_UNDERSTATED
    base, moved = (expectation(plan, protocol, plan.effects, s) for s in (0.0, metric.step))
    slope = ((moved - base) / metric.step).ravel()[good]
    specimen = np.unique(plan.tables[protocol]["specimen_id"], return_inverse=True)[1][good]
    same = specimen[:, None] == specimen[None, :]

    def lost(logs):
        between, within = np.exp(logs)
        own = np.outer(slope, slope) * (between**2 * same + within**2 * np.eye(len(slope)))
        own = own + usual**2 * np.eye(len(slope))
        whitened = np.linalg.solve(own, covariance)
        return np.trace(whitened) - len(slope) - np.linalg.slogdet(whitened)[1]

    return float(minimize(lost, np.log(plan.scatter[protocol]), method="Nelder-Mead").fun)
