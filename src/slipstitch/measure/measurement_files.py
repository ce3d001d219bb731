"""A measurement as files: the page, and all numbers."""

from pathlib import Path

from slipstitch.measure.measurement_page import page
from slipstitch.measure.measuring import MeasuredVideo, measure_video
from slipstitch.provenance import provenance_record, start_clock, write_json, write_text


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
        write_text(page_path, page(result), record)
    if numbers_path:
        write_json(numbers_path, result.numbers(), record)
    return result
