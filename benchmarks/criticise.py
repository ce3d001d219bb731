"""Share of correct verdicts on campaigns with a known truth, with Wilson intervals.

``python benchmarks/criticise.py --processes 2`` judges 300 campaigns of fixed seeds;
``--first-seed N`` others, ``--fresh`` some that nobody has seen. The campaigns come from forward
models of their own (tests/support/departures). Even seeds are sound benches, odd ones have faults:
zeros, delays, tails, gaps, quantised readings, covariates that were not recorded, uneven tracks,
and one sensor whose noise is 1, 1.5 or 2 times that of the others. Of both, a third each has 0, 2
or 5 % of runs that lie far off. One line of JSON a case goes to --records, so that it can be
stopped and resumed. A Markdown table is printed; --json holds the same with the seeds of all
misses. The truth is read only to score. What lambda, the noncentrality of effects and faults, is
conditional on is said in tests/support/departures/strength.py.
"""

import argparse
import json
import multiprocessing
import os
import sys
import tempfile
import time
from pathlib import Path

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np
from scipy.stats import binomtest

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from support.departures import campaign
from support.departures.sensors import CATALOGUE, REPORTABLE

from slipstitch.base.errors import BadInput
from slipstitch.criticise.case import read_case
from slipstitch.criticise.measurements import assemble
from slipstitch.criticise.prediction import predict_model
from slipstitch.criticise.statement import statement
from slipstitch.criticise.verdict import analyse
from slipstitch.criticise.verdict_data import verdict_of

# What campaigns from 300000 to 320299 got wrong led to changes of the criticism.
FIRST_SEED, CASES = 330_000, 300
OUTLIERS, NOISE = (0.0, 0.02, 0.05), (1.0, 1.5, 2.0)
KEPT = ("verdict", "causes", "alternatives", "reason", "parameters", "null", "gain", "ranking")
# What effects of no library follow, as a verdict calls it.
FOLLOWS = {
    "memory": "run_before",
    "thermal": "time_in_session",
    "cleaning": "time_in_session",
    "patch": "place",
    "periodic": "place",
}
# What a finding about the data may call the sensor that is wrong.
WORDS = {
    "inclinometer": ("inclinometer", "angle"),
    "camera": ("camera", "eps", "strain"),
    "force_cell": ("force",),
    "stage": ("stage", "turn"),
    "contact_camera": ("contact",),
    "edge_camera": ("te_x", "edge"),
}


def plan_of(seed):
    """The campaign of a seed, with its share of far readings and its noisy sensor."""
    plan = campaign.draw_plan(seed)
    rng = np.random.default_rng([seed, 51_000])
    plan.outliers = float(rng.choice(OUTLIERS))
    if plan.departures and not plan.units:
        sensors = [(p, e) for p in plan.protocols for e in CATALOGUE[p] if e[2] == "noise"]
        protocol, (sensor, column, *_) = sensors[rng.integers(len(sensors))]
        known = {(f["protocol"], f["quantity"], f["kind"]) for f in plan.faults}
        factor = float(rng.choice(NOISE))
        if factor > 1 and (protocol, column, "noise") not in known and plan.fault_kind != "one":
            fault = {"protocol": protocol, "sensor": sensor, "quantity": column, "kind": "noise"}
            plan.faults.append(fault | {"size": factor, "unit": "1"})
    return plan


def judged(seed):
    """Record of one case: truth, verdict, seconds, and for a cause the gain on a fresh campaign."""
    plan = plan_of(seed)
    with tempfile.TemporaryDirectory() as scratch:
        root = Path(scratch)
        campaign.write(plan, root / "case")
        record = {"truth": campaign.truth_of(plan) | {"outliers": plan.outliers}, "error": ""}
        start, cpu = time.perf_counter(), time.process_time()
        verdict = {"verdict": "refused"}
        try:
            case = read_case(root / "case")
            verdict = verdict_of(case, analyse(assemble(case)), 1, "benchmark")
            record["said"] = statement(verdict)
        except BadInput as error:
            record["said"] = str(error)
        except Exception as error:  # a traceback is a miss, not the end of the benchmark
            record["error"] = f"{type(error).__name__}: {error}"
        record["seconds"] = round(time.perf_counter() - start, 2)
        record["cpu_s"] = round(time.process_time() - cpu, 2)
        record |= {key: verdict.get(key) for key in KEPT}
        record["findings"] = verdict.get("data_findings") or []
        if verdict["verdict"] == "cause":
            campaign.write(plan, root / "fresh", 1)
            record["fresh_gain"] = fresh_gain(root / "fresh", verdict)
    return record


def fresh_gain(folder, verdict):
    """Mean gain in log score a row on a further campaign, and its standard error by specimen."""
    fresh = assemble(read_case(folder))
    scores = {}
    for name in ("null", "extended"):
        mean, sd = predict_model(verdict["models"][name], fresh)
        scores[name] = -np.log(sd) - ((fresh.y - mean) / sd) ** 2 / 2
    use = ~fresh.lower_bound
    gain, index = (scores["extended"] - scores["null"])[use], fresh.specimen[use]
    _, index, sizes = np.unique(index, return_inverse=True, return_counts=True)
    mean = gain.mean()
    sums = np.bincount(index, gain) - mean * sizes
    return [float(mean), float(np.sqrt(np.sum(sums**2)) / len(gain))]


def answers(record):
    """Every set of causes that the verdict leaves possible."""
    sets = [record["causes"] or [], *(record["alternatives"] or [])]
    return [frozenset(s) for s in sets if s]


def in_answer(record):
    return frozenset(record["truth"]["effects"]) in answers(record)


def verdict_is(*kinds):
    return lambda record: record["verdict"] in kinds


def exact(record):
    return record["verdict"] == "cause" and in_answer(record)


def wrong_cause(record):
    return record["verdict"] == "cause" and not in_answer(record)


def blames_static(record):
    return any({"static_kinetic", "ageing"} & s for s in answers(record))


def sensor_found(record):
    fault = record["truth"]["faults"][0]
    found = [json.dumps(finding).lower() for finding in record["findings"]]
    words = WORDS[fault["sensor"]]
    return any(fault["protocol"] in text and any(w in text for w in words) for text in found)


def flagged(record):
    return record["verdict"] in ("insufficient", "refused") or bool(record["findings"])


def gain_covered(record):
    low, high = record["gain"]["ci95"]
    mean, error = record["fresh_gain"]
    return abs(mean - (low + high) / 2) <= np.hypot((high - low) / 2, 1.96 * error)


def covered(record):
    """Per named and true cause: is its size within the interval?"""
    result = []
    for name, values in record["truth"]["effects"].items():
        entry = (record["parameters"] or {}).get(name)
        if name in (record["causes"] or []) and entry:
            result.append(entry["ci95"][0] <= values[name] <= entry["ci95"][1])
    return result


def of(*families, low=0.0, high=np.inf):
    """Cases of some families whose noncentrality is from ``low`` to ``high``."""
    return lambda r: r["truth"]["family"] in families and low <= r["truth"]["lambda"] < high


def separable(record):
    return of("single", low=25)(record) and record["truth"]["separation"] >= 25


def clear_pair(record):
    return record["truth"]["family"] == "pair" and min(record["truth"]["each"]) >= 16


def one_fault(record):
    faults = record["truth"]["faults"]
    return record["truth"]["fault_kind"] == "one" and faults[0]["kind"] in REPORTABLE


def clear_fault(record):
    return one_fault(record) and record["truth"]["fault_strength"] >= 25


def unknown_or_its_order(record):
    """Unknown; or confounded with what the effect follows: time, place, or the run before."""
    follows = {FOLLOWS.get(name) for name in record["truth"]["effects"]}
    confounded = record["verdict"] == "confounded"
    return UNKNOWN(record) or (confounded and any(follows & s for s in answers(record)))


def far_and_strong(record):
    return of(*EFFECTS, low=100)(record) and record["truth"]["outliers"] == OUTLIERS[-1]


EFFECTS = ("single", "pair", "ambiguous", "outside")
ALARM, NAMED = verdict_is("cause", "confounded", "unknown"), verdict_is("cause", "confounded")
CAUSE, UNKNOWN, NONE = verdict_is("cause"), verdict_is("unknown"), verdict_is("none")
# Measure, target (its sign says which side is right), whom it concerns, what is counted.
MEASURES = (
    ("false alarm on null data", "<= .05", of("null"), ALARM),
    ("cause named on null data", "<= .03", of("null"), NAMED),
    ("exact cause, lambda and separation >= 25", ">= .92", separable, exact),
    ("truth in the answer, lambda >= 25", ">= .95", of("single", low=25), in_answer),
    ("truth in the answer, lambda 9-25", ">= .70", of("single", low=9, high=25), in_answer),
    ("false single cause", "<= .02", of("single", "ambiguous"), wrong_cause),
    ("ambiguous: truth in the set", ">= .80", of("ambiguous", low=25), in_answer),
    ("ambiguous: overclaimed", "<= .05", of("ambiguous", low=25), wrong_cause),
    ("pairs (each >= 16): exact", ">= .50", clear_pair, exact),
    ("pairs (each >= 16): truth in the set", ">= .70", clear_pair, in_answer),
    (
        "outside, lambda >= 25: unknown, or confounded with what it follows",
        ">= .80",
        of("outside", low=25),
        unknown_or_its_order,
    ),
    ("outside: false cause", "<= .04", of("outside"), CAUSE),
    ("lambda >= 100: answered none", "<= .01", of(*EFFECTS, low=100), NONE),
    ("lambda >= 100, 5 % far readings: none", "<= .01", far_and_strong, NONE),
    ("sorted session named singly", "<= .05", of("sorted"), CAUSE),
    ("uneven track in (e): static friction named", "<= .05", of("track"), blames_static),
    ("one sensor wrong, null: alarm", "<= .05", lambda r: of("null")(r) and one_fault(r), ALARM),
    ("one sensor wrong, its lambda >= 25: sensor found", ">= .80", clear_fault, sensor_found),
    ("wrong units flagged", ">= .95", of("units"), flagged),
    ("gain's interval", ">= .90", lambda r: "fresh_gain" in r, gain_covered),
)


def wilson(hits, total):
    """Share with Wilson's 95 % interval."""
    if not total:
        return "-"
    low, high = binomtest(int(hits), int(total)).proportion_ci(0.95, method="wilson")
    return f"{hits / total:.2f} [{low:.2f}, {high:.2f}] {hits}/{total}"


def scored(records):
    """Rows of the table: measure, target, rate and seeds of the misses."""
    rows = []
    for measure, target, concerned, counted in MEASURES:
        chosen = [r for r in records if concerned(r)]
        hits = [bool(counted(r)) for r in chosen]
        wanted = target.startswith(">=")
        misses = [r["truth"]["seed"] for r, h in zip(chosen, hits, strict=True) if h != wanted]
        rows.append((measure, target, wilson(sum(hits), len(hits)), misses))
    inside = [(c, r["truth"]["seed"]) for r in records for c in covered(r)]
    rate = wilson(sum(c for c, _ in inside), len(inside))
    rows.append(("parameters' intervals", ".92-.97", rate, [s for c, s in inside if not c]))
    broken = [r["truth"]["seed"] for r in records if r["error"]]
    rows.append(("traceback", "0", wilson(len(broken), len(records)), broken))
    cpu = [r["cpu_s"] for r in records] or [np.nan]
    text = f"median {np.median(cpu):.1f}, 95 % {np.quantile(cpu, 0.95):.1f}, all {max(cpu):.1f}"
    rows.append(("CPU seconds a case", "median <= 4, 95 % <= 12", text, []))
    return rows


def markdown(records):
    """The table: sound benches, benches with faults, all."""
    sound = [r for r in records if not r["truth"]["departures"]]
    faulty = [r for r in records if r["truth"]["departures"]]
    columns = [scored(part) for part in (sound, faulty, records)]
    lines = [
        f"| measure | target | sound ({len(sound)}) | with faults ({len(faulty)}) | all |",
        "|---|---|---|---|---|",
    ]
    for one, two, three in zip(*columns, strict=True):
        lines.append(f"| {one[0]} | {one[1]} | {one[2]} | {two[2]} | {three[2]} |")
    return "\n".join(lines)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=CASES)
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED)
    parser.add_argument("--fresh", action="store_true", help="seeds from the system's entropy")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--records", type=Path, default=Path("criticise-benchmark.jsonl"))
    parser.add_argument("--json", type=Path, help="rates, and seeds of misses")
    parser.add_argument("--families", nargs="+", choices=sorted(set(campaign.FAMILIES)))
    arguments = parser.parse_args()
    first = arguments.first_seed
    if arguments.fresh:
        first = int(np.random.default_rng().integers(10**6, 10**9))
        print(f"first seed {first}", file=sys.stderr)
    seeds = range(first, first + arguments.cases)
    records = []
    if arguments.records.exists():
        records = [json.loads(line) for line in arguments.records.read_text().splitlines()]
        records = [r for r in records if r["truth"]["seed"] in seeds]
    done = {r["truth"]["seed"] for r in records}
    wanted = set(arguments.families or campaign.FAMILIES)
    families = campaign.FAMILIES
    tasks = [s for s in seeds if s not in done and families[(s // 2) % len(families)] in wanted]
    with multiprocessing.get_context("spawn").Pool(arguments.processes) as pool:
        for record in pool.imap_unordered(judged, tasks):
            records.append(record)
            with arguments.records.open("a", encoding="utf-8") as file:
                file.write(json.dumps(record, default=float) + "\n")
            truth = record["truth"]
            answer = record["causes"] or record["alternatives"] or ""
            print(
                f"{truth['seed']} {truth['family']} {truth['effects']} lambda "
                f"{truth['lambda']:.0f} -> {record['verdict']} {answer} {record['cpu_s']:.1f} s",
                file=sys.stderr,
                flush=True,
            )
    records.sort(key=lambda r: r["truth"]["seed"])
    print(markdown(records))
    if arguments.json:
        found = [
            dict(zip(("measure", "target", "rate", "misses"), row, strict=True))
            for row in scored(records)
        ]
        result = {"first_seed": first, "cases": len(records), "table": markdown(records)}
        text = json.dumps(result | {"rates": found}, indent=1)
        arguments.json.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
