"""The moment at which the cloth touches down and buckles to one side."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from slipstitch.base.errors import NotConverged
from slipstitch.config.simulation import SimulationSettings
from slipstitch.physics.cloth import ClothSolver

LANDING_S = 0.1  # after the first touch, in which the cloth buckles


class Landing:
    """Check of the steps while the cloth lands: does it buckle to the side of finer steps?

    Cloth that touches down buckles, to one side or the other, and a step may have a solution on
    either: a step that is nearly too long takes the wrong one without its error telling. So every
    step of the landing is repeated in two halves by a second solver, and must go the same way. No
    long step is taken then.

    Parameters
    ----------
    solver : ClothSolver
        Whose steps are checked.
    new_solver : callable
        Makes another solver of the same cloth.
    clamps : callable
        Positions (V, 3) at a time, of which those of the held vertices count, in m.
    settings : SimulationSettings
    """

    def __init__(
        self,
        solver: ClothSolver,
        new_solver: Callable[[], ClothSolver],
        clamps: Callable[[float], np.ndarray],
        settings: SimulationSettings,
    ):
        self._solver, self._clamps, self._settings = solver, clamps, settings
        self._new_solver = new_solver
        self._finer: ClothSolver | None = None
        self._touched_s = np.inf

    def confirms(self, end_m: np.ndarray, step_s: float) -> bool:
        """Whether a step of the solver to ``end_m`` (V, 3) may be taken."""
        now_s = self._solver.time_s
        if end_m[:, 2].min() < 0:
            is_long = step_s > 1.01 * self._settings.step_used_s
            if now_s <= self._touched_s + LANDING_S and is_long:
                return False
            self._touched_s = min(self._touched_s, now_s)
        if now_s > self._touched_s + LANDING_S:
            self._solver.confirm = self._finer = None
        if not self._touched_s <= now_s <= self._touched_s + LANDING_S:
            return True
        finer_m = self._end_of_two_halves(step_s)
        return finer_m is None or self._same_way(end_m, finer_m)

    def _end_of_two_halves(self, step_s: float) -> np.ndarray | None:
        """Positions (V, 3) after two steps half as long; None where they cannot be solved."""
        if self._finer is None:
            self._finer = self._new_solver()
        self._finer.go_on_from(self._solver)
        try:
            for _ in range(2):
                self._finer.advance(step_s / 2, self._clamps, halvings=2)
        except NotConverged:
            return None
        return self._finer.positions_m

    def _same_way(self, end_m: np.ndarray, finer_m: np.ndarray) -> bool:
        """Whether the ways of all vertices along x, as two vectors, do not point apart.

        Over the landing those of the paper's settings and of steps a quarter as long have cosines
        from 0.68 up in all fabrics at three coefficients. So less than 0, opposite ways, is another
        side, unless both ways agree within the error that a step may have.
        """
        start_m = self._solver.positions_m[:, 0]
        way_m, finer_way_m = end_m[:, 0] - start_m, finer_m[:, 0] - start_m
        apart_m = float(np.sqrt(np.mean((way_m - finer_way_m) ** 2)))
        return np.vdot(way_m, finer_way_m) >= 0 or apart_m <= self._settings.step_error_m
