"""Camera calibration as files: the camera file and the plot of its residuals."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from slipstitch.base.page.figures import plain_text, save_figure
from slipstitch.base.provenance import provenance_record, recorded_path, start_clock, write_sidecar
from slipstitch.film.board import Board
from slipstitch.film.board_views import read_image, read_views
from slipstitch.film.camera_calibration import (
    Calibration,
    FloorPlace,
    calibrate,
    calibration_record,
    stage_pose,
)
from slipstitch.images.camera import Lens
from slipstitch.images.camera_file import lens_record, read_foreign_lens, write_camera_file

_ARROW_SHARE = 0.04  # of the image's width, for a residual at the 95th percentile


def camera_to_file(
    source: Path | Sequence[Path],
    board: Board | None,
    stage_view: Path | None,
    place: FloorPlace,
    out: Path,
    picture: Path | None,
) -> str:
    """Write the camera file of a lens at its place, and say in a line what was found.

    Parameters
    ----------
    source : path, or sequence of path
        Another program's calibration; or images of the board, or one video of it.
    stage_view : path, optional
        The board on the floor, at `place`, seen by the camera on its bench; without it,
        the file does not say where the camera stands.
    picture : path, optional
        Of the residuals of a calibration, PNG or SVG.

    BadInput if the source or the stage view cannot be used.
    """
    started = start_clock()
    lens: Lens
    known: dict = {}
    if isinstance(source, Path):
        lens, inputs = read_foreign_lens(source), [source]
        columns, rows = lens.size_px
        line = (
            f"lens of {source}: {columns}x{rows} pixels, focal length {lens.matrix[0, 0]:.1f} x "
            f"{lens.matrix[1, 1]:.1f} px"
        )
    else:
        assert board is not None
        lens = found = calibrate(read_views(source, board))
        inputs, known, line = list(source), calibration_record(found), found.summary()
    stage = None
    if stage_view is not None and board is not None:
        stage = stage_pose(lens, read_image(stage_view), board, place, str(stage_view))
        inputs.append(stage_view)
        line += stage.summary()
    known.setdefault("uncertainty", {})["position_m"] = stage and stage.position_uncertainty_m
    known.setdefault("reprojection_error_px", {})["stage_view"] = stage and stage.rms_px
    on_floor = {"board": board and asdict(board), "place": stage and asdict(stage.place)}
    content = {
        **lens_record(lens),
        "rotation": stage and stage.rotation.tolist(),
        "translation_m": stage and stage.translation_m.tolist(),
        "board": on_floor["board"],
        "board_on_floor": on_floor["place"],
        **known,
    }
    record = provenance_record("capture", inputs=inputs, config=on_floor, started=started)
    write_camera_file(out, content)
    write_sidecar(out, record)
    if picture and isinstance(lens, Calibration):
        with recorded_path(picture, record) as temporary:
            draw_residuals(lens, temporary, picture.suffix[1:])
    return line


def draw_residuals(result: Calibration, path: Path, kind: str) -> None:
    """Draw the residuals of all views (direction, scatter, error per view) as PNG or SVG."""
    figure = Figure(figsize=(11, 7), layout="constrained")
    upper, lower = figure.subfigures(2, 1, squeeze=False, height_ratios=(1.6, 1))[:, 0]
    places, scatter = upper.subplots(1, 2, width_ratios=(1.6, 1))
    bars = lower.subplots()
    corners = np.concatenate([view.sighting.corners_px for view in result.views])
    residuals = np.concatenate(result.residuals_px)
    length = np.linalg.norm(residuals, axis=1)
    width, height = result.size_px
    scale = _ARROW_SHARE * width / max(np.percentile(length, 95), 1e-6)
    places.quiver(
        *corners.T, *residuals.T * scale, length, angles="xy", scale_units="xy", scale=1,
        width=0.002, cmap="viridis",
    )  # fmt: skip
    places.set(
        xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), aspect="equal",
        xlabel="x (px)", ylabel="y (px)", title=f"detected minus reprojected, {scale:.0f} times",
    )  # fmt: skip
    scatter.scatter(*residuals.T, s=4, alpha=0.4, linewidths=0)
    limit = 1.1 * np.abs(residuals).max()
    scatter.set(
        xlim=(-limit, limit), ylim=(limit, -limit), aspect="equal",
        xlabel="x (px)", ylabel="y (px)", title=f"rms {result.rms_px:.3f} px",
    )  # fmt: skip
    scatter.grid(alpha=0.3)
    worst = [np.sqrt((part**2).sum(axis=1).mean()) for part in result.residuals_px]
    bars.bar(range(len(worst)), worst, color="tab:blue")
    bars.axhline(result.rms_px, color="black", linewidth=0.8)
    bars.set(ylabel="rms (px)", title="error per view")
    names = [plain_text(Path(view.name).name) for view in result.views]
    bars.set_xticks(range(len(names)), names, rotation=60, ha="right", fontsize=7)
    save_figure(figure, path, kind, dots_per_inch=110)
