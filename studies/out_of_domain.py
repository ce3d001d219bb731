"""Out-of-domain test: the instrument that ships, on a dataset of another domain.

    snakemake --cores 2 sample --configfile config.yaml config/paper.yaml config/instrument.yaml \
        other.yaml --directory ../other
    python studies/out_of_domain.py ../other/results/sample --by friction --out scores.json

`other.yaml` says what differs from the training domain: coefficients between those of the grid,
other fabrics (`simulation.model` with `mass_error`, `bending_error`), cameras further aside
(`render.bench_camera`), clamps at other heights (`simulation.height_sd_m`). No simulation of the
dataset may have trained the instrument. A study: asked once, not maintained.
"""

import argparse
import json
from pathlib import Path

import numpy as np

from slipstitch.dataset.videos import read_videos
from slipstitch.film.measure import SHIPPED
from slipstitch.learning.evaluation.metrics import BY_NAME, PredictionsAndTruth
from slipstitch.learning.instrument.measuring import load_instrument
from slipstitch.learning.instrument.poses import poses_of


def predictions(dataset, instrument):
    """Return one row a video: labels, prediction, interval, alarm."""
    videos = read_videos(dataset, pixels=instrument.settings.pixels)
    rows = []
    for row, frames in zip(videos.rows, instrument.frames_of(videos).pixels, strict=True):
        found = instrument.measure(frames, pose=poses_of([row])[0])
        low, high = found.interval_90
        rows.append(
            row
            | {"prediction": found.friction_coefficient, "low": low, "high": high}
            | {"alarm": found.alarm}
        )
    return rows


def scores(rows):
    """Return the scores of the rows; every simulation counts once for the coverage."""
    answers = PredictionsAndTruth(
        np.array([row["prediction"] for row in rows]),
        np.array([row["friction"] for row in rows]),
        intervals=np.array([(row["low"], row["high"]) for row in rows]),
        groups=[row["simulation"] for row in rows],
        alarms=np.array([row["alarm"] for row in rows]),
    )
    covered, error = answers.coverage
    return {
        "videos": len(rows),
        "simulations": len({row["simulation"] for row in rows}),
        "mean_absolute_error": BY_NAME["mean_absolute_error"].compute(answers),
        "within_0_1": BY_NAME["within_0.1"].compute(answers),
        "coverage_90": covered,
        "coverage_90_error": error if np.isfinite(error) else None,
        "interval_width": float(np.mean([row["high"] - row["low"] for row in rows])),
        "alarms": BY_NAME["alarms"].compute(answers),
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("dataset", type=Path, help="results/sample of the other domain")
    parser.add_argument("--by", default="friction", help="column of the manifest to group by")
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    rows = predictions(arguments.dataset, load_instrument(SHIPPED))
    parts = {"all": rows} | {
        str(value): [row for row in rows if row[arguments.by] == value]
        for value in sorted({row[arguments.by] for row in rows})
    }
    found = {name: scores(part) for name, part in parts.items()}
    arguments.out.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(found["all"], indent=1))


if __name__ == "__main__":
    main()
