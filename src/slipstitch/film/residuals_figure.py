"""A plot of the residuals of a calibration: direction, scatter, error per view."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from slipstitch.base.page.figures import plain_text, save_figure
from slipstitch.film.lens_calibration import Calibration

_ARROW_SHARE = 0.04  # of the image's width, for a residual at the 95th percentile


def draw_residuals(result: Calibration, path: Path, kind: str) -> None:
    """Draw the residuals of all views.

    Parameters
    ----------
    result : Calibration
    path : Path
    kind : str
        "png" or "svg".
    """
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
