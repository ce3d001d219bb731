"""Share of correct verdicts on the bench of departures, with Wilson intervals.

``python benchmarks/criticise_departures.py --cases 300 --first-seed 7000 --processes 2``: even
seeds are campaigns without faults, odd ones with faults of the instruments, gaps and uneven
tracks. One line of JSON a case goes to --records, so that it can be stopped and resumed; then a
Markdown table is printed, and with --json the same with the seeds of all misses. The truth is read
only to score. With --adding, cases are judged again without each of their protocols instead.
"""

import argparse
import contextlib
import io
import json
import multiprocessing
import os
import runpy
import sys
import tempfile
import time
from pathlib import Path

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np
from scipy.stats import binomtest

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from support.departures import FAMILIES, make_case
from support.departures.sensors import REPORTABLE

from slipstitch.criticise.case import read_case
from slipstitch.criticise.measurements import assemble
from slipstitch.criticise.prediction.predictive import predict_model

KEPT = ("verdict", "causes", "alternatives", "parameters", "null", "gain", "scatter", "ranking")
# What a finding about the data may call the sensor that is wrong.
WORDS = {
    "inclinometer": ("inclinometer", "angle"),
    "camera": ("camera", "eps", "strain"),
    "force_cell": ("force",),
    "stage": ("stage", "turn"),
    "contact_camera": ("contact",),
    "edge_camera": ("te_x", "edge"),
}


def slipstitch(*words):
    """Run a verb in this process; exit code, or what was raised."""
    before, sys.argv = sys.argv, ["slipstitch", *map(str, words)]
    try:
        runpy.run_module("slipstitch", run_name="__main__")
    except SystemExit as stop:
        return stop.code
    except Exception as error:  # a traceback is a miss, not the end of the benchmark
        return f"{type(error).__name__}: {error}"
    finally:
        sys.argv = before


def judged(seed, with_gain=True, without=None):
    """Record of one case: truth, verdict, seconds; of its protocols may leave one out."""
    with tempfile.TemporaryDirectory() as scratch:
        root = Path(scratch)
        truth = make_case(seed, root / "case")
        if without is not None:
            for table in (root / "case").glob(f"{without}*.csv"):
                table.unlink()
            meta = json.loads((root / "case/meta.json").read_text())
            meta["protocols"].remove(without)
            (root / "case/meta.json").write_text(json.dumps(meta))
        out, said = root / "verdict.json", io.StringIO()
        start = time.perf_counter()
        cpu = time.process_time()
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            status = slipstitch("criticise", root / "case", "--out", out)
        record = {
            "truth": truth,
            "seconds": round(time.perf_counter() - start, 2),
            "cpu_s": round(time.process_time() - cpu, 2),
            "status": status,
            "said": said.getvalue().strip()[-300:],
        }
        verdict = json.loads(out.read_text()) if status == 0 else {"verdict": "refused"}
        record |= {key: verdict.get(key) for key in KEPT}
        record["findings"] = verdict.get("data_findings") or []
        if with_gain and verdict["verdict"] == "cause":
            make_case(seed, root / "fresh", repeat=1)
            record["fresh_gain"] = fresh_gain(root / "fresh", verdict)
    return record


def lost_by_adding(seed):
    """Each protocol without which the truth is found, and whether it is lost with it.

    None where a case is of no such family, or its effect too weak.
    """
    truth = judged(seed, with_gain=False)
    if truth["truth"]["family"] not in ("single", "pair", "ambiguous") or strength(truth) < 9:
        return None
    with tempfile.TemporaryDirectory() as scratch:
        make_case(seed, Path(scratch) / "case")
        meta = json.loads((Path(scratch) / "case/meta.json").read_text())
    fewer = {name: judged(seed, False, name) for name in meta["protocols"]}
    return [(name, not in_answer(truth)) for name, one in fewer.items() if in_answer(one)]


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


def exact(record):
    return record["verdict"] == "cause" and in_answer(record)


def wrong_cause(record):
    return record["verdict"] == "cause" and not in_answer(record)


def alarm(record):
    return record["verdict"] in ("cause", "confounded", "unknown") or record["status"] not in (0, 2)


def named(record):
    return record["verdict"] in ("cause", "confounded")


def blames_static(record):
    return any({"static_kinetic", "ageing"} & s for s in answers(record))


def sensor_found(record):
    fault = record["truth"]["faults"][0]
    for finding in record["findings"]:
        text = json.dumps(finding).lower()
        if fault["protocol"] in text and any(w in text for w in WORDS[fault["sensor"]]):
            return True
    return False


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


def strength(record):
    return record["truth"]["lambda"]


def of(*families, low=0.0, high=np.inf):
    """Cases of some families whose noncentrality is from ``low`` to ``high``."""
    return lambda r: r["truth"]["family"] in families and low <= strength(r) < high


def separable(record):
    return of("single", low=25)(record) and record["truth"]["separation"] >= 25


def clear_pair(record):
    return record["truth"]["family"] == "pair" and min(record["truth"]["each"]) >= 16


def one_fault(record):
    faults = record["truth"]["faults"]
    return record["truth"]["fault_kind"] == "one" and faults[0]["kind"] in REPORTABLE


EFFECTS = ("single", "pair", "ambiguous", "outside")
# measure, target (the last word says which side is right), whom it concerns, what is counted
MEASURES = (
    ("false alarm on null data", "<= .05", of("null"), alarm),
    ("cause named on null data", "<= .04", of("null"), named),
    ("exact cause, lambda and separation >= 25", ">= .92", separable, exact),
    ("truth in the answer, lambda >= 25", ">= .97", of("single", low=25), in_answer),
    ("truth in the answer, lambda 9-25", ">= .70", of("single", low=9, high=25), in_answer),
    ("false single cause", "<= .02", of("single", "ambiguous"), wrong_cause),
    ("ambiguous: truth in the set", ">= .80", of("ambiguous", low=25), in_answer),
    ("ambiguous: overclaimed", "<= .05", of("ambiguous", low=25), wrong_cause),
    ("pairs (each >= 16): exact", ">= .50", clear_pair, exact),
    ("pairs (each >= 16): truth in the set", ">= .70", clear_pair, in_answer),
    (
        "outside the library: unknown, lambda >= 25",
        ">= .75",
        of("outside", low=25),
        lambda r: r["verdict"] == "unknown",
    ),
    (
        "outside the library: false cause",
        "<= .05",
        of("outside"),
        lambda r: r["verdict"] == "cause",
    ),
    (
        "strong (lambda >= 100) answered none",
        "<= .02",
        of(*EFFECTS, low=100),
        lambda r: r["verdict"] == "none",
    ),
    ("sorted session named singly", "<= .05", of("sorted"), lambda r: r["verdict"] == "cause"),
    ("uneven track in (e): static friction named", "<= .05", of("track"), blames_static),
    (
        "one sensor wrong: false alarm on null data",
        "<= .05",
        lambda r: of("null")(r) and one_fault(r),
        alarm,
    ),
    ("one sensor wrong: sensor found", ">= .80", one_fault, sensor_found),
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
    rows.append(("parameter intervals", ".92-.97", rate, [s for c, s in inside if not c]))
    broken = [r["truth"]["seed"] for r in records if r["status"] not in (0, 2)]
    rows.append(("traceback", "0", wilson(len(broken), len(records)), broken))
    for key, label in (("seconds", "seconds a case"), ("cpu_s", "CPU seconds a case")):
        values = [r[key] for r in records]
        text = f"median {np.median(values):.1f}, largest {max(values):.1f}" if values else "-"
        rows.append((label, "median <= 5, all <= 60", text, []))
    return rows


def markdown(records):
    """The table, without and with departures side by side."""
    halves = [[r for r in records if r["truth"]["departures"] == d] for d in (False, True)]
    lines = [
        f"| measure | target | without departures ({len(halves[0])}) "
        f"| with departures ({len(halves[1])}) |",
        "|---|---|---|---|",
    ]
    for one, two in zip(*map(scored, halves), strict=True):
        lines.append(f"| {one[0]} | {one[1]} | {one[2]} | {two[2]} |")
    return "\n".join(lines)


def _work(task):
    return judged(*task)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=300)
    parser.add_argument("--first-seed", type=int, default=7000)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--records", type=Path, default=Path("criticise-departures.jsonl"))
    parser.add_argument("--json", type=Path, help="rates and seeds of misses")
    parser.add_argument("--families", nargs="+", choices=sorted(set(FAMILIES)))
    parser.add_argument(
        "--adding", action="store_true", help="only: does adding a protocol lose the truth?"
    )
    parser.add_argument("--no-gain", action="store_true", help="no fresh campaigns")
    arguments = parser.parse_args()
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.cases)
    if arguments.adding:
        with multiprocessing.get_context("spawn").Pool(arguments.processes) as pool:
            cases = [found for found in pool.imap(lost_by_adding, seeds) if found is not None]
        lost = [was_lost for found in cases for _, was_lost in found]
        print(
            f"{len(cases)} cases; truth lost by a further protocol: {wilson(sum(lost), len(lost))}"
        )
        return
    records = []
    if arguments.records.exists():
        records = [json.loads(line) for line in arguments.records.read_text().splitlines()]
        records = [r for r in records if r["truth"]["seed"] in seeds]
    done = {r["truth"]["seed"] for r in records}
    families = set(arguments.families or FAMILIES)
    tasks = [
        (seed, not arguments.no_gain)
        for seed in seeds
        if seed not in done and FAMILIES[(seed // 2) % len(FAMILIES)] in families
    ]
    with multiprocessing.get_context("spawn").Pool(arguments.processes) as pool:
        for record in pool.imap_unordered(_work, tasks):
            records.append(record)
            with arguments.records.open("a", encoding="utf-8") as file:
                file.write(json.dumps(record, default=float) + "\n")
            truth = record["truth"]
            answer = record["causes"] or record["alternatives"] or ""
            print(
                f"{truth['seed']} {truth['family']} {truth['effects']} {truth['fault_kind']} "
                f"lambda {truth['lambda']:.0f} -> {record['verdict']} {answer} "
                f"{record['seconds']:.1f} s",
                file=sys.stderr,
                flush=True,
            )
    records.sort(key=lambda r: r["truth"]["seed"])
    print(markdown(records))
    if arguments.json:
        result = {
            half: [
                dict(zip(("measure", "target", "rate", "misses"), row, strict=True))
                for row in scored([r for r in records if r["truth"]["departures"] == departs])
            ]
            for half, departs in (("without", False), ("with", True))
        }
        arguments.json.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
