"""Reference friction as files: a table, all details, a picture."""

import csv
import json
from dataclasses import asdict
from pathlib import Path

from slipstitch.capture.reference.angles import read_angles
from slipstitch.capture.reference.estimate import Reference, estimate
from slipstitch.provenance import atomic_path, provenance_record, start_clock, write_sidecar

COLUMNS = (
    "material",
    "substrate",
    "mu",
    "error",
    "standard_error",
    "position_sd",
    "bench_error",
    "positions",
    "orientations",
    "measurements",
    "position_p",
    "orientation_p",
)


def reference_to_files(
    table: Path, out: Path, details: Path | None, picture: Path | None
) -> list[Reference]:
    """Estimate every pair of a table of slip angles, and write what is asked for.

    Parameters
    ----------
    table : path
        As `slipstitch.capture.reference.angles.read_angles` reads it, with its errors.
    out, details, picture : path
        CSV, JSON, PNG or SVG; the last two may be None.
    """
    started = start_clock()
    found = [(angles, estimate(angles)) for angles in read_angles(table)]
    references = [pair for _, pair in found]
    record = provenance_record("capture", inputs=[table], started=started)
    with atomic_path(out) as temporary, open(temporary, "w", newline="") as stream:
        writer = csv.DictWriter(stream, COLUMNS, extrasaction="ignore", lineterminator="\n")
        writer.writeheader()
        for pair in references:
            counts = {"positions": len(pair.by_position), "orientations": len(pair.by_orientation)}
            values = asdict(pair) | counts
            writer.writerow({key: _shown(values[key]) for key in COLUMNS})
    write_sidecar(out, record)
    if details:
        with atomic_path(details) as temporary:
            text = json.dumps([asdict(pair) for pair in references], indent=1, allow_nan=False)
            temporary.write_text(text + "\n", encoding="utf-8")
        write_sidecar(details, record)
    if picture:
        from slipstitch.capture.reference.angles_figure import draw_references

        with atomic_path(picture) as temporary:
            draw_references(found, temporary, picture.suffix[1:])
        write_sidecar(picture, record)
    return references


def _shown(value):
    return f"{value:.6g}" if isinstance(value, float) else value
