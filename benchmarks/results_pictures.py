"""The pictures of docs/results.md: errors against friction, with their limits; confusions."""

import numpy

from slipstitch.base.page.figures import new_figure, styled, svg
from slipstitch.base.page.palette import INK, ORANGE, SKY, THEORY
from slipstitch.design.stage_path import SIDE_M, StagePath
from slipstitch.film.measure.clamp_height import ASSUMED_M, READING_PER_M
from slipstitch.physics.experiments.strip_drag import flexible_strip_drag
from slipstitch.report.learning_pictures import confusions

SEEN_M = 1e-3  # how well the tail's place is known, for the line of the limit


def tail_moves_m(friction):
    """Return by how much the tail lags more at a coefficient that is 0.1 larger."""
    height_m = StagePath().lowered_height_m
    here_m, there_m = (
        flexible_strip_drag(mu, SIDE_M, height_m).holder_ahead_of_tail_m
        for mu in (friction, friction + 0.1)
    )
    return there_m - here_m


@styled
def errors(known, others):
    """Return errors of the instrument by coefficient, and what the physics makes of a millimetre.

    `known`: coefficient -> mean error; `others`: readings, with coefficient and simulation.
    """
    figure = new_figure(7.0, 3.2)
    axes = figure.subplots()
    apart = others.assign(error=(others["reading"] - others["friction"]).abs())
    of_simulation = apart.groupby("simulation")[["friction", "error"]].mean()
    axes.plot(of_simulation["friction"], of_simulation["error"], "o", color=ORANGE, ms=4,
              label="other fabrics and clamps, a simulation each")  # fmt: skip
    axes.plot(
        *zip(*sorted(known.items()), strict=True),
        "s-",
        color=INK,
        ms=4,
        lw=1,
        label="known fabrics",
    )
    grid = numpy.linspace(0.05, 1.5, 30)
    # Rounded: the picture has the same bytes on every processor.
    limit = [round(0.1 * SEEN_M / tail_moves_m(friction), 4) for friction in grid]
    axes.plot(grid, limit, color=THEORY, lw=1.2, label="the tail's place known to 1 mm")
    axes.plot(grid, abs(READING_PER_M) * ASSUMED_M * grid, "--", color=SKY,
              label="clamps 1 mm too high")  # fmt: skip
    axes.set(xlim=(0, 1.55), ylim=(0, 0.3), xlabel="friction coefficient", ylabel="mean error")
    axes.legend(frameon=False, fontsize=8, loc="upper left")
    return figure


def pictures(known, others, details):
    """Return the text of every picture by its file name."""
    return {
        "error_by_friction.svg": svg(errors(known, others)),
        "confusions.svg": svg(confusions(details)),
    }
