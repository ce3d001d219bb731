"""Drop-and-drag: a square of fabric hung by its corners, lowered, dragged back and forth."""

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from functools import partial
from math import ceil, cos, pi, radians, sin

import numpy as np

from slipstitch.base.errors import BadInput, NotConverged
from slipstitch.base.progress import progress
from slipstitch.config.section import FRICTION_MAX
from slipstitch.config.simulation import SimulationSettings
from slipstitch.design.stage_path import SIDE_M, TAB_M, StagePath
from slipstitch.physics import GRAVITY_M_S2, cloth
from slipstitch.physics.fabric import ElasticTables, fabric_digest, load_fabric
from slipstitch.physics.friction_law import FrictionLaw
from slipstitch.physics.friction_law.extended_model import ExtendedModel, read_extended_model
from slipstitch.physics.simulation.convergence import measured_convergence
from slipstitch.physics.simulation.trajectory import Trajectory, rounded

LANDING_S = 0.1  # after the first touch, in which the cloth buckles


@dataclass(frozen=True)
class BenchPerturbation:
    """Quantities that vary between replicates on a bench."""

    yaw_deg: float  # rotation of the clamps about the vertical
    height_m: float  # added to the clamps' height
    density_factor: float  # on the fabric's parameters
    stretching_factor: float
    bending_factor: float
    natural_curl_per_m: float  # positive: the lower edge leans to -x, against the first stroke


def draw_perturbation(
    settings: SimulationSettings, seed: int, replicate: int = 0
) -> BenchPerturbation:
    """Draw the perturbation of one replicate; the same seed gives the same numbers."""
    random = np.random.default_rng(seed)
    spread = 0.0 if replicate < settings.ideal_replicates else 1.0
    factors = np.exp(spread * settings.fabric_sd_rel * random.standard_normal(3))
    density, stretching, bending = factors.tolist()
    yaw_deg = float(spread * settings.yaw_sd_deg * random.standard_normal())
    height_m = float(spread * settings.height_sd_m * random.standard_normal())
    sides = {"drawn": [-1.0, 1.0], "same": [1.0], "alternating": [-1.0 if replicate % 2 else 1.0]}
    curl_per_m = float(settings.natural_curl_per_m * random.choice(sides[settings.curl_side]))
    return BenchPerturbation(yaw_deg, height_m, density, stretching, bending, curl_per_m)


@dataclass(frozen=True)
class DropAndDrag:
    """One run."""

    material: str  # a fabric of the catalogue
    friction: float  # coefficient between cloth and floor
    seed: int  # of the bench's perturbation; the run itself draws nothing
    # The first may be of an ideal bench, and the curl may change sides from one to the next
    # (`SimulationSettings.ideal_replicates`, ``curl_side``).
    replicate: int = 0

    def catalogue_entries(self) -> dict[str, dict[str, str | None]]:
        """The fabric's measured data for the record."""
        return {"fabrics": {self.material: fabric_digest(self.material)}}


Recorded = tuple[Trajectory, dict[str, np.ndarray]]


def simulate_drop_and_drag(
    run: DropAndDrag, settings: SimulationSettings, device: str = "cpu"
) -> Recorded:
    """Simulate one run on a Warp device.

    Return the trajectory, rounded as files hold it, and as columns the ``newton_iterations`` (T,)
    since the frame before and the largest ``residual`` (T,) of an accepted step.
    """
    with progress(unit="frame", total=settings.frames) as bar:
        return _Bench(run, settings, device).record(bar.update)


def cloth_mesh(settings: SimulationSettings) -> tuple[cloth.ClothMesh, np.ndarray]:
    """Mesh of the cloth, and the numbers of the vertices that the clamps hold."""
    mesh = cloth.rectangle(settings.vertices_per_side, settings.vertices_per_side, SIDE_M, SIDE_M)
    across, down = mesh.rest_uv_m.T
    inner = TAB_M + 1e-9 if settings.pins == "tabs" else 1e-9
    return mesh, np.flatnonzero((down == 0) & ((across <= inner) | (across >= SIDE_M - inner)))


def described_mesh(mesh: cloth.ClothMesh, pinned: np.ndarray) -> dict[str, np.ndarray]:
    """A mesh as a trajectory describes it."""
    across, down = mesh.rest_uv_m.T
    return {
        "rest_positions_m": np.column_stack([np.zeros(len(down)), across - SIDE_M / 2, -down]),
        "uv": mesh.rest_uv_m / SIDE_M,
        "faces": mesh.faces,
        "pinned": pinned,
    }


class Landing:
    """Check of the steps while the cloth lands: does it buckle to the side of finer steps?

    A step may have a solution on either side, and one that is nearly too long takes the wrong one
    without its error telling. So a second solver repeats every step of the landing in two halves,
    and must go the same way. No long step is taken then.
    """

    def __init__(
        self,
        solver: cloth.ClothSolver,
        new_solver: Callable[[], cloth.ClothSolver],
        clamps: Callable[[float], np.ndarray],
        settings: SimulationSettings,
    ):
        self._solver, self._clamps, self._settings = solver, clamps, settings
        self._new_solver = new_solver
        self._finer: cloth.ClothSolver | None = None
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

        With steps a quarter as long, cosines were from 0.68 up in all fabrics: less than 0 is
        another side, unless both ways agree within the error that a step may have.
        """
        start_m = self._solver.positions_m[:, 0]
        way_m, finer_way_m = end_m[:, 0] - start_m, finer_m[:, 0] - start_m
        apart_m = float(np.sqrt(np.mean((way_m - finer_way_m) ** 2)))
        return np.vdot(way_m, finer_way_m) >= 0 or apart_m <= self._settings.step_error_m


class _Bench:
    """A cloth hung up for one run."""

    def __init__(self, run: DropAndDrag, settings: SimulationSettings, device: str):
        if not 0 <= run.friction <= FRICTION_MAX:  # nor where it is not a number
            raise BadInput(f"friction {run.friction:g}: must lie between 0 and {FRICTION_MAX:g}")
        self.run, self.settings = run, settings
        self.path = path = StagePath(**dict(settings.stage))
        self.mesh, self.pinned = mesh, pinned = cloth_mesh(settings)
        self.model = model = (
            read_extended_model(settings.model) if settings.model else ExtendedModel(FrictionLaw(0))
        )
        self.perturbation = perturbation = draw_perturbation(settings, run.seed, run.replicate)
        fabric = load_fabric(run.material).scaled(
            perturbation.density_factor * (1 + model.mass_error),
            perturbation.stretching_factor,
            perturbation.bending_factor * (1 + model.bending_error),
        )
        tables = ElasticTables.of_fabric(fabric)
        across, down = mesh.rest_uv_m.T
        fixed = np.zeros((mesh.vertex_count, 3), dtype=bool)
        fixed[pinned] = True
        yaw = radians(perturbation.yaw_deg)
        lateral = across - SIDE_M / 2
        self.hung_m = hung_m = np.column_stack(
            [-sin(yaw) * lateral, cos(yaw) * lateral, path.start_height_m - down]
        )
        hung_m[:, 2] += perturbation.height_m
        own = cloth.SolverSettings.of(settings.of_fabric(run.material))
        new_solver = partial(
            cloth.ClothSolver,
            mesh,
            replace(tables, rest_curvature_per_m=perturbation.natural_curl_per_m),
            hung_m,
            friction=model.law_at(run.friction),
            fixed=fixed,
            settings=replace(own, device=device),
            conditions=cloth.Conditions(
                gravity_m_s2=model.gravity_m_s2(GRAVITY_M_S2),
                warp_angle_rad=0.0 if settings.warp == "u" else pi / 2,
            ),
        )
        self.solver = new_solver()
        self.solver.confirm = Landing(self.solver, new_solver, self.clamps, settings).confirms

    def clamps(self, time_s: float) -> np.ndarray:
        """Positions (V, 3) of which those of the held vertices count, in m."""
        x, z = self.path.position_m(max(time_s, 0.0))
        return self.hung_m + np.array([x, 0.0, z - self.path.start_height_m])

    def record(self, frame_done) -> Recorded:
        """Let the cloth settle, then go through the protocol."""
        solver, settings = self.solver, self.settings
        solver.start()
        per_frame = settings.steps_a_frame
        for _ in self._march(-settings.settle_steps, 0):
            pass
        totals, solver.record = solver.record, cloth.StepRecord()
        times_s = np.arange(settings.frames) / settings.frame_rate_hz
        positions = np.empty((settings.frames, self.mesh.vertex_count, 3), dtype=np.float32)
        iterations = np.zeros(settings.frames, dtype=np.int32)
        residuals = np.zeros(settings.frames)
        positions[0] = solver.positions_m
        iterations[0], residuals[0] = totals.newton_iterations, totals.largest_residual
        frame_done()
        for begun, ended, start_m in self._march(0, settings.recorded_steps):
            record, solver.record = solver.record, cloth.StepRecord()
            totals.add(record)
            # The frames that the step belongs to; all but perhaps the last are reached.
            frames = range(begun // per_frame + 1, ceil(ended / per_frame) + 1)
            iterations[frames[-1]] += record.newton_iterations
            for frame in frames:
                residuals[frame] = max(residuals[frame], record.largest_residual)
                part = (frame * per_frame - begun) / (ended - begun)
                if part <= 1:  # within a long step, which is steady, on a straight line
                    positions[frame] = start_m + part * (solver.positions_m - start_m)
                    frame_done()
        trajectory = self._trajectory(times_s, rounded(positions), totals)
        return trajectory, {"newton_iterations": iterations, "residual": residuals}

    def _march(self, first: int, last: int) -> Iterator[tuple[int, int, np.ndarray]]:
        """Advance by time steps, several at once where steady; yield numbers, positions before."""
        solver, step_s = self.solver, self.settings.step_used_s
        at_once = self.settings.steps_at_once
        while first < last:
            # Restated, so that rounding does not pile up over thousands of steps.
            solver.time_s = first * step_s
            start_m = solver.positions_m
            most = min(at_once - first % at_once, last - first)
            steps = min(most, int(solver.foreseen_step_s() / step_s))
            if steps < 2 or not solver.try_step(steps * step_s, self.clamps):
                steps = 1
                solver.advance(step_s, self.clamps)
            yield first, first + steps, start_m
            first += steps
        solver.time_s = last * step_s

    def _trajectory(self, times_s, positions_m, totals: cloth.StepRecord) -> Trajectory:
        run, settings = self.run, self.settings
        stage_x_m, stage_z_m = self.path.position_m(times_s)
        return Trajectory(
            **described_mesh(self.mesh, self.pinned),
            frame=np.arange(settings.frames),
            time_s=times_s,
            stage_x_m=stage_x_m,
            stage_z_m=stage_z_m + self.perturbation.height_m,
            positions_m=positions_m,
            metadata={
                "material": run.material,
                "friction": run.friction,
                "seed": run.seed,
                "settings": settings.model_dump(mode="json"),
                "perturbation": asdict(self.perturbation),
                "stage_path": asdict(self.path),
                "extended_model": asdict(self.model) if settings.model else None,
                "step_s": settings.step_used_s,
                "solver": asdict(totals),
                "device": self.solver.settings.device,
                "convergence": measured_convergence(run.material, run.friction, settings),
            },
        )
