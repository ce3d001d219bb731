"""Reference friction as files: a table, all details, a picture."""

import os
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import matplotlib
import numpy as np
import pandas
from matplotlib.figure import Figure

from slipstitch.base.page.figures import FIXED_IDS, plain_text, save_figure
from slipstitch.base.page.palette import BLACK, INTERVAL, SERIES
from slipstitch.base.provenance import provenance_record, recorded_path, start_clock, write_json
from slipstitch.film.slip_angles import Reference, SlipAngles, estimate, read_angles

# Black is the estimate.
_COLOURS = tuple(colour for colour in SERIES if colour != BLACK)

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
    """Estimate every pair of a table of slip angles; write a CSV, and JSON and picture if asked."""
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
        with recorded_path(picture, record) as temporary:
            draw_references(found, temporary, picture.suffix[1:])
    return references


def draw_references(
    measured: Sequence[tuple[SlipAngles, Reference]], path: str | os.PathLike, kind: str
) -> None:
    """Draw every slip angle, and the interval of each pair, as PNG or SVG."""
    names = sorted({name for angles, _ in measured for name in angles.orientation})
    colour = {name: _COLOURS[k % len(_COLOURS)] for k, name in enumerate(names)}
    with matplotlib.rc_context(FIXED_IDS | {"font.size": 9}):
        figure = Figure(figsize=(7.5, 1.1 + 0.75 * len(measured)), layout="constrained")
        axes = figure.subplots()
        for row, (angles, reference) in enumerate(measured):
            places = sorted(set(angles.position))
            offset = {name: 0.16 + 0.5 * k / max(len(places), 2) for k, name in enumerate(places)}
            axes.axvspan(*_interval(reference), *_band(row, len(measured)), color=INTERVAL)
            axes.plot([reference.mu], [row], "D", color="black", markersize=4, zorder=3)
            for position, orientation, friction in zip(
                angles.position, angles.orientation, np.tan(angles.angle_rad), strict=True
            ):
                height = row + offset[position]
                axes.plot([friction], [height], "o", ms=3.5, alpha=0.75, color=colour[orientation])
            axes.errorbar(
                [reference.mu], [row], xerr=[reference.error], color="black", capsize=3, lw=1.2
            )
        axes.set_yticks(
            range(len(measured)),
            [plain_text(f"{angles.material}\non {angles.substrate}") for angles, _ in measured],
        )
        axes.set_ylim(len(measured) - 0.2, -0.4)
        axes.set_xlabel("friction coefficient (tan of the slip angle)")
        axes.spines[["top", "right"]].set_visible(False)
        handles = [axes.plot([], [], "o", ms=4, color=colour[name])[0] for name in names]
        labels = [plain_text(f"orientation {name}") for name in names]
        axes.legend(handles, labels, frameon=False, fontsize=8, loc="best")
        axes.set_title(
            "Black: estimate with 95 % interval, including the bench's error; dots: slip angles, "
            "one line per position",
            fontsize=9,
            loc="left",
        )
        save_figure(figure, path, kind)


def _interval(reference: Reference) -> tuple[float, float]:
    return reference.mu - reference.error, reference.mu + reference.error


def _band(row: int, count: int) -> tuple[float, float]:
    """A row's share of the height of the axes, from below."""
    top, bottom = -0.4, count - 0.2
    low, high = row + 0.75, row - 0.15
    return (bottom - low) / (bottom - top), (bottom - high) / (bottom - top)
