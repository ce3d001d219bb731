"""A measurement as files: the page, and all numbers."""

import json
from pathlib import Path

from slipstitch.measure.measurement_page import page
from slipstitch.measure.measuring import MeasuredVideo, measure_video
from slipstitch.provenance import atomic_path, provenance_record, start_clock, write_sidecar


def measure_to_files(
    video: Path,
    camera: Path,
    model: Path,
    config: Path | None,
    *,
    page_path: Path | None,
    numbers_path: Path | None,
    **options,
) -> MeasuredVideo:
    """Measure a video and write what is asked for, with its provenance beside it.

    Parameters
    ----------
    video, camera, model, config, **options
        As for `slipstitch.measure.measuring.measure_video`, with its errors.
    page_path, numbers_path : path, optional
        HTML and JSON.
    """
    started = start_clock()
    result = measure_video(video, camera, model, config, **options)
    if not (page_path or numbers_path):
        return result
    inputs = [video, camera, result.config_path]
    record = provenance_record("measure", inputs=inputs, started=started)
    record["instrument"] = result.instrument
    if page_path:
        with atomic_path(page_path) as temporary:
            temporary.write_text(page(result), encoding="utf-8")
        write_sidecar(page_path, record)
    if numbers_path:
        with atomic_path(numbers_path) as temporary:
            text = json.dumps(result.numbers(), indent=1, allow_nan=False)
            temporary.write_text(text + "\n", encoding="utf-8")
        write_sidecar(numbers_path, record)
    return result
