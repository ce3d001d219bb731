"""Implicit time stepping of the cloth, every accepted step converged.

Implicit Euler, the full nonlinear step solved by Newton's method with a positive definite
approximation of the tangent, factored by sparse Cholesky (CHOLMOD) and kept over iterations
and steps while the corrections shrink fast enough; Deuflhard's natural monotonicity test
(Newton Methods for Nonlinear Problems, 2004) controls damping of the step. A step is accepted
when the largest out-of-balance force on any node is a small fraction of the friction force
that a node of the cloth can bear; a step that does not get there is halved and repeated.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields
from enum import Enum, auto
from math import isfinite, sqrt
from operator import add
from typing import Literal

import numpy as np
import warp as wp

from slipstitch.base.errors import NotConverged
from slipstitch.physics import GRAVITY_M_S2
from slipstitch.physics.cloth import bending, contact
from slipstitch.physics.cloth.contact import Conditions, FloorFriction
from slipstitch.physics.cloth.mesh import ClothMesh
from slipstitch.physics.cloth.self_contact import SelfContact
from slipstitch.physics.cloth.sheet import Sheet, check_device
from slipstitch.physics.cloth.tangent import flexible_gmres
from slipstitch.physics.fabric import ElasticTables
from slipstitch.physics.friction_law import FrictionLaw

FULL_TOUCH = 0.05  # of the nodal force: load from which a node touches with its whole area
# Tuning of the nonlinear solver; results do not depend on it, cost does.
SEARCH_ACCURACY = 0.5  # of the line search: work left over work at the start
REFACTOR_RATE = 0.6  # a residual that shrinks less than this wants a new factor
EXACT_BELOW = 1.0  # relative residual from which the exact tangent is used
PRODUCTS_MAX = 8  # more products with the exact tangent than this want a new factor
KRYLOV_ACCURACY = 0.1  # of a correction: residual left over residual
DIFFERENCE_M = 1e-9  # displacement by which tangents are differenced
EXTRAPOLATION_MAX = 64.0  # of a correction, in the line search
HALVINGS_MAX = 12  # of a step that does not converge: more are an error
REFINEMENTS_MAX = 3  # halvings of a step for accuracy's sake
TRUSTED_AFTER = 3  # iterations from which a step is given up that is clearly too long
CLEARLY = 1.5  # times the error that is allowed
FORESEEN_ERROR = 0.5  # of the error allowed: what a step longer than the last one aims at
LEAST_ERROR_M = 1e-12  # of a step: less is rounding
COVERS_MAX = 4  # solutions of a step, each with more near parts of the cloth known


@dataclass(frozen=True)
class SolverSettings:
    """Numerical settings of the time stepping."""

    # Largest out-of-balance force on a node, over friction coefficient times nodal weight; and the
    # coefficient that it is taken at when the real one is smaller.
    friction_tolerance: float = 1.0e-4
    friction_floor: float = 0.05
    newton_iterations_max: int = 30  # a step that needs more is halved
    # A step whose time discretisation moves the vertices by more than this (root of the mean
    # square) is halved, up to three times.
    step_error_m: float = np.inf
    # The end of the step whose curvature the stiffness of a hinge follows; rising: the end while
    # the moment grows with curvature; where it would fall within the step it is held.
    bending_stiffness_at: Literal["start", "end", "rising"] = "end"
    damping_s: float = 0.002  # stiffness-proportional
    # Depth to which the cloth's weight presses the floor where it lies evenly; also its elastic
    # microslip there at friction coefficient 1. Likewise for one pair of touching parts of cloth.
    penetration_m: float = 5.0e-7
    layer_penetration_m: float = 5.0e-6
    self_contact: bool = False  # whether layers touch one another, rather than pass through
    thickness_m: float = 1.0e-3  # distance between the middle surfaces of touching layers
    layer_friction: float | None = None  # between layers; None: that of the floor
    device: str = "cpu"  # of Warp, on which forces and stiffness are evaluated

    @classmethod
    def of(cls, settings: object) -> "SolverSettings":
        """Take what another settings object has under the same names."""
        names = [one.name for one in fields(cls) if hasattr(settings, one.name)]
        return cls(**{name: getattr(settings, name) for name in names})


class Outcome(Enum):
    """Of the attempt at a step."""

    ACCEPTED = auto()
    INACCURATE = auto()
    UNSOLVED = auto()


class _TooLong(Exception):  # noqa: N818 - not an error: the step is halved
    """The step under way will not be accurate."""


@dataclass
class StepRecord:
    """Cost and convergence of the steps, summed since the last reset."""

    steps: int = 0
    newton_iterations: int = 0
    factorisations: int = 0
    halvings: int = 0
    refinements: int = 0
    largest_residual: float = 0.0  # relative, as in SolverSettings.friction_tolerance
    solves: int = 0
    touching_pairs: int = 0  # most at the end of a step

    def add(self, other: "StepRecord") -> None:
        """Add another record to this one."""
        for one in fields(self):
            together = max if one.name in ("largest_residual", "touching_pairs") else add
            setattr(self, one.name, together(getattr(self, one.name), getattr(other, one.name)))


class ClothSolver:
    """A sheet of cloth over the floor z = 0, or over a cylinder whose crest touches it.

    Parameters
    ----------
    positions_m : ndarray, shape (V, 3)
        Initial positions; initial velocities are zero.
    friction : float, ndarray of shape (V,), or FrictionLaw
        Friction coefficient between cloth and floor, or an extended law.
    fixed : ndarray of bool, shape (V, 3)
        Coordinates that are prescribed rather than solved for.
    """

    def __init__(
        self,
        mesh: ClothMesh,
        tables: ElasticTables,
        positions_m: np.ndarray,
        *,
        friction: float | np.ndarray | FrictionLaw,
        fixed: np.ndarray,
        settings: SolverSettings | None = None,
        conditions: Conditions | None = None,
    ):
        self.mesh = mesh
        self.settings = settings = settings or SolverSettings()
        conditions = conditions or Conditions()
        check_device(settings.device)
        self.fixed = np.array(fixed, dtype=bool)
        self.mass_kg = tables.areal_density_kg_m2 * mesh.vertex_areas_m2()
        self.positions_m = np.array(positions_m, dtype=float)
        self.velocities_m_s = np.zeros_like(self.positions_m)
        self.record = StepRecord()
        self.time_s = 0.0
        # Asked about the end (V, 3) of an accurate step and its length in s; a no halves the step.
        self.confirm: Callable[[np.ndarray, float], bool] | None = None
        self._accurate_step_s = np.inf
        self._last_step_s = 0.0
        self._last_error_m = np.inf
        self._acceleration_m_s2 = np.zeros_like(self.positions_m)

        self.ground_curvature_per_m = conditions.ground_curvature_per_m
        median_kg = float(np.median(self.mass_kg))
        self.nodal_force_N = conditions.nodal_force_N or GRAVITY_M_S2 * median_kg
        full_touch_N = FULL_TOUCH * self.nodal_force_N
        self.floor = FloorFriction(mesh, friction, conditions, full_touch_N, settings.device)
        self.friction = self.floor.coefficient
        areas_m2 = mesh.vertex_areas_m2()
        bedding_N_m3 = self.nodal_force_N / settings.penetration_m / float(np.median(areas_m2))
        self.contact_stiffness_N_m = bedding_N_m3 * areas_m2  # along the ground and into it
        self.force_scale_N = (
            max(float(self.friction.max()), settings.friction_floor) * self.nodal_force_N
        )
        nodes = self._nodes = contact.Nodes()
        nodes.mass_kg = wp.array(self.mass_kg, dtype=wp.float64, device=settings.device)
        nodes.curvature, nodes.bedding = self.ground_curvature_per_m, bedding_N_m3
        rule = bending.STIFFNESS_RULES[settings.bending_stiffness_at]
        self.sheet = Sheet(mesh, tables, self.fixed, self.floor, nodes, rule, settings.device)
        nodes.target.assign(self.positions_m)
        nodes.anchor.assign(np.ascontiguousarray(self.positions_m[:, :2]))
        self.set_gravity(conditions.gravity_m_s2)
        self._tangent = self.sheet.tangent
        self._layers: SelfContact | None = None
        if settings.self_contact:
            friction = settings.layer_friction
            self._layers = self.sheet.layers = SelfContact(
                mesh,
                thickness_m=settings.thickness_m,
                stiffness_N_m=self.nodal_force_N / settings.layer_penetration_m,
                friction=float(self.friction.max()) if friction is None else friction,
                device=settings.device,
            )
        self._evaluate = self.sheet.forces

    # -- pieces of a step -----------------------------------------------------------------

    def _factorise(self) -> None:
        """Assemble and factor the tangent at the positions last evaluated."""
        self.sheet.assemble()
        try:
            self._tangent.factorise()
        except ArithmeticError as error:
            raise NotConverged(
                f"at {self.time_s:.4f} s the tangent is not positive definite ({error})"
            ) from None
        self.record.factorisations += 1
        nodes, blocks = self._contact_blocks(symmetric=True)
        self._factored_blocks = np.zeros((self.mesh.vertex_count, 3, 3))
        self._factored_blocks[nodes] = blocks

    def _symmetric_solve(self, right: np.ndarray) -> np.ndarray:
        self.record.solves += 1
        return self._tangent.solve(right)

    def _contact_blocks(self, symmetric: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """Exact tangent of the ground's force: nodes in contact, and their 3 x 3 blocks.

        Not symmetric where a node slips, unless how friction follows the load is left out.
        """
        place, state = self.sheet.evaluated()
        nodes = np.flatnonzero(state)
        free = ~self.fixed[nodes]
        free = free[:, :, None] & free[:, None, :]
        if self.floor.extended:
            return nodes, self.sheet.contact_tangents(nodes, symmetric) * free
        x, frames = contact.ground_coordinates(place[nodes], self.ground_curvature_per_m)
        offset = x[:, :2] - self._nodes.anchor.numpy()[nodes]
        distance = np.linalg.norm(offset, axis=1)
        stiffness = self.contact_stiffness_N_m[nodes]
        growth = self.friction[nodes] * stiffness  # of the limit with depth
        limit = growth * np.maximum(-x[:, 2], 0.0)
        blocks = stiffness[:, None, None] * np.eye(3)
        slip = distance * stiffness > limit
        distance, limit, growth = (one[slip, None, None] for one in (distance, limit, growth))
        along = offset[slip, :, None] / distance
        blocks[slip, :2, :2] = limit / distance * (np.eye(2) - along * along.transpose(0, 2, 1))
        if not symmetric:
            blocks[slip, :2, 2:] = -growth * along
        if self.ground_curvature_per_m:
            blocks = frames.transpose(0, 2, 1) @ blocks @ frames
        return nodes, blocks * free

    def _correction(self, residual: np.ndarray) -> np.ndarray:
        """Newton correction at the positions last evaluated.

        The factor A holds contact as it was; with its change C, GMRES on (A + C) A^-1 y = -r needs
        only C.
        """
        nodes, blocks = self._contact_blocks()
        difference = -self._factored_blocks
        difference[nodes] += blocks
        changed = np.flatnonzero(np.abs(difference).max(axis=(1, 2)) > 1e-12)
        if not len(changed):
            return self._symmetric_solve(-residual.ravel()).reshape(-1, 3)
        difference = difference[changed]

        def product(y: np.ndarray, displacement: np.ndarray) -> np.ndarray:
            result = y.copy().reshape(-1, 3)
            moved = displacement.reshape(-1, 3)[changed]
            result[changed] += np.einsum("nij,nj->ni", difference, moved)
            return result.ravel()

        return self._krylov(product, residual, 20)

    def _krylov(self, product, residual: np.ndarray, products_max: int) -> np.ndarray:
        """Correction d of K d = -r, where product(y, d) is K d for d = A^-1 y."""
        correction = flexible_gmres(
            self._symmetric_solve, product, -residual.ravel(), KRYLOV_ACCURACY, products_max
        )
        return correction.reshape(-1, 3)

    def _exact_correction(self, x: np.ndarray, residual: np.ndarray) -> np.ndarray:
        """Newton correction, the tangent's products by differences (Knoll and Keyes 2004)."""
        self._products = 0

        def product(y: np.ndarray, displacement: np.ndarray) -> np.ndarray:
            self._products += 1
            step = DIFFERENCE_M / np.abs(displacement).max()
            moved = self._evaluate(x + step * displacement.reshape(-1, 3))
            return (moved - residual).ravel() / step

        return self._krylov(product, residual, 15)

    def _relative(self, residual: np.ndarray) -> float:
        """Largest nodal out-of-balance force over friction coefficient times nodal weight."""
        return sqrt(np.einsum("ij,ij->i", residual, residual).max()) / self.force_scale_N

    def _search(self, x, residual, correction):
        """Move along a correction to where the work of the out-of-balance forces on it is small.

        The line search of Matthies and Strang (1979): a root of residual . correction, which needs
        no energy and so allows for friction. Where the work grows (instability) the full step is
        taken.
        """
        start = float(np.vdot(residual, correction))
        low, low_work, high, high_work = 0.0, start, None, None
        # The largest multiple of the correction that may be tried.
        clear = self._layers.clear_part(x, EXTRAPOLATION_MAX * correction) if self._layers else 1.0
        most = EXTRAPOLATION_MAX * clear
        fraction = min(1.0, most)
        for _ in range(10):
            trial = x + fraction * correction
            residual = self._evaluate(trial)
            work = float(np.vdot(residual, correction))
            if start >= 0 or abs(work) <= SEARCH_ACCURACY * -start:
                break
            if work > 0:
                high, high_work = fraction, work
            else:
                low, low_work, earlier, earlier_work = fraction, work, low, low_work
            if high is not None:
                part = low_work / (low_work - high_work)
                fraction = low + (high - low) * min(max(part, 0.1), 0.9)
            elif work > earlier_work:
                slope = (work - earlier_work) / (fraction - earlier)
                fraction = min(fraction - work / slope, 4 * fraction)
            else:
                fraction *= 4
            if fraction > most:
                break
        return trial, residual

    # -- stepping -------------------------------------------------------------------------

    def _try_step(self, step_s, prescribed: Callable | None, may_refine: bool) -> Outcome:
        """Solve one implicit step; on success the state moves on."""
        end_s = self.time_s + step_s
        target = self.positions_m + step_s * self.velocities_m_s
        self._nodes.target.assign(target)
        self._nodes.inverse_step_squared.fill_(1.0 / step_s**2)
        self.sheet.damping_ratio.fill_(self.settings.damping_s / step_s)
        guess = self._guess(target, step_s)
        if prescribed is not None:
            guess[self.fixed] = prescribed(end_s)[self.fixed]
        self._give_up = None
        if may_refine:
            largest_m = CLEARLY * self.settings.step_error_m
            self._give_up = lambda x: self._step_error_m(x, target) > largest_m
        try:
            x, error = self._solve_apart(guess)
        except _TooLong:
            self._accurate_step_s = step_s / 2
            return Outcome.INACCURATE
        if not error <= self.settings.friction_tolerance:
            return Outcome.UNSOLVED
        step_error_m = self._step_error_m(x, target)
        if step_error_m > self.settings.step_error_m:
            self._accurate_step_s = step_s / 2
            if may_refine:
                return Outcome.INACCURATE
        elif step_error_m < self.settings.step_error_m / 5:
            self._accurate_step_s = 2 * step_s
        if may_refine and self.confirm and not self.confirm(x, step_s):
            self._accurate_step_s = step_s / 2
            return Outcome.INACCURATE
        self.record.largest_residual = max(self.record.largest_residual, error)
        self._last_error_m = step_error_m
        self._accept(x, step_s)
        self.time_s = end_s
        self.record.steps += 1
        return Outcome.ACCEPTED

    def _step_error_m(self, x: np.ndarray, target: np.ndarray) -> float:
        """Of implicit Euler, root mean square: half the squared step times the acceleration."""
        return 0.5 * sqrt(np.einsum("ij,ij->", x - target, x - target) / len(x))

    def _guess(self, target: np.ndarray, step_s: float) -> np.ndarray:
        """Initial guess: as if the acceleration of the last steps went on.

        But no node goes deeper into the ground: micrometres, extrapolated, are many times the load.
        """
        guess = target + 0.5 * step_s * (step_s + self._last_step_s) * self._acceleration_m_s2
        curvature = self.ground_curvature_per_m
        gap = contact.ground_coordinates(self.positions_m, curvature)[0][:, 2]
        place, frames = contact.ground_coordinates(guess, curvature)
        touching = (gap < 0) | (place[:, 2] < 0)
        lift = np.minimum(gap[touching], 0.0) - place[touching, 2]
        guess[touching] += ~self.fixed[touching] * (lift[:, None] * frames[touching, 2])
        return guess

    def _accept(self, x: np.ndarray, step_s: float) -> None:
        """Move the state on to positions that were just evaluated."""
        velocities_m_s = (x - self.positions_m) / step_s
        if self._last_step_s:
            apart_s = 0.5 * (step_s + self._last_step_s)
            self._acceleration_m_s2 = (velocities_m_s - self.velocities_m_s) / apart_s
        self._last_step_s = step_s
        self.velocities_m_s = velocities_m_s
        self.positions_m = x
        self.sheet.accept()
        if self._layers is not None:
            touching = self._layers.move_anchors(self.sheet.x)
            self.record.touching_pairs = max(self.record.touching_pairs, touching)
        if self.floor.extended:
            place, _ = contact.ground_coordinates(x, self.ground_curvature_per_m)
            self.floor.set_directions(place)

    def _solve_apart(self, guess: np.ndarray) -> tuple[np.ndarray, float]:
        """Positions (V, 3) at the end, and the residual: infinite if parts passed through."""
        tolerance = self.settings.friction_tolerance
        layers = self._layers
        for _ in range(COVERS_MAX):
            x, error = self._solve_step(self._clear_guess(guess))
            if layers is None or not error <= tolerance:
                return x, error
            if not layers.covers(x):
                # Farther than the list of near pairs reaches: is it still a solution?
                layers.cover(self.positions_m, x)
                error = self._relative(self._evaluate(x))
            apart = layers.clear_part(self.positions_m, x - self.positions_m) == 1.0
            if apart and error <= tolerance:
                return x, error
        return x, np.inf

    def _clear_guess(self, guess: np.ndarray) -> np.ndarray:
        """Free coordinates held back to where no listed pair has passed through."""
        if self._layers is None:
            return guess
        move = guess - self.positions_m
        part = self._layers.clear_part(self.positions_m, move)
        return np.where(self.fixed, guess, self.positions_m + part * move)

    def _solve_step(self, x: np.ndarray) -> tuple[np.ndarray, float]:
        """Newton's method from x; where it ends, and the relative residual there."""
        settings = self.settings
        residual = self._evaluate(x)
        error = self._relative(residual)
        rate = 0.0
        exact = False
        self._products = 0
        for count in range(settings.newton_iterations_max):
            if count >= TRUSTED_AFTER and self._give_up and self._give_up(x):
                raise _TooLong
            if error <= settings.friction_tolerance or not np.isfinite(error):
                break
            slow = (rate > REFACTOR_RATE and not exact) or self._products > PRODUCTS_MAX
            if slow or not self._tangent.factored:
                self._factorise()
                self._products = 0
            exact = error < EXACT_BELOW
            correction = self._exact_correction(x, residual) if exact else None
            if correction is None or np.vdot(correction, residual) >= 0:
                if exact:
                    self._evaluate(x)
                correction = self._correction(residual)
            x, residual = self._search(x, residual, correction)
            before, error = error, self._relative(residual)
            rate = error / before
            self.record.newton_iterations += 1
        return x, error

    def start(self, preload_N: np.ndarray | float = 0.0) -> None:
        """Take the present positions as the beginning of the motion (strains, anchors).

        ``preload_N`` (V, 2) is the tangential force that friction bears at the beginning.
        """
        place, _ = contact.ground_coordinates(self.positions_m, self.ground_curvature_per_m)
        anchor = place[:, :2] - preload_N / self.contact_stiffness_N_m[:, None]
        self._nodes.anchor.assign(np.ascontiguousarray(anchor))
        self.floor.begin(self.positions_m, place)
        self.sheet.begin_step(self.positions_m)

    def go_on_from(self, other: "ClothSolver") -> None:
        """Take the state of another solver of the same cloth; layers forget their friction."""
        self.positions_m, self.velocities_m_s = other.positions_m, other.velocities_m_s
        self._acceleration_m_s2, self._last_step_s = other._acceleration_m_s2, other._last_step_s
        self.time_s, self._accurate_step_s = other.time_s, np.inf
        self.start()
        self._nodes.anchor.assign(other._nodes.anchor)
        self.floor.go_on_from(other.floor)

    def advance(
        self,
        duration_s: float,
        prescribed: Callable[[float], np.ndarray] | None = None,
        halvings: int = 0,
    ) -> None:
        """Move on by one step, halved as often as it takes to converge, or NotConverged.

        ``prescribed`` gives positions (V, 3) at a time, of which the fixed coordinates are read.
        """
        may_refine = halvings < REFINEMENTS_MAX
        outcome = Outcome.INACCURATE  # as the last step of this length was
        if duration_s <= 1.01 * self._accurate_step_s or not may_refine:
            outcome = self._attempt(duration_s, prescribed, may_refine)
        if outcome is Outcome.ACCEPTED:
            return
        if outcome is Outcome.UNSOLVED and halvings >= HALVINGS_MAX:
            raise NotConverged(
                f"at {self.time_s:.4f} s a step of {duration_s:.2e} s did not converge to "
                f"{self.settings.friction_tolerance:g} in {self.settings.newton_iterations_max} "
                "iterations",
                {
                    "time_s": self.time_s,
                    "positions_m": self.positions_m,
                    "velocities_m_s": self.velocities_m_s,
                    "anchors_m": self._nodes.anchor.numpy().copy(),
                    "last_residual_N": self.sheet.last_forces(),
                    "last_positions_m": self.sheet.evaluated()[0].copy(),
                    "faces": self.mesh.faces,
                },
            )
        for _ in range(2):
            self.advance(duration_s / 2, prescribed, halvings + 1)

    def try_step(
        self, duration_s: float, prescribed: Callable[[float], np.ndarray] | None = None
    ) -> bool:
        """Move on by one step as :meth:`advance` if it is accurate and converges; did it move?"""
        return self._attempt(duration_s, prescribed, may_refine=True) is Outcome.ACCEPTED

    def foreseen_step_s(self) -> float:
        """Longest step to be accurate if the motion goes on as in the last one; 0: not known."""
        allowed_m = self.settings.step_error_m
        if not isfinite(allowed_m):
            return 0.0
        times = sqrt(FORESEEN_ERROR * allowed_m / max(self._last_error_m, LEAST_ERROR_M))
        return min(times * self._last_step_s, self._accurate_step_s)

    def _attempt(self, step_s, prescribed: Callable | None, may_refine: bool) -> Outcome:
        outcome = self._try_step(step_s, prescribed, may_refine)
        if outcome is Outcome.INACCURATE:
            self.record.refinements += 1
        elif outcome is Outcome.UNSOLVED:
            self._tangent.factored = False
            self.record.halvings += 1
        return outcome

    def set_gravity(self, gravity_m_s2: tuple[float, float, float]) -> None:
        """Change gravity (a plane that is tilted)."""
        self._nodes.gravity_m_s2.assign(np.array([gravity_m_s2], dtype=float))

    # -- observables ----------------------------------------------------------------------

    def reactions(self) -> np.ndarray:
        """Forces (V, 3) of the holder on prescribed coordinates, at rest or in steady motion."""
        self._nodes.target.assign(self.positions_m)
        self.sheet.damping_ratio.fill_(0.0)
        free = self._nodes.free.numpy().copy()
        self._nodes.free.fill_(1.0)
        force = self._evaluate(self.positions_m)
        self._nodes.free.assign(free)
        return np.where(self.fixed, force, 0.0)

    def sticks(self) -> np.ndarray:
        """Which vertices the ground held in the last step, shape (V,)."""
        return self.sheet.evaluated()[1] == contact.STICK

    def floor_forces(self) -> np.ndarray:
        """Force of the ground on each vertex, shape (V, 3)."""
        x, frames = contact.ground_coordinates(self.positions_m, self.ground_curvature_per_m)
        stiffness = self.contact_stiffness_N_m
        normal = np.maximum(-stiffness * x[:, 2], 0.0)
        tangential = -stiffness[:, None] * (x[:, :2] - self._nodes.anchor.numpy())
        local = np.column_stack([np.where(normal[:, None] > 0, tangential, 0.0), normal])
        return np.einsum("nij,ni->nj", frames, local)
