"""Readings of videos of known friction of other benches, which widen an instrument's intervals.

Other benches have other clamps, fabrics and cloths than those of the instrument's own dataset. What
it reads there, with the coefficients that are true, is all that the conformal step needs to allow
for them (`slipstitch.learning.instrument.conformal`).
"""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import file_digest, read_json, read_parquet, read_sidecar
from slipstitch.dataset.videos import Videos
from slipstitch.learning.instrument.augmentation import phased
from slipstitch.learning.instrument.distribution import conformal_scales
from slipstitch.learning.instrument.measuring import Instrument
from slipstitch.learning.instrument.poses import poses_of

#: File of an average with the readings that calibrated it.
READINGS = "readings.parquet"
#: Columns of a reading, in `READINGS` and in the files that `read_readings` reads.
COLUMNS = ("simulation", "friction", "reading", "low", "high")
READINGS_SCHEMA = pa.schema(
    [
        ("source", pa.string()),  # digest of the dataset, SHA-256 of the file
        ("dataset", pa.string()),  # its digest, if it is known
        ("simulation", pa.string()),  # videos of one are right or wrong together
        *((name, pa.float64()) for name in COLUMNS[1:]),
        ("stretch", pa.float64()),  # conformal scale at which the interval just holds
    ]
)


#: Rows as `READINGS_SCHEMA`, with the conformal scales at which their intervals just hold.
Readings = list[dict[str, Any]]


def groups_of(readings: Readings) -> list[str]:
    """Return the simulation of each, told apart from those of other sources."""
    return [f"{row['source']} {row['simulation']}" for row in readings]


def sources_of(readings: Readings) -> list[dict[str, Any]]:
    """Return for each source its digest, and the numbers of its videos and simulations."""
    return [
        {
            "digest": source,
            "videos": len(own),
            "simulations": len({row["simulation"] for row in own}),
        }
        for source in dict.fromkeys(row["source"] for row in readings)
        for own in [[row for row in readings if row["source"] == source]]
    ]


def readings_on(instrument: Instrument, videos: Videos) -> Readings:
    """Return what a calibrated instrument reads of the videos of a dataset."""
    frames = phased(videos.pixels, instrument.card["frames"], None)
    answers = instrument.answers(frames, np.random.default_rng(0), poses_of(videos.rows))
    distributions = instrument.distributions(answers.probabilities)
    friction = np.array([row["friction"] for row in videos.rows])
    scores = instrument.needed_scale(distributions, friction)
    return [
        {
            "source": videos.digest,
            "dataset": videos.digest,
            "simulation": row["simulation"],
            "friction": row["friction"],
            "reading": float(reading),
            "low": float(low),
            "high": float(high),
            "stretch": float(score),
        }
        for row, (reading, low, high), score in zip(
            videos.rows, instrument.intervals(distributions), scores, strict=True
        )
    ]


def read_readings(path: str | Path, instrument: Instrument) -> Readings:
    """Return the readings by an instrument that a JSON file lists, as those of studies do.

    The file is a mapping with ``readings``: a list of mappings with at least the `COLUMNS`.
    Where one has a ``seed`` that is not null, a single training made it, and it is left out.
    The file's record, or its entry ``weights_sha256``, names the weights of the instrument; its
    entry ``dataset``, if there is one, is the digest of the dataset that was read.

    BadInput if the file is missing, damaged, without such a list, or of another instrument, or
    of one without an error bar; if a reading is no number, outside of its interval, or of a
    coefficient that the instrument cannot say.
    """
    content = read_json(path)
    rows = content.get("readings") if isinstance(content, dict) else None
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise BadInput(f"{path}: must be a mapping with readings, a list of mappings")
    _check_of(path, content, instrument)
    if not math.isfinite(instrument.conformal_scale):
        raise BadInput(f"{path}: of an instrument whose intervals are the whole grid")
    largest = instrument.settings.friction_max
    found = [
        _checked(row, f"{path}: reading {number}", largest)
        for number, row in enumerate(rows)
        if row.get("seed") is None
    ]
    if not found:
        raise BadInput(f"{path}: has no reading of the instrument")
    truth = np.array([row["friction"] for row in found])
    intervals = np.array([[row["reading"], row["low"], row["high"]] for row in found])
    scores = conformal_scales(intervals, truth)
    dataset = content.get("dataset")
    of_file = {
        "source": file_digest(path),
        "dataset": dataset if isinstance(dataset, str) else None,
    }
    # The intervals are scaled already.
    scale = instrument.conformal_scale
    return [
        of_file | row | {"stretch": float(score * scale)}
        for row, score in zip(found, scores, strict=True)
    ]


def _checked(row: dict[str, Any], where: str, largest: float) -> dict[str, Any]:
    """The `COLUMNS` of a reading; BadInput if it cannot be one, on a grid that ends at largest."""
    simulation, *values = (row.get(name) for name in COLUMNS)
    if not isinstance(simulation, str) or not all(map(_is_number, values)):
        raise BadInput(
            f"{where}: simulation must be a text, {', '.join(COLUMNS[1:])} must be numbers"
        )
    friction, reading, low, high = map(float, values)
    # Only where the grid ends has an interval no length to one side.
    if not (
        0 <= low <= reading <= high <= largest
        and (low < reading or low == 0)
        and (reading < high or high == largest)
    ):
        raise BadInput(f"{where}: 0 <= low < reading < high <= {largest:g} is required")
    if not 0 <= friction <= largest:
        raise BadInput(
            f"{where}: friction is {friction:g}; the instrument can say 0 to {largest:g}"
        )
    return dict(zip(COLUMNS, (simulation, friction, reading, low, high), strict=True))


def _is_number(value: Any) -> bool:
    try:
        return type(value) in (int, float) and math.isfinite(value)
    except OverflowError:  # an integer of hundreds of digits
        return False


def _check_of(path: str | Path, content: dict[str, Any], instrument: Instrument) -> None:
    """BadInput unless the readings are of the instrument, with the error bars that it has."""
    weights = instrument.card["weights_sha256"]
    named = content.get("weights_sha256")
    try:
        inputs = read_sidecar(path).get("inputs")
    except FileNotFoundError:
        inputs = None
    if weights != named and weights not in (inputs if isinstance(inputs, dict) else {}).values():
        raise BadInput(
            f"{path}: names no readings of this instrument: its record, or weights_sha256 in it, "
            f"must name the weights {weights}"
        )


def kept_readings(folder: str | Path) -> Readings:
    """Return those that calibrated an average; none where its folder has no such file."""
    path = Path(folder) / READINGS
    return read_parquet(path, READINGS_SCHEMA.names).to_pylist() if path.is_file() else []
