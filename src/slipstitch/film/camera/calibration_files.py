"""Camera calibration as files: the camera file and the plot of its residuals."""

from collections.abc import Sequence
from pathlib import Path

from slipstitch.base.provenance import provenance_record, recorded_path, start_clock, write_sidecar
from slipstitch.film.camera.board import Board
from slipstitch.film.camera.lens_calibration import FloorPlace, calibrate, camera_file
from slipstitch.film.camera.views import read_image, read_views
from slipstitch.images.camera_file import write_camera_file


def calibrate_to_file(
    board: Board,
    views: Sequence[Path],
    stage_view: Path | None,
    place: FloorPlace,
    out: Path,
    picture: Path | None,
) -> str:
    """Calibrate a camera, write what is asked for, and say in a line how good it is.

    Parameters
    ----------
    board : Board
    views : sequence of path
        Images of the board, or one video.
    stage_view : path, optional
        The board on the floor, seen by the camera in its place on the bench.
    place : FloorPlace
        Where the board lies then.
    out : path
        Camera file.
    picture : path, optional
        PNG or SVG.

    Raises
    ------
    BadInput
        If the views cannot be used.
    """
    started = start_clock()
    result = calibrate(read_views(views, board))
    stage = None
    if stage_view:
        stage = result.stand(read_image(stage_view), board, place, str(stage_view))
    record = provenance_record(
        "capture",
        inputs=[*views, *([stage_view] if stage_view else [])],
        config={"board": board.record(), "place": stage and stage.place.record()},
        started=started,
    )
    write_camera_file(out, camera_file(result, board, stage))
    write_sidecar(out, record)
    if picture:
        from slipstitch.film.camera.residuals_figure import draw_residuals

        with recorded_path(picture, record) as temporary:
            draw_residuals(result, temporary, picture.suffix[1:])
    return f"{result.summary()}{stage.summary() if stage else ''}"
