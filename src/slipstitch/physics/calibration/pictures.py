"""The pictures of a calibration; apart from it, so that another plot leaves the settings alone."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from slipstitch.base.page.figures import save_figure
from slipstitch.base.provenance import provenance_record, read_json, recorded_path, start_clock
from slipstitch.config.load import calibrated_settings
from slipstitch.physics.calibration.calibration_figure import calibration_figure
from slipstitch.physics.calibration.strip_figure import settings_figure, strip_figure


def draw_pictures(
    pictures: Mapping[str, str | os.PathLike],
    calibration: Mapping[str, Any],
    record: Mapping[str, Any],
    failed: bool,
) -> None:
    """Draw what a calibration holds; of one that chose no settings, those that were tried.

    Parameters
    ----------
    pictures : mapping
        PNG or SVG files by name: ``checks``, ``strip``, ``settings``.
    calibration : mapping
        What `calibration.calibrate_to_file` returns, or its ``strip`` alone.
    record : mapping
        Its provenance.
    failed : bool
        Whether a requirement is not met: then ``.failed`` stands before the suffix.
    """
    figures = {"settings": settings_figure}
    if "chosen" in calibration["strip"]:
        figures |= {"checks": calibration_figure, "strip": strip_figure}
    for name, figure in figures.items():
        if name not in pictures:
            continue
        path = Path(pictures[name])
        if failed:
            path = path.with_suffix(f".failed{path.suffix}")
        with recorded_path(path, record) as temporary:
            save_figure(figure(calibration), temporary, path.suffix.lstrip(".") or "png")


def draw_again(path: str | os.PathLike, pictures: Mapping[str, str | os.PathLike]) -> None:
    """Draw the pictures of a calibration from its file.

    Raises
    ------
    BadInput
        If it cannot be read.
    """
    started = start_clock()
    calibrated_settings(path)  # says what is wrong with it
    record = provenance_record("calibrate.pictures", inputs=[path], started=started)
    draw_pictures(pictures, read_json(path), record, failed=False)
