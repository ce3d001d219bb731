"""Embedded discrepancy: a smooth factor on the coefficient where no mechanism explains the data.

The covariate is found by likelihood, its p by simulation over all covariates that were tried.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd
from scipy.stats import t as student

from slipstitch.criticise.covariates import COVARIATES
from slipstitch.criticise.inference.fit import Fit
from slipstitch.criticise.inference.mixed_model import Scatter
from slipstitch.criticise.inference.ratio import Ratios
from slipstitch.criticise.inference.short_formula import Formula, rounded, short_formula
from slipstitch.criticise.inference.smooth_factor import (
    SPEED,
    Problem,
    Response,
    left_out_error,
    speed_curve,
    track_along,
)
from slipstitch.criticise.inference.state import State
from slipstitch.criticise.measurements import Measurements

ALONG = ("pos_x_mm", "clock_min", "speed_mm_s", "load_ratio")
SIGNIFICANCE = 0.04
REACH = 1.96  # of a 95 % band, in standard deviations


@dataclass(frozen=True)
class Discrepancy:
    """A smooth factor on the coefficient, its mean logarithm over the features 0.

    Attributes
    ----------
    tried : covariate -> family-wise p of any smooth curve along it.
    covariate : of the factor; None where no covariate takes anything away (then nothing follows).
    knots, factors, low, high : of the curve with its 95 % band; linear between knots in the
        logarithm of the factor and, for speed and load, of the covariate.
    coefficients : friction coefficients where the factor is 1.
    scatters : beside the factor, outliers included: for prediction.
    rmse_null, rmse : errors of features of left-out specimens, relative to friction.
    share : of the squared error that the factor takes away there.
    not_converged : covariates along which a factor's fit did not: it is not used.
    shapes_not_converged : short formulas whose fit did not: whether they fit as well is not known.
    """

    tried: dict[str, float]
    covariate: str | None = None
    knots: tuple[float, ...] = ()
    factors: tuple[float, ...] = ()
    low: tuple[float, ...] = ()
    high: tuple[float, ...] = ()
    coefficients: dict[str, float] = field(default_factory=dict)
    scatters: dict[str, Scatter] = field(default_factory=dict)
    rmse_null: float = 0.0
    rmse: float = 0.0
    share: float = 0.0
    formula: Formula | None = None
    not_converged: tuple[str, ...] = ()
    shapes_not_converged: tuple[str, ...] = ()

    def as_dict(self) -> dict:
        """The layout of docs/criticise-your-data.md."""
        tried = {name: round(p, 5) for name, p in self.tried.items()}
        failed = {"not_converged": list(self.not_converged)} if self.not_converged else {}
        if self.covariate is None:
            return {"covariate": None, "tried": tried, **failed}
        result = failed | {
            "covariate": self.covariate,
            "unit": COVARIATES[self.covariate].unit,
            "p_adjusted": tried[self.covariate],
            "tried": tried,
            "knots": list(self.knots),
            "factors": list(self.factors),
            "ci95": [list(band) for band in zip(self.low, self.high, strict=True)],
            "coefficients": self.coefficients,
            "scatter": {p: [s.specimen, s.run, s.kappa] for p, s in self.scatters.items()},
            "rmse_null": round(self.rmse_null, 5),
            "rmse_extended": round(self.rmse, 5),
            "misfit_share": round(self.share, 4),
            "formula": None,
        }
        if self.shapes_not_converged:
            result["shapes_not_converged"] = list(self.shapes_not_converged)
        if self.formula is not None:
            result["formula"] = {
                "text": self.formula.text,
                "shape": self.formula.shape,
                "parameter": self.formula.parameter,
                "ci95": list(self.formula.interval),
                "coefficients": self.formula.coefficients,
                "delta_bic": round(self.formula.delta_bic, 2),
            }
        return result


def along(found: dict, places, factors=None) -> np.ndarray:
    """The factor at plain values of its covariate, by the knots of :meth:`Discrepancy.as_dict`."""
    covariate = COVARIATES[found["covariate"]]
    knots = covariate.searched(np.array(found["knots"]))
    logs = np.log(found["factors"] if factors is None else factors)
    return np.exp(np.interp(covariate.searched(np.asarray(places, float)), knots, logs))


def specimen_factors(
    found: dict, measurements: Measurements, null: Fit, state: State
) -> pd.DataFrame:
    """What specimens say of the factor: protocol, specimen, ``at`` a place, their mean ``factor``.

    Many places are drawn together into as many as there are knots at most.
    """
    m, problem = measurements, Problem(measurements, state.keep, null, state.scatters)
    track = track_along(problem, found["covariate"])
    if track is None:
        return pd.DataFrame({"protocol": [], "at": [], "factor": []})
    names = [p.name for p in m.null_parameters]
    level = np.log([found["coefficients"][name] for name in names])
    g = np.where(track.recorded, np.log(along(found, track.plain)), 0.0)
    prediction, d = problem.response.at(level, g)
    shown = track.recorded & ~m.lower_bound & (np.abs(d) > 2.0 * m.u)
    table = pd.DataFrame(
        {
            "protocol": m.protocol[shown],
            "specimen": m.specimen[shown],
            "knot": track.hats[shown].argmax(axis=1),
            "at": track.plain[shown],
            "factor": np.exp(g[shown] + ((m.y - prediction) / np.where(d, d, 1.0))[shown]),
        }
    )
    by = ["protocol", "specimen", "knot"]
    return table.groupby(by, as_index=False)[["at", "factor"]].mean()


def predicted_with(
    found: dict, design: Measurements, values: dict[str, float]
) -> tuple[np.ndarray, np.ndarray]:
    """What a design's instruments read with the factor, and the sd of its logarithm, (n,) each.

    ``values`` are logarithms of coefficients, replaced by those that stand in ``found``.
    """
    own = {name: float(np.log(value)) for name, value in found["coefficients"].items()}
    values = {name: own.get(name, value) for name, value in values.items()}
    places = design.rows[found["covariate"]].to_numpy(float)
    acts = np.isfinite(places) & design.of_friction
    places = np.where(acts, places, found["knots"][0])
    low, high = (along(found, places, band) for band in np.array(found["ci95"]).T)
    sd = np.where(acts, np.log(high / low) / (2 * REACH), 0.0)
    if found["covariate"] == SPEED:
        curve = speed_curve(found["knots"], found["factors"])
        return design.predict(values, (), curve=curve), sd
    response = Response(design, values)
    return response.at(response.level, np.log(along(found, places)) * acts)[0], sd


def discrepancy_words(found: dict | None) -> str:
    """What :meth:`Discrepancy.as_dict` says, in a sentence."""
    if not found or not found["tried"]:
        return ""
    failed = found.get("not_converged", [])
    unused = f" The fit along {_listed(failed)} did not converge and is not used." if failed else ""
    if found["covariate"] is None:
        rest = [name for name in found["tried"] if name not in failed]
        if not rest:
            return f"Whether a smooth factor takes any of it away is not known.{unused}"
        along_none = f"No smooth factor on the coefficient along {_listed(rest)}"
        return f"{along_none} takes any of it away.{unused}"
    formula = found["formula"]
    short = f"{formula['text']} fits as well" if formula else "no short formula fits as well"
    if not formula and (unknown := found.get("shapes_not_converged")):
        short += f" (not known of {', '.join(unknown)}: the fit did not converge)"
    return (
        f"A smooth factor on the coefficient along the {COVARIATES[found['covariate']].title}, "
        f"{min(found['factors']):.2f} to {max(found['factors']):.2f}, takes away "
        f"{100 * found['misfit_share']:.0f} % of the squared error on specimens left out; {short}."
        f"{unused}"
    )


def _listed(names: list[str]) -> str:
    titles = [COVARIATES[name].title for name in names]
    return " or ".join(filter(None, [", ".join(titles[:-1]), titles[-1]]))


def embedded_discrepancy(
    measurements: Measurements, null: Fit, state: State, seed: int = 1, replicates: int = 500
) -> Discrepancy:
    """The smooth factor that the data ask for beside the null, if any.

    Parameters
    ----------
    null, state : fit of the null, and its scatter and kept features.
    seed, replicates : of the simulated maxima.
    """
    problem = Problem(measurements, state.keep, null, state.scatters)
    tracks = [track for name in ALONG if (track := track_along(problem, name)) is not None]
    tried = _tried(problem, tracks, state, np.random.default_rng(seed), replicates)
    if not tracks:
        return Discrepancy(tried)
    plain = problem.fit(None)
    fitted = [(track, problem.fit(track.smooth())) for track in tracks]
    failed = tuple(t.covariate.name for t, c in fitted if not (c.converged and plain.converged))
    nothing = Discrepancy(tried, not_converged=failed)
    usable = [(track, curve) for track, curve in fitted if track.covariate.name not in failed]
    if not usable:
        return nothing
    track, curve = max(usable, key=lambda pair: pair[1].log_likelihood)
    errors = [left_out_error(measurements, model, track.recorded) for model in (plain, curve)]
    share = 1.0 - (errors[1] / errors[0]) ** 2
    if tried[track.covariate.name] > SIGNIFICANCE or not share > 0:
        return nothing
    everything = replace(problem, keep=np.ones_like(state.keep), scatters=curve.scatters)
    whole = everything.fit((track_along(everything, track.covariate.name) or track).smooth())
    if not whole.converged:
        return Discrepancy(tried, not_converged=(*failed, track.covariate.name))
    # The factor's mean logarithm over the features goes into the coefficients.
    weights = track.hats[track.recorded].mean(axis=0)
    mean = weights @ curve.values
    centred = np.eye(len(weights)) - weights
    own = np.flatnonzero(curve.curve)
    covariance = centred @ curve.covariance[np.ix_(own, own)] @ centred.T
    half = _reach(measurements, state) * np.sqrt(np.maximum(np.diag(covariance), 0.0))
    log_factors = curve.values - mean
    names = [p.name for p in measurements.null_parameters]
    formula, unknown = short_formula(problem, track, curve, names, _reach(measurements, state))
    return Discrepancy(
        tried,
        track.covariate.name,
        knots=rounded(track.plain_knots),
        factors=rounded(np.exp(log_factors)),
        low=rounded(np.exp(log_factors - half)),
        high=rounded(np.exp(log_factors + half)),
        coefficients=dict(zip(names, rounded(np.exp(curve.level + mean)), strict=True)),
        scatters=whole.scatters,
        rmse_null=float(errors[0]),
        rmse=float(errors[1]),
        share=float(share),
        formula=formula,
        not_converged=failed,
        shapes_not_converged=unknown,
    )


def _reach(measurements: Measurements, state: State) -> float:
    specimens = len(np.unique(measurements.specimen[state.keep]))
    return float(student.ppf(0.975, max(specimens - 2, 3)))


def _tried(problem: Problem, tracks, state: State, rng, replicates: int) -> dict[str, float]:
    """Family-wise p of a smooth curve along every covariate, in any protocol or in all."""
    if not tracks:
        return {}
    m, null = problem.measurements, problem.null
    tests = [track.test(m, state.sensitivity, problem.usable) for track in tracks]
    residual = m.y - null.prediction
    ratios = Ratios(tests, null.jacobian, residual, state.groups, state.scatters, m.zero_columns)
    outcome = ratios.outcome(rng, replicates, (SIGNIFICANCE,))
    found: dict[str, float] = {}
    for test, p in zip(outcome.tests, outcome.adjusted, strict=True):
        name = str(test.covariate)
        found[name] = min(found.get(name, 1.0), float(p))
    return found
