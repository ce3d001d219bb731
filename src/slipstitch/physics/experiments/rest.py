"""Bringing cloth to rest, by implicit steps long enough to damp all motion."""

from collections.abc import Callable

import numpy as np

from slipstitch.base.errors import NotConverged
from slipstitch.physics.cloth import ClothSolver

REST_M = 1.0e-7  # largest movement in a step that counts as rest
STEPS_MAX = 400


def bring_to_rest(
    solver: ClothSolver, step_s: float, prescribed: Callable[[float], np.ndarray] | None = None
) -> None:
    """Step until nothing moves.

    Parameters
    ----------
    solver : ClothSolver
    step_s : float
        About the period of the slowest motion, or longer.
    prescribed : callable, optional
        Positions of the fixed coordinates at a time, as for `ClothSolver.advance`.

    Raises
    ------
    NotConverged
        It still moves after 400 steps, or a step did not converge.
    """
    for step in range(STEPS_MAX):
        before_m = solver.positions_m.copy()
        solver.advance(step_s, prescribed)
        if step and abs(solver.positions_m - before_m).max() < REST_M:
            return
    moved_m = abs(solver.positions_m - before_m).max()
    raise NotConverged(
        f"not at rest after {STEPS_MAX} steps of {step_s:g} s: moves by {moved_m:.1e} m"
    )
