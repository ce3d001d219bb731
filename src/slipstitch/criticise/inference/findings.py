"""What the data themselves have wrong: sensors' zeros, and noise beyond what is stated."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2 as chi_square

from slipstitch.criticise.inference.fit import Fit
from slipstitch.criticise.inference.mixed_model import Clusters
from slipstitch.criticise.inference.state import State
from slipstitch.criticise.measurements import Measurements
from slipstitch.criticise.sensors import DataFinding

# Twice the gain in log-likelihood of a finding: chi squared of one degree at p = .001.
CLEAR_RATIO = 10.8
# Zeros within this share of their usual size are not worth saying.
NEGLIGIBLE = 0.4
# With one operator and apparatus, kinetic coefficients differ by more than 0.06 in one case of
# twenty (repeatability of ASTM D2534, nine laboratories; of sheets little else is published): a
# standard deviation of 0.06 / 2.77.
USUAL_RUN_SD = 0.0217
FEWEST_DEGREES, SURE = 6, 0.05
# What may have changed from run to run without being recorded, the most frequent first.
RECORDABLE = (
    "clock_min",
    "pos_x_mm",
    "rh_pct",
    "operator",
    "orientation_deg",
    "repeat_index",
    "dwell_s",
)
# Stated uncertainties may be this much too small.
USUAL_UNDERSTATEMENT = 1.5


def estimated_zeros(
    measurements: Measurements, fitted: Fit, state: State, usual: bool = True
) -> tuple[np.ndarray, np.ndarray]:
    """Zeros in units of their prior sd, and their covariance, beside a fitted model.

    ``usual``: with their priors; else each one without its own, beside the others with theirs.
    """
    m, count = measurements, measurements.zero_columns.shape[1]
    if not count or not state.groups:
        return np.zeros(count), np.zeros((count, count))
    residual = m.y - fitted.prediction
    columns = np.column_stack([m.zero_columns, fitted.jacobian])
    size = columns.shape[1]
    gram, pulled = np.zeros((size, size)), np.zeros(size)
    for group in state.groups:
        both = np.column_stack([columns[group.index], residual[group.index]])
        own = Clusters(group, both).gram(state.scatters[group.protocol])
        gram, pulled = gram + own[:-1, :-1], pulled + own[:-1, -1]
    scale = [1.0] * count + [30.0 * p.scale for p in fitted.parameters]
    ridge = 1.0 / np.array(scale) ** 2
    if usual:
        covariance = np.linalg.inv(gram + np.diag(ridge))
        return (covariance @ pulled)[:count], covariance[:count, :count]
    values, variances = np.zeros(count), np.zeros((count, count))
    for k in range(count):
        own = ridge.copy()
        own[k] = 1e-6
        covariance = np.linalg.inv(gram + np.diag(own))
        values[k], variances[k, k] = (covariance @ pulled)[k], covariance[k, k]
    return values, variances


def without_zeros(measurements: Measurements, fitted: Fit, state: State) -> np.ndarray:
    """Residuals less what the sensors' zeros explain, (n,)."""
    values, _ = estimated_zeros(measurements, fitted, state)
    return measurements.y - fitted.prediction - measurements.zero_columns @ values


def zero_findings(measurements: Measurements, fitted: Fit, state: State) -> list[DataFinding]:
    """Sensors' zeros that are clearly off."""
    values, covariance = estimated_zeros(measurements, fitted, state, usual=False)
    found = []
    for k, (protocol, zero) in enumerate(measurements.zeros):
        error = float(np.sqrt(covariance[k, k]))
        reach = 1.96 * error
        clear = zero.of_sensor and error > 0 and (values[k] / error) ** 2 > CLEAR_RATIO
        if clear and abs(values[k]) - reach > NEGLIGIBLE:
            size, reach = values[k] * zero.sd, reach * zero.sd
            found.append(
                DataFinding(
                    protocol,
                    zero.sensor,
                    zero.quantity,
                    "zero",
                    float(size),
                    (float(size - reach), float(size + reach)),
                    zero.unit,
                )
            )
    return found


def noise_findings(measurements: Measurements) -> list[DataFinding]:
    """Sensors whose traces are clearly noisier than stated."""
    return [
        DataFinding(
            block.protocol, noise.sensor, noise.quantity, "noise", noise.factor, noise.ci95, "1"
        )
        for block in measurements.blocks
        for noise in block.trace_noises
        if noise.ci95[0] > USUAL_UNDERSTATEMENT
    ]


def scatter_findings(measurements: Measurements, state: State, coefficients: dict) -> list[dict]:
    """Protocols whose runs scatter by clearly more than is usual, and what to record there next.

    Parameters
    ----------
    coefficients : logarithm of every friction coefficient by name.
    """
    found = []
    for block in measurements.blocks:
        scatter = state.scatters.get(block.protocol)
        mine = (measurements.protocol == block.protocol) & state.keep & measurements.of_friction
        degrees = len(np.unique(measurements.run[mine]))
        degrees -= len(np.unique(measurements.specimen[mine]))
        if scatter is None or degrees < FEWEST_DEGREES:
            continue
        usual = USUAL_RUN_SD / np.exp(coefficients[block.COEFFICIENT])
        least = scatter.run * np.sqrt(degrees / chi_square.isf(SURE, degrees))
        if least > usual:
            rows = measurements.rows[mine]
            blank = [
                name
                for name in RECORDABLE
                if rows.loc[rows[name].notna() & (rows[name] != ""), name].nunique() < 2
            ]
            found.append(
                {
                    "protocol": block.protocol,
                    "run_scatter": float(f"{scatter.run:.3g}"),
                    "usual": float(f"{usual:.3g}"),
                    "record_next": blank,
                }
            )
    return found
