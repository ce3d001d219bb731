"""Published readings with the intervals of an average whose intervals were stretched otherwise.

    python benchmarks/stretched_again.py

`slipstitch instrument --recalibrate` leaves medians and alarms as they are, and stretches both
halves of every interval by one factor: what was read before need not be read again. Writes
reach.json, angles.json and surrogates.json in results/published/camera anew, if they are of the
average from which the published one was recalibrated.
"""

import argparse
import json

import instrument_angles
import instrument_reach
import instrument_surrogates
from filmed import PUBLISHED, FilmedSet, models, publish

from slipstitch.base.provenance import file_digest, read_sidecar
from slipstitch.learning.instrument.measuring import load_instrument

MADE_BY = {
    "reach": instrument_reach,
    "angles": instrument_angles,
    "surrogates": instrument_surrogates,
}
# Readings are published rounded, so that other scores would be a little off.
OF_INTERVALS = ("coverage_90", "coverage_90_error", "interval_width")


def stretched(row, ratio, largest):
    """A reading with halves of its interval so many times as long; cut where the grid ends.

    A half that is cut already stays so: `ratio` is at least 1.
    """
    reading, low, high = row["reading"], row["low"], row["high"]
    ends = {
        "low": max(0.0, reading - ratio * (reading - low)) if low > 0 else 0.0,
        "high": min(largest, reading + ratio * (high - reading)) if high < largest else largest,
    }
    return row | ends


def renewed(old, new):
    """Scores of before, those of intervals in the place of what they were."""
    kept = {name: old[name] for name in old if name not in ("readings", "stretched_from")}
    for name, entry in kept.items():
        if name in OF_INTERVALS:
            kept[name] = new[name]
        elif isinstance(entry, dict) and name != "trainings":
            kept[name] = renewed(entry, new[name])
    return kept


def main():
    argparse.ArgumentParser(description=__doc__).parse_args()
    average = load_instrument(models()[-1])
    before = average.card.get("recalibrated_from")
    if before is None or before["factor"] is None:
        raise SystemExit("the published average was not recalibrated from one with intervals")
    ratio = average.factor / before["factor"]
    if ratio < 1:
        raise SystemExit(
            f"intervals were cut before they got shorter by {ratio:g}: read them again"
        )
    for name, benchmark in MADE_BY.items():
        path = PUBLISHED / "camera" / f"{name}.json"
        if before["weights_sha256"] not in read_sidecar(path)["inputs"].values():
            print(f"{path.name}: not of the average from which the published one was recalibrated")
            continue
        old = json.loads(path.read_text(encoding="utf-8"))
        every = [
            stretched(row, ratio, average.settings.friction_max) if row["seed"] is None else row
            for row in old["readings"]
        ]
        sets = [
            FilmedSet(of, changes, changes.pop("model", None))
            for of, changes in read_sidecar(path)["config"].items()
        ]
        read = {"readings_sha256": file_digest(path), "factor": before["factor"]}
        result = renewed(old, benchmark.result_of(every))
        publish(name, result | {"stretched_from": read}, sets, every)


if __name__ == "__main__":
    main()
