"""The instrument that ships on fabrics, coefficients and cloths beside those that train.

    python benchmarks/drawn_fabrics.py --dataset ../error_bars/results/sample

The dataset is that of config/error_bars.yaml. Goes to results/published/camera/drawn_fabrics.json.
"""

import argparse
import json
from pathlib import Path

import numpy as np
from filmed import PUBLISHED, ROOT, SHIPPED, FilmedSet, models, of_each_simulation, publish, reading
from instrument_reach import scores

from slipstitch.base.provenance import file_digest
from slipstitch.config.load import read_mapping
from slipstitch.dataset.videos import read_videos
from slipstitch.learning.instrument.measuring import load_instrument

CONFIG = "config/error_bars.yaml"


def common(rows):
    """Root mean square of the errors that all videos of a simulation share, and of the rest."""
    errors = [
        np.array([row["reading"] - row["friction"] for row in each])
        for each in of_each_simulation(rows)
    ]
    return {
        "rms_common": float(np.sqrt(np.mean([each.mean() ** 2 for each in errors]))),
        "rms_other": float(np.sqrt(np.mean([each.var() for each in errors]))),
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--dataset", type=Path, required=True, help="results/sample")
    parser.add_argument("--run", default=SHIPPED, help="folder of results/published")
    arguments = parser.parse_args()
    instrument = load_instrument(models(arguments.run)[-1])
    place = PUBLISHED / "camera" / "drawn_fabrics.json"
    used = [one["digest"] for one in instrument.card.get("calibration_readings", ())]
    if place.is_file() and file_digest(place) in used:
        raise SystemExit(f"{place.name} stretches the intervals of this instrument: kept")
    videos = read_videos(arguments.dataset, pixels=instrument.settings.pixels)
    rows = [
        {name: row[name] for name in ("simulation", "material", "friction", "texture")}
        | reading(instrument, video, row)
        for row, video in zip(videos.rows, videos.pixels, strict=True)
    ]
    parts = {"all": rows} | {
        f"{friction:g}": [row for row in rows if row["friction"] == friction]
        for friction in sorted({row["friction"] for row in rows})
    }
    result = {name: scores(part) | common(part) for name, part in parts.items()}
    result["dataset"] = videos.digest
    changes = read_mapping(ROOT / CONFIG)
    publish("drawn_fabrics", result, [FilmedSet("drawn_fabrics", changes)], rows, arguments.run)
    print(json.dumps({name: result[name] for name in parts}, indent=1))


if __name__ == "__main__":
    main()
