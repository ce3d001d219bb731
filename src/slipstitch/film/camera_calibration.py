"""From views of a board to a lens, and from one of it on the floor to the camera's place.

The model of the lens is OpenCV's (calib3d, "Camera Calibration and 3D Reconstruction"): pinhole
with two focal lengths and a principal point, distortion k1, k2, p1, p2, k3 (Brown 1971).
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from matplotlib.figure import Figure

from slipstitch.base.errors import BadInput
from slipstitch.base.page.figures import plain_text, save_figure
from slipstitch.base.provenance import provenance_record, recorded_path, start_clock, write_sidecar
from slipstitch.design.stage_path import StagePath
from slipstitch.film.board import Board, BoardView, check_size, read_image, read_views
from slipstitch.images.camera import Lens
from slipstitch.images.camera_file import (
    HEIGHT,
    check_position,
    lens_record,
    read_foreign_lens,
    write_camera_file,
)

FEWEST_VIEWS = 5
# With less tilt, or an uncertainty (relative) above this, the views are too much alike.
_LEAST_TILT_DEG = 10.0
_FOCAL_UNCERTAINTY = 0.01
# A view this many times worse than the median one is a mistaken sighting.
_OUTLIER = 4.0
_OUTLIER_PX = 0.5
# A ruler puts the board on the floor as exactly, and its face is as high as stated, as that.
_PLACE_SD_M, _THICKNESS_SD_M = 0.0005, 0.0002
_FOLDS = 3
_AS_GOOD = 1.001

# From the stiffest lens model to the most flexible one.
_MODELS = {
    "k1 k2": cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K3,
    "k1 k2 p1 p2": cv2.CALIB_FIX_K3,
    "k1 k2 p1 p2 k3": 0,
}


@dataclass(frozen=True)
class Calibration(Lens):
    """A camera's lens and how well it explains the views."""

    uncertainty: np.ndarray  # (9,): standard deviations of fx, fy, cx, cy and of the distortion
    model: str  # which distortion coefficients are not zero
    views: list[BoardView]  # those that were used
    residuals_px: list[np.ndarray]  # (N, 2): found minus reprojected corners, view by view
    tilt_deg: float  # largest angle between the board's normals in two views
    left_out: dict[str, float]  # name -> rms (px) of views that fitted no camera

    @property
    def rms_px(self) -> float:
        """Root of the mean squared distance between found and reprojected corners."""
        return _rms(np.concatenate(self.residuals_px))

    def summary(self) -> str:
        """The result in one line."""
        focal_x, focal_y = self.matrix[0, 0], self.matrix[1, 1]
        return (
            f"{len(self.views)} views, reprojection error {self.rms_px:.3f} px, focal length "
            f"{focal_x:.1f} x {focal_y:.1f} px (to {self.uncertainty[:2].max():.2g} px), "
            f"distortion {self.model}"
        )


def _rms(residuals_px: np.ndarray) -> float:
    return float(np.sqrt((residuals_px**2).sum(axis=1).mean()))


def calibrate(views: list[BoardView]) -> Calibration:
    """The camera that saw these views.

    Of three lens models the simplest is taken that predicts views it was not fitted to within
    0.1 % of the best one, so that a coefficient that the views do not ask for stays zero. Views
    that fit four times worse than the median one are left out. BadInput with fewer than five
    views, or views so much alike that the focal length stays open.
    """
    _need(views, {})
    best = _fit(views, _simplest(views))
    errors = np.array([_rms(residuals) for residuals in best.residuals_px])
    bad = errors > max(_OUTLIER * np.median(errors), _OUTLIER_PX)
    left_out = {views[k].name: float(errors[k]) for k in np.flatnonzero(bad)}
    if left_out:
        kept = [view for view in views if view.name not in left_out]
        _need(kept, left_out)
        best = replace(_fit(kept, _simplest(kept)), left_out=left_out)
    relative = best.uncertainty[:2] / np.diag(best.matrix)[:2]
    if best.tilt_deg < _LEAST_TILT_DEG or not (relative < _FOCAL_UNCERTAINTY).all():
        raise BadInput(
            f"the {len(best.views)} views are too similar to determine the focal length: the "
            f"board rotates by only {best.tilt_deg:.0f} degrees between them; tilt it more, in "
            "both directions"
        )
    return best


def _need(views: list[BoardView], left_out: dict[str, float]) -> None:
    if len(views) < FEWEST_VIEWS:
        mistaken = f" (excluded as outliers: {', '.join(left_out)})" if left_out else ""
        raise BadInput(
            f"the board was found in only {len(views)} usable view(s); at least {FEWEST_VIEWS} "
            f"are required, from different directions{mistaken}"
        )


def _simplest(views: list[BoardView]) -> str:
    """The simplest lens model that predicts unseen views about as well as any."""
    errors = {}
    for name in _MODELS:
        squares, count = 0.0, 0
        for fold in range(_FOLDS):
            camera = _fit([view for k, view in enumerate(views) if k % _FOLDS != fold], name)
            for view in views[fold::_FOLDS]:
                points, corners = view.sighting.points_m, view.sighting.corners_px
                lens = (camera.matrix, camera.distortion)
                _, rvec, tvec = cv2.solvePnP(points, corners, *lens)
                seen = cv2.projectPoints(points, rvec, tvec, *lens)[0].reshape(-1, 2)
                squares, count = squares + ((corners - seen) ** 2).sum(), count + len(points)
        errors[name] = np.sqrt(squares / count)
    return next(name for name in _MODELS if errors[name] <= _AS_GOOD * min(errors.values()))


def _fit(views: list[BoardView], model: str) -> Calibration:
    """The camera with one lens model."""
    size = views[0].size_px
    points = [view.sighting.points_m for view in views]
    corners = [view.sighting.corners_px for view in views]
    _, matrix, distortion, rvecs, tvecs, spread, _, _ = cv2.calibrateCameraExtended(
        points, corners, size, None, None, flags=_MODELS[model]
    )
    residuals = [
        seen - cv2.projectPoints(on_board, rvec, tvec, matrix, distortion)[0].reshape(-1, 2)
        for on_board, seen, rvec, tvec in zip(points, corners, rvecs, tvecs, strict=True)
    ]
    normals = np.array([cv2.Rodrigues(rvec)[0][:, 2] for rvec in rvecs])
    tilt = np.degrees(np.arccos(np.clip(normals @ normals.T, -1, 1).min()))
    coefficients, uncertainty = distortion.ravel()[:5], spread.ravel()[:9]
    return Calibration(
        size, matrix, coefficients, uncertainty, model, views, residuals, float(tilt), {}
    )


def calibration_record(result: Calibration) -> dict:
    """What a camera file says of a calibration beside the lens."""
    per_view = {
        view.name: _rms(residuals)
        for view, residuals in zip(result.views, result.residuals_px, strict=True)
    }
    spread = result.uncertainty
    return {
        "uncertainty": {
            "focal_px": spread[:2].tolist(),
            "principal_point_px": spread[2:4].tolist(),
            "distortion": spread[4:].tolist(),
        },
        "reprojection_error_px": {"rms": result.rms_px, "views": per_view},
        "views_left_out": result.left_out,
    }


@dataclass(frozen=True)
class FloorPlace:
    """Position of the board on the floor: its first corner, its width's direction, its height."""

    x_mm: float
    y_mm: float
    angle_deg: float
    thickness_mm: float
    is_measured: bool = True  # none of these is merely assumed

    def on_stage(self, points_m: np.ndarray) -> np.ndarray:
        """Points of the board (N, 3) in the stage's coordinates; the board's face looks up."""
        angle = np.radians(self.angle_deg)
        across = np.array([np.cos(angle), np.sin(angle), 0.0])
        # Seen from above, y of the board is a quarter turn clockwise from its x.
        down = np.array([np.sin(angle), -np.cos(angle), 0.0])
        origin = np.array([self.x_mm, self.y_mm, self.thickness_mm]) / 1e3
        return origin + points_m[:, :1] * across + points_m[:, 1:2] * down


@dataclass(frozen=True)
class StagePose:
    """The camera's place at the stage."""

    rotation: np.ndarray  # (3, 3): stage to camera
    translation_m: np.ndarray  # (3,)
    # standard deviation of the camera's place, from the scatter of the residuals
    position_uncertainty_m: float
    # of heights above the floor that the camera tells where the clamps are, from the scatter and
    # from the place of the board
    height_uncertainty_m: float
    rms_px: float

    @property
    def position_m(self) -> np.ndarray:
        """The camera's place (3,) in the stage's coordinates."""
        return -self.rotation.T @ self.translation_m

    def summary(self) -> str:
        """The place in a few words."""
        x, y, z = self.position_m * 1e3
        error_mm = 1e3 * self.position_uncertainty_m
        return f"; position ({x:.0f}, {y:.0f}, {z:.0f}) mm, to {error_mm:.1g} mm"


def stage_pose(
    lens: Lens, grey: np.ndarray, board: Board, place: FloorPlace, name: str
) -> StagePose:
    """Return the position of a camera, from one image of the board on the floor; else BadInput."""
    if grey.shape[::-1] != tuple(lens.size_px):
        raise BadInput(
            f"{name}: {grey.shape[1]}x{grey.shape[0]} pixels; the lens was calibrated with "
            f"{lens.size_px[0]}x{lens.size_px[1]}"
        )
    seen = board.find(grey)
    if seen is None:
        raise BadInput(f"{name}: no board found in it")
    check_size(board, grey, name)
    points = place.on_stage(seen.points_m.astype(np.float64))
    model = (lens.matrix, lens.distortion)
    corners = seen.corners_px.astype(np.float64)
    _, rvec, tvec = cv2.solvePnP(points, corners, *model, flags=cv2.SOLVEPNP_ITERATIVE)
    projected, jacobian = cv2.projectPoints(points, rvec, tvec, *model)
    residuals = corners - projected.reshape(-1, 2)
    variance = (residuals**2).sum() / (residuals.size - 6)
    covariance = variance * np.linalg.inv(jacobian[:, :6].T @ jacobian[:, :6])
    moved = _place_derivative(rvec, tvec)
    spread = moved @ covariance @ moved.T
    pose = StagePose(
        cv2.Rodrigues(rvec)[0],
        tvec.ravel(),
        float(np.sqrt(np.trace(spread))),
        _height_sd_m(rvec, tvec, model, covariance),
        _rms(residuals),
    )
    squares = f": are the squares {1e3 * board.square_m:g} mm (--square-mm)?"
    check_position(name, pose.position_m, squares)
    return pose


def _place_derivative(rvec: np.ndarray, tvec: np.ndarray) -> np.ndarray:
    """Derivatives (3, 6) of the camera's place with respect to rotation vector and translation."""
    rotation, turn = cv2.Rodrigues(rvec)
    # OpenCV gives the derivative of the nine entries of R, row by row.
    by_turn = -np.einsum("kij,il->jk", turn.reshape(3, 3, 3), tvec)
    return np.hstack([by_turn, -rotation.T])


def _height_sd_m(rvec, tvec, model, covariance: np.ndarray) -> float:
    """How well a camera, its place of this covariance (6, 6), tells the height of an edge there."""
    step_m = 0.001
    edge = np.array([0.0, 0.0, StagePath().lowered_height_m]) + step_m * np.eye(4, 3, -1)
    seen, jacobian = cv2.projectPoints(edge, rvec, tvec, *model)
    ahead, aside, up = seen[1:, 0] - seen[0, 0]
    normal = np.array([-aside[1], aside[0]])  # of the edge in the image
    moved_m = step_m * (normal @ jacobian[:2, :6]) / (normal @ up)
    placed_m = _PLACE_SD_M * (normal @ ahead) / (normal @ up)
    return float(np.sqrt(moved_m @ covariance @ moved_m + placed_m**2 + _THICKNESS_SD_M**2))


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
    known["uncertainty"][HEIGHT] = (
        stage.height_uncertainty_m if stage and place.is_measured else None
    )
    known.setdefault("reprojection_error_px", {})["stage_view"] = stage and stage.rms_px
    on_floor = {"board": board and asdict(board), "place": stage and asdict(place)}
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
    bars.bar(range(len(result.views)), [*map(_rms, result.residuals_px)], color="tab:blue")
    bars.axhline(result.rms_px, color="black", linewidth=0.8)
    bars.set(ylabel="rms (px)", title="error per view")
    names = [plain_text(Path(view.name).name) for view in result.views]
    bars.set_xticks(range(len(names)), names, rotation=60, ha="right", fontsize=7)
    save_figure(figure, path, kind, dots_per_inch=110)
