"""The verdict as plain data, in the layout of docs/criticise-your-data.md."""

from __future__ import annotations

from operator import itemgetter

import numpy as np

from slipstitch.criticise.case import Case
from slipstitch.criticise.causes import departures
from slipstitch.criticise.covariates import COVARIATES
from slipstitch.criticise.inference.certificate import certificate, separations
from slipstitch.criticise.inference.discrepancy import embedded_discrepancy
from slipstitch.criticise.inference.faulty_data import estimated_zeros, scatter_findings
from slipstitch.criticise.inference.fit import Fit
from slipstitch.criticise.inference.gain import held_out_gain, plain_scatters
from slipstitch.criticise.inference.intervals import not_exported, not_identified
from slipstitch.criticise.inference.structure import Outcome
from slipstitch.criticise.verdict import Analysis
from slipstitch.criticise.within_runs import within_runs
from slipstitch.physics.friction_law import FrictionLaw

SPEC_VERSION = 1
CLOSE_BIC = 25.0


def verdict_of(case: Case, analysis: Analysis, seed: int, code_version: str) -> dict:
    """Everything a machine may want to know of a case's verdict."""
    named = analysis.explanation
    best = min((c.bic for c in analysis.ranking), default=0.0)
    candidates = [c for c in analysis.ranking if c.bic < min(best + CLOSE_BIC, 0.0)]
    gain = held_out_gain(analysis, candidates[:12] if named else [])
    models = sorted([((), 0.0), *((c.causes, c.bic) for c in analysis.ranking)], key=itemgetter(1))
    fitted = named.fitted if named else analysis.null
    left = analysis.left_over or analysis.null_outcome
    intervals = analysis.intervals(fitted)
    parameters = intervals.of_sizes()
    unknown = not_identified(intervals.of_parameters() | parameters)
    by_causes = {c.causes: c for c in analysis.ranking}
    rivals = [by_causes[c] for c in analysis.alternatives if c in by_causes]
    separate_by, discrepancy = [], None
    if analysis.verdict == "confounded":
        separate_by = separations(case, rivals, analysis.state.scatters)
    if analysis.verdict == "unknown":
        discrepancy = embedded_discrepancy(analysis.measurements, analysis.null_state, seed)
    return {
        "case": case.name,
        "spec_version": SPEC_VERSION,
        "about": str(case.meta.get("about", "")),
        "verdict": analysis.verdict,
        "causes": list(analysis.causes),
        "alternatives": [list(c) for c in analysis.alternatives],
        "separate_by": separate_by,
        "reason": analysis.reason,
        "discrepancy": discrepancy,
        "parameters": parameters,
        "null": {
            "log_score_per_row": gain.pop("null_score"),
            "rmse": gain["rmse_null"],
            "global_p": round(analysis.null_outcome.global_p, 5),
        },
        "residual_tests": residual_tests(left),
        "null_tests": residual_tests(analysis.null_outcome),
        "gain": {"metric": "log_score_per_row", **gain, "selection_nested": True},
        "not_identified": unknown,
        "not_exported": not_exported(fitted.causes, unknown),
        "certificate": certificate(analysis.detectable),
        "data_findings": [finding.as_dict() for finding in analysis.data_findings],
        "scatter_findings": scatter_findings(analysis.state, fitted.as_dict()),
        "excluded_rows": [{"run_id": e.run_id, "reason": e.reason} for e in analysis.excluded],
        "ranking": [
            {"model": list(causes), "delta_bic": round(float(bic - models[0][1]), 3)}
            for causes, bic in models
        ],
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


def residual_tests(outcome: Outcome) -> list[dict]:
    """The strongest shape of each covariate, p adjusted for all that was looked at."""
    best = outcome.strongest_shapes().items()
    return [
        {
            "covariate": covariate,
            "name": COVARIATES[covariate].title,
            "p_adjusted": round(float(outcome.adjusted[i]), 5),
            "shape": outcome.tests[i].shape,
        }
        for covariate, i in sorted(best, key=lambda item: outcome.adjusted[item[1]])
    ]


def _model(analysis: Analysis, fitted: Fit) -> dict:
    """What prediction needs: values, their covariance, sensors' zeros, scatter of new specimens.

    Zeros are [value, standard deviation] in units of :attr:`Zero.sd`, by protocol and field.
    """
    zeros: dict[str, dict[str, list[float]]] = {}
    found, covariance = estimated_zeros(fitted, analysis.state)
    own = zip(analysis.measurements.zeros, found, np.sqrt(np.diag(covariance)), strict=True)
    for (protocol, zero), value, sd in own:
        zeros.setdefault(protocol, {})[zero.field] = [float(value), float(sd)]
    return {
        "causes": list(fitted.causes),
        "parameters": [p.name for p in fitted.parameters],
        "values": fitted.values.tolist(),
        "covariance": fitted.covariance.tolist(),
        "zeros": zeros,
        "scatter": {p: list(s) for p, s in plain_scatters(analysis, fitted).items()},
    }


def extended_model(verdict: dict, which: str = "extended") -> dict:
    """Friction laws of face and edge, and what departs from the nominal bench and fabric.

    The laws are in the form of :meth:`FrictionLaw.to_dict`; ``bench`` holds fields of
    :class:`slipstitch.criticise.causes.Bench`. ``which`` may be ``null``. A side whose coefficient
    the data do not tell is left out, and so is a cause with such a parameter (``not_exported``);
    without any other, the coefficients are those of no cause. Where no mechanism explains the data,
    ``discrepancy`` has the smooth factor.
    """
    model = verdict["models"][which]
    left_out = verdict["not_exported"] if which == "extended" else {}
    causes = [cause for cause in model["causes"] if cause not in left_out]
    unknown = verdict.get("not_identified", {})
    if left_out and not causes:
        model = verdict["models"]["null"]
        unknown = {}  # those are of the fit with the causes
    values = dict(zip(model["parameters"], model["values"], strict=True))
    found = verdict.get("discrepancy") if which == "extended" else None
    table = {}
    if found and found["covariate"]:
        table = {"discrepancy": {key: found[key] for key in ("covariate", "knots", "factors")}}
        values |= {name: np.log(value) for name, value in found["coefficients"].items()}
    mechanisms, bench = departures(causes, values)
    laws = {
        side: FrictionLaw(float(np.exp(values[name])), mechanisms).to_dict()
        for side, name in (("face", "mu_face"), ("edge", "mu_edge"))
        if name in values and name not in unknown
    }
    return {
        "case": verdict["case"],
        "verdict": verdict["verdict"],
        "causes": causes,
        **({"not_exported": left_out} if left_out else {}),
        "friction_law": laws,
        "bench": {name: float(value) for name, value in bench.items()},
        **table,
        "nominal": verdict["nominal"],
    }
