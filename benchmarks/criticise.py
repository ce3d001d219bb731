"""Blind cases with hidden effects: share of correct verdicts, with Wilson intervals.

``python benchmarks/criticise.py --cases 300 --first-seed 1000`` (minutes to hours; one line of
JSON a case goes to --records, so that it can be stopped and resumed), then the table is printed.
The generator shares no forward model with the package; the truth is read only when scoring.
"""

import argparse
import json
import os
import sys
import tempfile
import time
from pathlib import Path

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from slipstitch.criticise.inference.covariance import Scatter, make_groups
from support.hidden_effects.bench import make_case

from slipstitch.criticise.case import read_case
from slipstitch.criticise.causes import MECHANISMS
from slipstitch.criticise.inference.alternatives import nuisance_columns
from slipstitch.criticise.inference.fit import Weights, fit
from slipstitch.criticise.measurements import assemble
from slipstitch.criticise.prediction.predictive import predict_model
from slipstitch.criticise.verdict import analyse
from slipstitch.criticise.verdict_data import verdict_of

KINDS = (
    *["null"] * 5,
    *["single"] * 7,
    *["pair"] * 3,
    *["outside"] * 3,
    *["unrecorded"] * 2,
    *["ambiguous"] * 2,
)


def strength(folder, bare_folder, measured, truth):
    """Noncentrality against the best null, and of a single cause against the best wrong one.

    From the noise-free twin of the case less its twin without the effect (what extraction does to
    both drops out), with the true scatter and the noisy case's uncertainties.
    """
    clean, bare = assemble(read_case(folder)), assemble(read_case(bare_folder))
    noise = truth["noise"]
    key = dict(
        zip(
            measured.rows[["protocol", "run_id", "quantity"]].itertuples(index=False, name=None),
            measured.u,
            strict=True,
        )
    )
    names = clean.rows[["protocol", "run_id", "quantity"]].itertuples(index=False, name=None)
    names = list(names)
    u = np.array([key.get(name, np.nan) for name in names])
    before = dict(
        zip(
            bare.rows[["protocol", "run_id", "quantity"]].itertuples(index=False, name=None),
            bare.y,
            strict=True,
        )
    )
    change = clean.y - np.array([before.get(name, np.nan) for name in names])
    keep = np.isfinite(u) & np.isfinite(change)
    clean.u = np.where(keep, u, 1.0) * noise["understated"]
    keep &= ~clean.lower_bound
    clean.lower_bound = np.zeros(len(u), bool)
    clean.zero_columns = np.zeros((len(u), 0))  # the bench's sensors have none
    scatters = {p: Scatter(noise["specimen"], noise["run"], 1.0) for p in set(clean.protocol)}
    values = {"mu_face": np.log(truth["mu_face"]), "mu_edge": np.log(truth["mu_edge"])}
    values = {p.name: values[p.name] for p in clean.null_parameters}
    # Slips are read in steps of the sampling; the twin takes that out. The others are exact.
    slips = clean.rows["static"].to_numpy(bool) & np.isin(clean.protocol, ["drag", "drop_drag"])
    clean.y = np.where(slips & keep, clean.predict(values, ()) + change, clean.y)
    null, weights = None, None
    for _ in range(2):
        sensitivity = clean.sensitivity(values)
        groups = make_groups(clean, sensitivity, keep)
        weights = Weights.build(groups, scatters, clean, sensitivity, keep)
        null = fit(clean, weights, (), values)
        values = null.as_dict()
    names = tuple(truth["effects"])
    inside = [name for name in names if name in MECHANISMS]

    def squares(name):
        """Of the best fit of a mechanism, free levels where what drives it is not recorded."""
        own = nuisance_columns(clean, clean.unrecorded(name) & keep, sensitivity)
        beside = weights if own is None else weights.with_nuisance(own)
        starts = MECHANISMS[name].starts or ({},)
        return min(fit(clean, beside, (name,), null.as_dict() | s).chi2 for s in starts)

    wrong = [
        squares(name) for name in MECHANISMS if truth["kind"] == "single" and name not in names
    ]
    each = []
    if len(names) == 2:
        for name in inside:
            each.append(squares(name))
    return null.chi2, min(wrong, default=0.0), each


def fresh_gain(case_folder, verdict):
    """Log-score gain a row on a fresh campaign, with its standard error by specimen."""
    fresh = assemble(read_case(case_folder))
    score = {}
    for name in ("null", "extended"):
        mean, sd = predict_model(verdict["models"][name], fresh)
        score[name] = -np.log(sd) - 0.5 * ((fresh.y - mean) / sd) ** 2
    ok = ~fresh.lower_bound
    gain = (score["extended"] - score["null"])[ok]
    specimens = fresh.specimen[ok]
    sums = np.array([gain[specimens == s].sum() for s in np.unique(specimens)])
    sizes = np.array([np.sum(specimens == s) for s in np.unique(specimens)])
    mean = sums.sum() / sizes.sum()
    spread = np.sqrt(np.sum((sums - mean * sizes) ** 2)) / sizes.sum()
    return float(mean), float(spread)


def coverage(verdict, truth):
    """(inside, total) over the named causes' parameters whose truth is known."""
    hits = total = 0
    for name, values in truth["effects"].items():
        if name not in verdict["causes"]:
            continue
        for key, value in values.items():
            label = {"r0": "wear_r0", "azimuth": "tilt_azimuth"}.get(key, key)
            entry = verdict["parameters"].get(label)
            if entry is None or label in ("wear_r0", "tilt_azimuth"):
                continue
            low, high = entry["ci95"]
            total += 1
            hits += low <= value <= high
    return hits, total


def one_case(seed, with_fresh):
    kind = KINDS[seed % len(KINDS)]
    with tempfile.TemporaryDirectory() as scratch:
        root = Path(scratch)
        truth = make_case(seed, kind, root / "case")
        start = time.process_time()
        case = read_case(root / "case")
        measured = assemble(case)
        analysis = analyse(measured)
        verdict = verdict_of(case, analysis, 1, "benchmark")
        cpu = time.process_time() - start
        record = {
            "seed": seed,
            "kind": kind,
            "effects": truth["effects"],
            "protocols": truth["protocols"],
            "verdict": verdict["verdict"],
            "causes": verdict["causes"],
            "alternatives": verdict["alternatives"],
            "reason": verdict["reason"],
            "global_p": verdict["null"]["global_p"],
            "ranking": verdict["ranking"][:4],
            "excluded": len(verdict["excluded_rows"]),
            "scatter": verdict["scatter"],
            "cpu_s": round(cpu, 2),
            "rows": len(measured.y),
        }
        if truth["effects"] and kind != "unrecorded":  # all strengths count there
            make_case(seed, kind, root / "clean", noise_free=True)
            make_case(seed, kind, root / "bare", noise_free=True, effect_free=True)
            record["lambda"], record["sep"], record["each"] = strength(
                root / "clean", root / "bare", measured, truth
            )
        record["coverage"] = coverage(verdict, truth)
        if with_fresh and verdict["verdict"] == "cause":
            make_case(seed, kind, root / "fresh", draw=1)
            record["gain"] = verdict["gain"]
            record["fresh_gain"] = fresh_gain(root / "fresh", verdict)
    return record


def wilson(hits, total):
    if not total:
        return "-"
    z, p = 1.96, hits / total
    centre = (p + z * z / (2 * total)) / (1 + z * z / total)
    half = z * np.sqrt(p * (1 - p) / total + z * z / (4 * total**2)) / (1 + z * z / total)
    return f"{p:.2f} [{max(centre - half, 0):.2f}, {min(centre + half, 1):.2f}] {hits}/{total}"


def table(records):
    """Lines (measure, target, rate) of the records."""

    def truth_set(r):
        return tuple(sorted(r["effects"]))

    def in_answer(r):
        answers = [tuple(sorted(a)) for a in r["alternatives"]] + [tuple(sorted(r["causes"]))]
        return truth_set(r) in answers

    def exact(r):
        return r["verdict"] == "cause" and tuple(sorted(r["causes"])) == truth_set(r)

    def false_single(r):
        return r["verdict"] == "cause" and tuple(sorted(r["causes"])) != truth_set(r)

    def rate(test, chosen):
        chosen = list(chosen)
        return wilson(sum(bool(test(r)) for r in chosen), len(chosen))

    nulls = [r for r in records if r["kind"] == "null"]
    single = [r for r in records if r["kind"] == "single"]
    strong = [r for r in single if r["lambda"] >= 25]
    ambiguous = [r for r in records if r["kind"] == "ambiguous" and r["lambda"] >= 25]
    pairs = [
        r for r in records if r["kind"] == "pair" and len(r["each"]) == 2 and min(r["each"]) >= 16
    ]
    outside = [r for r in records if r["kind"] == "outside"]
    unrecorded = [r for r in records if r["kind"] == "unrecorded"]
    gains = [r for r in records if "fresh_gain" in r]
    inside, total = (sum(r["coverage"][i] for r in records) for i in (0, 1))

    def covered(r):
        low, high = r["gain"]["ci95"]
        half, centre = (high - low) / 2, (high + low) / 2
        mean, error = r["fresh_gain"]
        return abs(mean - centre) <= np.hypot(half, 1.96 * error)

    named = ("cause", "confounded")
    cpu = [r["cpu_s"] for r in records]
    return [
        ("false alarm on null data", "<= 0.05", rate(lambda r: r["verdict"] != "none", nulls)),
        ("a cause named on null data", "<= 0.04", rate(lambda r: r["verdict"] in named, nulls)),
        (
            "exact cause, lambda and sep >= 25",
            ">= 0.92",
            rate(exact, [r for r in strong if r["sep"] >= 25]),
        ),
        ("truth in the answer, lambda >= 25", ">= 0.97", rate(in_answer, strong)),
        (
            "truth in the answer, lambda 9-25",
            ">= 0.70",
            rate(in_answer, [r for r in single if 9 <= r["lambda"] < 25]),
        ),
        (
            "false single cause",
            "<= 0.02",
            rate(false_single, [r for r in records if r["kind"] in ("single", "ambiguous")]),
        ),
        (
            "wrong name when lambda < 9",
            "<= 0.05",
            rate(
                lambda r: r["verdict"] in named and not in_answer(r),
                [r for r in single if r["lambda"] < 9],
            ),
        ),
        ("ambiguous designs: truth in the set", ">= 0.80", rate(in_answer, ambiguous)),
        ("ambiguous designs: overclaimed", "<= 0.05", rate(false_single, ambiguous)),
        ("pairs (both >= 16): truth in the set", ">= 0.70", rate(in_answer, pairs)),
        ("pairs (both >= 16): exact", ">= 0.50", rate(exact, pairs)),
        (
            "outside the library: unknown, lambda >= 25",
            ">= 0.75",
            rate(lambda r: r["verdict"] == "unknown", [r for r in outside if r["lambda"] >= 25]),
        ),
        (
            "outside the library: unknown, lambda >= 100",
            ">= 0.90",
            rate(lambda r: r["verdict"] == "unknown", [r for r in outside if r["lambda"] >= 100]),
        ),
        (
            "outside the library: a cause named falsely",
            "<= 0.05",
            rate(lambda r: r["verdict"] == "cause", outside),
        ),
        (
            "driving covariate never recorded: false cause",
            "<= 0.05",
            rate(lambda r: r["verdict"] == "cause", unrecorded),
        ),
        ("coverage of parameter intervals", "0.92-0.97", wilson(inside, total)),
        ("coverage of the gain's interval", ">= 0.90", rate(covered, gains)),
        (
            "CPU time a case (s)",
            "median <= 10, all <= 60",
            f"median {np.median(cpu):.1f}, largest {max(cpu):.1f}" if cpu else "-",
        ),
    ]


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=300)
    parser.add_argument("--first-seed", type=int, default=100_000)
    parser.add_argument("--records", type=Path, default=Path("criticise-benchmark.jsonl"))
    parser.add_argument("--minutes", type=float, default=1e9, help="stop after these")
    arguments = parser.parse_args()
    records = []
    if arguments.records.exists():
        records = [json.loads(line) for line in arguments.records.read_text().splitlines()]
    done = {r["seed"] for r in records}
    start = time.monotonic()
    for seed in range(arguments.first_seed, arguments.first_seed + arguments.cases):
        if seed in done:
            continue
        if time.monotonic() - start > 60 * arguments.minutes:
            break
        record = one_case(seed, with_fresh=seed % 2 == 0)
        records.append(record)
        with arguments.records.open("a") as file:
            file.write(json.dumps(record, default=float) + "\n")
        effect = {
            k: {n: round(float(x), 3) for n, x in v.items()} for k, v in record["effects"].items()
        }
        print(
            seed,
            record["kind"],
            effect,
            f"lambda {record.get('lambda', 0):.0f} sep {record.get('sep', 0):.0f}",
            "->",
            record["verdict"],
            record["causes"] or record["alternatives"],
            record["reason"][:30],
            f"p {record['global_p']:.3g}",
            f"{record['cpu_s']:.1f} s",
            file=sys.stderr,
            flush=True,
        )
    print(f"{len(records)} cases")
    for measure, target, value in table(records):
        print(f"{measure:48s} {target:24s} {value}")


if __name__ == "__main__":
    main()
