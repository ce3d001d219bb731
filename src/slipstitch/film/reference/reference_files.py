"""Reference friction as files: a table, all details, a picture."""

from dataclasses import asdict
from pathlib import Path

import pandas

from slipstitch.base.provenance import provenance_record, recorded_path, start_clock, write_json
from slipstitch.film.reference.angles import read_angles
from slipstitch.film.reference.estimate import Reference, estimate

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
        As `slipstitch.film.reference.angles.read_angles` reads it, with its errors.
    out, details, picture : path
        CSV, JSON, PNG or SVG; the last two may be None.
    """
    started = start_clock()
    found = [(angles, estimate(angles)) for angles in read_angles(table)]
    references = [pair for _, pair in found]
    record = provenance_record("capture", inputs=[table], started=started)
    rows = [
        asdict(pair)
        | {"positions": len(pair.by_position), "orientations": len(pair.by_orientation)}
        for pair in references
    ]
    with recorded_path(out, record) as temporary:
        content = pandas.DataFrame(rows, columns=list(COLUMNS))
        content.to_csv(temporary, index=False, float_format="%.6g")
    if details:
        write_json(details, [asdict(pair) for pair in references], record)
    if picture:
        from slipstitch.film.reference.angles_figure import draw_references

        with recorded_path(picture, record) as temporary:
            draw_references(found, temporary, picture.suffix[1:])
    return references
