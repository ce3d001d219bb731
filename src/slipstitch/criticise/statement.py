"""The verdict in sentences."""

from __future__ import annotations

from slipstitch.base.page.wording import counted, with_interval
from slipstitch.criticise.causes import MECHANISMS, data_words
from slipstitch.criticise.covariates import COVARIATES
from slipstitch.criticise.inference.candidates import LEFTOVER_SIGNIFICANCE
from slipstitch.criticise.inference.discrepancy import discrepancy_words
from slipstitch.criticise.inference.rivals import TITLES as RIVALS
from slipstitch.criticise.inference.structure import ERROR_WEIGHTS
from slipstitch.criticise.measurements import COEFFICIENTS
from slipstitch.criticise.within_runs import departure, words

CLEAR_FALL = 0.8  # of an error, to be worth a headline
# Relative errors that a power of ten makes, and in what it would be.
TENFOLD = (9.0, -0.9)
TENFOLD_IN = {
    "bending_error": "B_Nm or B_strip_Nm",
    "mass_error": "rho_kg_m2",
    "force_gain": "the force",
}


def statement(verdict: dict) -> str:
    """The verdict, what single runs show besides, and what is wrong with the traces."""
    of_data = data_words(verdict.get("data_findings", []))
    return " ".join([sentence(verdict), *words(verdict.get("within_runs", {})), *of_data])


def sentence(verdict: dict) -> str:
    """The verdict in one sentence."""
    kind = verdict["verdict"]
    if kind == "none":
        within = departure(verdict.get("within_runs", {}))
        beyond = "beyond plain Coulomb friction with scatter was found"
        p = f"(family-wise p = {verdict['null']['global_p']:.2g})"
        found = f"Nothing {beyond} in these measurements {p}."
        if within:
            found = f"Between the runs nothing {beyond} {p}; but within them {within}."
        return found + _scatter(verdict)
    if kind == "insufficient":
        return f"These measurements cannot judge the model: {verdict['reason'].rstrip('.')}."
    if kind == "unknown":
        shape = next(iter(verdict["residual_tests"]), None)
        where = f"; the clearest trace is {shape['shape']} in the {shape['name']}" if shape else ""
        return f"The model is wrong and no known mechanism explains how{where}."
    if kind == "confounded":
        rivals = " or ".join(
            " with ".join(RIVALS.get(name, name) for name in c) for c in verdict["alternatives"]
        )
        said = f", but these data cannot distinguish between these causes: {rivals}."
    else:
        titles = " and ".join(MECHANISMS[c].title for c in verdict["causes"])
        coefficients = {coefficient.name for coefficient in COEFFICIENTS}
        numbers = ", ".join(
            f"{name} = {p['estimate']:.3g} [{p['ci95'][0]:.3g}, {p['ci95'][1]:.3g}]"
            + ("" if p["unit"] == "1" else f" {p['unit']}")
            for name, p in verdict["parameters"].items()
            if name not in coefficients
        )
        said = f" because {titles} ({numbers})."
    further = _power_of_ten(verdict) + _left(verdict) + _kept_back(verdict)
    return f"The model is wrong{said}{further}"


def _power_of_ten(verdict: dict) -> str:
    """Whether a nominal value is ten times off; beyond a bound the fit cannot follow it."""
    found = []
    for name, where in TENFOLD_IN.items():
        if name not in verdict["parameters"]:
            continue
        entry, (parameter,) = verdict["parameters"][name], MECHANISMS[name].parameters
        low, high = entry["ci95"]
        near = 0.01 * (parameter.upper - parameter.lower)
        at_bound = not parameter.lower + near < entry["estimate"] < parameter.upper - near
        if at_bound or any(low <= error <= high for error in TENFOLD):
            found.append(where)
    return f" A power of ten in {' and '.join(found)}?" if found else ""


def _kept_back(verdict: dict) -> str:
    """The causes that the extended model has to do without."""
    left_out = verdict.get("not_exported") or {}
    why = "; ".join(f"{cause} ({why})" for cause, why in left_out.items())
    return f" A model exported from this leaves out {why}." if why else ""


def _left(verdict: dict) -> str:
    """The clearest trace of what else is left beside the causes, if it is significant."""
    shape = next(iter(verdict["residual_tests"]), None)
    if shape is None or shape["p_adjusted"] >= LEFTOVER_SIGNIFICANCE * ERROR_WEIGHTS["generic"]:
        return ""
    return f" Beside it, structure is left: {shape['shape']} in the {shape['name']}."


def _scatter(verdict: dict) -> str:
    """What is said of runs that scatter by more than is usual."""
    found = verdict["scatter_findings"]
    if not found:
        return ""
    first = found[0]
    names = [COVARIATES[name].title for name in first["record_next"]]
    record = f": record {', '.join(names)}" if names else ""
    return (
        f" But runs of {first['protocol']} scatter by {100 * first['run_scatter']:.2g} % "
        f"(usual: {100 * first['usual']:.2g} %), for which something may be to blame that was not "
        f"looked at{record}."
    )


def second_sentence(verdict: dict) -> str:
    """What the extended model gains; without one, why none was named."""
    if verdict["verdict"] in ("cause", "confounded"):
        return gain_words(verdict["gain"])
    if verdict["verdict"] == "unknown":
        return f"{verdict['reason'].capitalize()}. {discrepancy_words(verdict['discrepancy'])}"
    p = verdict["null"]["global_p"]
    return f"Family-wise p of the plain model over all tests: {p:.3g}."


def gain_words(gain: dict) -> str:
    """The gain on unseen specimens; errors only where they fall clearly."""
    how = (
        f"({counted(gain['n_groups'], 'specimen')} held out one by one, with the selection "
        "repeated each time)"
    )
    score = f"{with_interval(gain['estimate'], gain['ci95'])} in log score per row"
    if not gain["ci95"][0] > 0:
        return f"On unseen specimens no gain is certain: {score} {how}."
    before, after = 100 * gain["rmse_null"], 100 * gain["rmse_extended"]
    if after > CLEAR_FALL * before:
        return f"On unseen specimens the extended model gains {score} {how}."
    return (
        f"On unseen specimens the error falls from {before:.1f} to {after:.1f} % of friction, a "
        f"gain of {score} {how}."
    )


def false_alarm_words(shown: dict) -> str:
    """How often a certificate says that nothing is taken for something: simulated, or at most."""
    rate = shown["false_alarm_rate"]
    if rate is None:
        return (
            "where there is nothing, the tests are made to say something in at most "
            f"{100 * shown['false_alarm_limit']:.0f} of 100 (a limit, not simulated)"
        )
    low, high = (100 * end for end in rate["ci95"])
    return (
        f"of {rate['campaigns']} simulated campaigns that held nothing, "
        f"{100 * rate['estimate']:.3g} % [{low:.2g}, {high:.2g}] were said to hold something"
    )
