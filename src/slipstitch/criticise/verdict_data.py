"""The verdict as plain data, in the layout of docs/criticise-your-data.md."""

from __future__ import annotations

import numpy as np
from scipy.stats import t as student

from slipstitch.criticise.case import Case
from slipstitch.criticise.causes import MECHANISMS
from slipstitch.criticise.covariates import COVARIATES
from slipstitch.criticise.identifiability import not_exported, not_identified
from slipstitch.criticise.inference.certificate import certificate
from slipstitch.criticise.inference.discrepancy import embedded_discrepancy
from slipstitch.criticise.inference.evidence import SIGNIFICANCE
from slipstitch.criticise.inference.findings import estimated_zeros, scatter_findings
from slipstitch.criticise.inference.fit import Fit
from slipstitch.criticise.inference.gain import Gain, held_out_gain, plain_scatters
from slipstitch.criticise.inference.separation import separations
from slipstitch.criticise.inference.structure import Outcome
from slipstitch.criticise.verdict import Analysis
from slipstitch.criticise.within_runs import within_runs

SPEC_VERSION = 1
CLOSE_BIC = 25.0


def verdict_of(case: Case, analysis: Analysis, seed: int, code_version: str) -> dict:
    """Everything a machine may want to know of a case's verdict."""
    chosen = analysis.chosen
    candidates = [c for c in analysis.ranking if c.bic < min(_best(analysis) + CLOSE_BIC, 0.0)]
    named = analysis.verdict in ("cause", "confounded")
    gain = held_out_gain(analysis, candidates[:12] if named else [])
    fitted = chosen.fitted if named and chosen is not None else analysis.null
    left = analysis.left_over or analysis.null_outcome
    parameters = parameters_with_intervals(analysis, fitted)
    unknown = not_identified(_entries(analysis, fitted) | parameters)
    return {
        "case": case.name,
        "spec_version": SPEC_VERSION,
        "about": str(case.meta.get("about", "")),
        "verdict": analysis.verdict,
        "causes": list(analysis.causes),
        "alternatives": [list(c) for c in analysis.alternatives],
        "separate_by": [
            {
                "between": [list(s.between[0]), list(s.between[1])],
                "measure": s.measure,
                "expected_delta_loglik": s.expected_delta_loglik,
            }
            for s in (separations(case, analysis) if analysis.verdict == "confounded" else [])
        ],
        "reason": analysis.reason,
        "discrepancy": embedded_discrepancy(
            analysis.measurements, analysis.null, analysis.null_state, seed
        ).as_dict()
        if analysis.verdict == "unknown"
        else None,
        "parameters": parameters,
        "null": {
            "log_score_per_row": round(gain.null_score, 5),
            "rmse": round(gain.rmse_null, 5),
            "global_p": round(analysis.global_p, 5),
        },
        "residual_tests": residual_tests(left),
        "null_tests": residual_tests(analysis.null_outcome),
        "gain": _gain(gain),
        "not_identified": unknown,
        "not_exported": not_exported(fitted.causes, unknown),
        "certificate": certificate(analysis.detectable, SIGNIFICANCE),
        "data_findings": [finding.as_dict() for finding in analysis.data_findings],
        "scatter_findings": scatter_findings(
            analysis.measurements, analysis.state, fitted.as_dict()
        ),
        "excluded_rows": [{"run_id": e.run_id, "reason": e.reason} for e in analysis.excluded],
        "ranking": _ranking(analysis),
        "not_testable": dict(sorted(analysis.untestable().items())),
        "scatter": {
            p: {
                "specimen": round(s.specimen, 5),
                "run": round(s.run, 5),
                "instrument_factor": round(s.kappa, 4),
            }
            for p, s in analysis.state.scatters.items()
        },
        "within_runs": within_runs(case, analysis.measurements),
        "models": {"null": _model(analysis, analysis.null), "extended": _model(analysis, fitted)},
        "nominal": case.nominal,
        "ignored_files": list(case.ignored_files),
        "seed": seed,
        "code_version": code_version,
    }


def _best(analysis: Analysis) -> float:
    return min((c.bic for c in analysis.ranking), default=0.0)


def _gain(gain: Gain) -> dict:
    return {
        "metric": "log_score_per_row",
        "estimate": round(gain.estimate, 5),
        "ci95": [round(gain.low, 5), round(gain.high, 5)],
        "rmse_null": round(gain.rmse_null, 5),
        "rmse_extended": round(gain.rmse_extended, 5),
        "grouping": "specimen_id",
        "n_groups": gain.groups,
        "selection_nested": True,
    }


def _ranking(analysis: Analysis) -> list[dict]:
    models: list[tuple[list[str], float]] = [(list(c.causes), c.bic) for c in analysis.ranking]
    entries = sorted([([], 0.0), *models], key=lambda entry: entry[1])
    best = entries[0][1]
    return [{"model": m, "delta_bic": round(float(b - best), 3)} for m, b in entries]


def residual_tests(outcome: Outcome) -> list[dict]:
    """The strongest shape of each covariate, p adjusted for all that was looked at."""
    best: dict[str, int] = {}
    for i, test in enumerate(outcome.tests):
        told = test.family == "generic" and np.isfinite(outcome.log_p[i])
        if not told or test.covariate is None:
            continue
        if test.covariate not in best or outcome.log_p[i] > outcome.log_p[best[test.covariate]]:
            best[test.covariate] = i
    return [
        {
            "covariate": covariate,
            "name": COVARIATES[covariate].title,
            "p_adjusted": round(float(outcome.adjusted[i]), 5),
            "shape": outcome.tests[i].shape,
        }
        for covariate, i in sorted(best.items(), key=lambda item: outcome.adjusted[item[1]])
    ]


def parameters_with_intervals(analysis: Analysis, fitted: Fit) -> dict[str, dict]:
    """Estimates with 95 % intervals in the units of the specification."""
    reach = _reach(analysis, fitted)
    inflation = analysis.null_outcome.mechanism_inflation()
    result = _entries(analysis, fitted)
    for cause in fitted.causes:
        names = MECHANISMS[cause].components
        if names is not None:
            own = {p.name for p in MECHANISMS[cause].parameters}
            result = {name: entry for name, entry in result.items() if name not in own}
            result |= _size_and_direction(fitted, cause, names, reach, inflation.get(cause, 1.0))
    return result


def _reach(analysis: Analysis, fitted: Fit) -> float:
    """Half of a 95 % interval in standard errors."""
    specimens = len(np.unique(analysis.measurements.specimen[analysis.state.keep]))
    return float(student.ppf(0.975, max(specimens - len(fitted.values), 3)))


def _entries(analysis: Analysis, fitted: Fit) -> dict[str, dict]:
    """Every fitted parameter with its 95 % interval, vectors by their components."""
    reach = _reach(analysis, fitted)
    inflation = analysis.null_outcome.mechanism_inflation()
    owner = {p.name: c for c in fitted.causes for p in MECHANISMS[c].parameters}
    result: dict[str, dict] = {}
    for j, parameter in enumerate(fitted.parameters):
        value = float(fitted.values[j])
        inflated = inflation.get(owner.get(parameter.name, ""), 1.0)
        error = float(np.sqrt(fitted.covariance[j, j] * inflated))
        if parameter.coefficient:
            estimate, interval = (
                np.exp(value),
                np.exp([value - reach * error, value + reach * error]),
            )
        elif parameter.relative:
            half = reach * error / (1 + value)
            estimate = value
            interval = (1 + value) * np.exp([-half, half]) - 1
        else:
            estimate, interval = value, np.array([value - reach * error, value + reach * error])
        result[parameter.name] = _entry(estimate, interval, parameter.unit)
    return result


def _size_and_direction(
    fitted: Fit, cause: str, names: tuple[str, str], reach: float, inflated: float
) -> dict[str, dict]:
    """Two components of a vector as its size and its direction."""
    size_name, direction_name = names
    fitted_names = [p.name for p in fitted.parameters]
    components = MECHANISMS[cause].parameters
    index = [fitted_names.index(p.name) for p in components]
    x, y = fitted.values[index]
    covariance = fitted.covariance[np.ix_(index, index)] * inflated
    size = float(np.hypot(x, y))
    along = np.array([x, y]) / max(size, 1e-12)
    across = np.array([-y, x]) / max(size, 1e-12)
    error = float(np.sqrt(along @ covariance @ along))
    turn = float(np.degrees(np.sqrt(across @ covariance @ across) / max(size, 1e-12)))
    turn = min(reach * turn, 180.0)
    azimuth = float(np.degrees(np.arctan2(y, x)) % 360)
    limits = [max(size - reach * error, 0.0), size + reach * error]
    return {
        size_name: _entry(size, limits, components[0].unit),
        direction_name: _entry(azimuth, [azimuth - turn, azimuth + turn], "deg"),
    }


def _entry(estimate, interval, unit) -> dict:
    return {
        "estimate": float(f"{estimate:.6g}"),
        "ci95": [float(f"{interval[0]:.6g}"), float(f"{interval[1]:.6g}")],
        "unit": unit,
    }


def _model(analysis: Analysis, fitted: Fit) -> dict:
    """What prediction needs: values, their covariance, sensors' zeros, scatter of new specimens.

    Zeros are [value, standard deviation] in units of :attr:`Zero.sd`, by protocol and field.
    """
    zeros: dict[str, dict[str, list[float]]] = {}
    found, covariance = estimated_zeros(analysis.measurements, fitted, analysis.state)
    for k, (protocol, zero) in enumerate(analysis.measurements.zeros):
        own = [float(found[k]), float(np.sqrt(covariance[k, k]))]
        zeros.setdefault(protocol, {})[zero.field] = own
    return {
        "causes": list(fitted.causes),
        "parameters": [p.name for p in fitted.parameters],
        "values": [float(v) for v in fitted.values],
        "covariance": [[float(v) for v in row] for row in fitted.covariance],
        "zeros": zeros,
        "scatter": {
            protocol: [s.specimen, s.run, s.kappa]
            for protocol, s in plain_scatters(analysis, fitted).items()
        },
    }
