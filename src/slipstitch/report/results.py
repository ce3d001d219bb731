"""Reading a results folder, complete or not."""

import csv
import io
import math
import os
import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import (
    read_json,
    read_metadata,
    read_parquet,
    read_provenance,
    read_sidecar,
)
from slipstitch.config import Config
from slipstitch.dataset.images import read_frames
from slipstitch.dataset.manifest import MANIFEST, read_manifest
from slipstitch.design.grid import Simulation, simulations
from slipstitch.physics.simulation.trajectory import read_trajectory
from slipstitch.report.benchmark import read_benchmark
from slipstitch.report.status.runs import Failure, Run, failures, read_runs

STAGES = (
    "calibrate",
    "simulate",
    "convergence",
    "render",
    "sample",
    "train",
    "instrument",
    "evaluate",
    "criticise",
    "release",
    "audit",
    "report",
)


@dataclass(frozen=True)
class SimulationSummary:
    """The content of the report on one simulation.

    Attributes
    ----------
    simulation : Simulation
        Its place in the grid.
    time_s : ndarray, shape (frames,)
    stage_x_m, stage_z_m : ndarray, shape (frames,)
        Place of the clamps.
    centre_m : ndarray, shape (frames, n, 2)
        The line down the middle of the cloth, from the upper to the lower edge: x relative to the
        clamps, and height, in m.
    """

    simulation: Simulation
    time_s: np.ndarray
    stage_x_m: np.ndarray
    stage_z_m: np.ndarray
    centre_m: np.ndarray


@dataclass(frozen=True)
class Benchmark:
    """Total cost of the jobs of one stage, by their benchmark files and logs.

    Attributes
    ----------
    stage : str
    jobs : int
    wall_s, cpu_s : float
        Sums over the jobs (s).
    wall_median_s, cpu_median_s : float
        Medians over the jobs (s).
    memory_mib : float or None
        Largest resident memory of a job (MiB).
    """

    stage: str
    jobs: int
    wall_s: float
    cpu_s: float
    wall_median_s: float
    cpu_median_s: float
    memory_mib: float | None


@dataclass(frozen=True)
class History:
    """Training curve of one network."""

    split: str
    network: str
    seed: int
    epochs: list[dict[str, Any]] = field(repr=False)


class Results:
    """A results folder. Everything is read when asked for; what is not there is None or empty.

    Parameters
    ----------
    folder : path
        The folder.
    config : Config
        What the folder is to hold.

    Attributes
    ----------
    read : set of Path
        The results that were read so far; what is known of the runs themselves (journal, logs,
        costs) does not count.

    Raises
    ------
    BadInput
        If there is no such folder; later, if a file in it cannot be read.
    """

    def __init__(self, folder: str | os.PathLike, config: Config):
        self.folder = Path(folder)
        self.config = config
        self.read: set[Path] = set()
        if not self.folder.is_dir():
            raise BadInput(f"{folder}: no such folder")

    def _noted(self, path: Path) -> Path:
        self.read.add(path)
        return path

    def _json(self, *parts: str) -> Any | None:
        path = self.folder.joinpath(*parts)
        return read_json(self._noted(path)) if path.exists() else None

    def content(self, path: Path) -> bytes:
        """The bytes of a file of the folder.

        Raises
        ------
        BadInput
            If it cannot be read.
        """
        try:
            return self._noted(path).read_bytes()
        except OSError as error:
            raise BadInput(f"{path}: cannot be read: {error.strerror}") from None

    def calibration(self) -> Mapping[str, Any] | None:
        """Content of calibration.json."""
        return self._json("calibrate", "calibration.json")

    def convergence(self) -> Mapping[str, Any] | None:
        """The convergence study: this folder's own, else the published one in it."""
        own = self._json("convergence", "convergence.json")
        return own or self._json("published", "convergence", "convergence.json")

    def simulation_path(self, simulation: Simulation) -> Path:
        """Path of a simulation's trajectory."""
        return self.folder / "simulate" / f"{simulation.id}.parquet"

    def simulated(self) -> list[Simulation]:
        """The simulations of the grid whose trajectory is there."""
        return [
            simulation
            for simulation in simulations(self.config)
            if self.simulation_path(simulation).exists()
        ]

    def trajectories(self, chosen: list[Simulation] | None = None) -> Iterator[SimulationSummary]:
        """Trajectories, one by one: they are large."""
        for simulation in self.simulated() if chosen is None else chosen:
            yield self._trajectory(simulation)

    def largest_residual(self) -> tuple[float | None, float | None]:
        """Of all simulations: largest residual of an accepted step, and largest tolerance."""
        residuals: list[float] = []
        tolerances: list[float] = []
        for simulation in self.simulated():
            path = self._noted(self.simulation_path(simulation))
            residuals += map(float, read_parquet(path, ["residual"])["residual"].to_numpy())
            tolerance = (read_metadata(path).get("settings") or {}).get("friction_tolerance")
            tolerances += [] if tolerance is None else [tolerance]
        return max(residuals, default=None), max(tolerances, default=None)

    def _trajectory(self, simulation: Simulation) -> SimulationSummary:
        run = read_trajectory(self._noted(self.simulation_path(simulation)))
        # The vertices nearest the middle, ordered from the upper edge (v = 0) to the lower one.
        across = np.abs(run.uv[:, 0] - 0.5)
        line = np.flatnonzero(across <= across.min() + 1e-9)
        line = line[np.argsort(run.uv[line, 1], kind="stable")]
        centre = run.positions_m[:, line][:, :, [0, 2]].astype(float)
        centre[:, :, 0] -= run.stage_x_m[:, None]
        return SimulationSummary(
            simulation=simulation,
            time_s=run.time_s,
            stage_x_m=run.stage_x_m,
            stage_z_m=run.stage_z_m,
            centre_m=centre,
        )

    def preview(self, simulation: Simulation, suffix: str = ".png") -> Path | None:
        """Contact sheet of a simulation, or (``.mp4``) its film."""
        path = self.folder / "render" / "preview" / f"{simulation.id}{suffix}"
        return path if path.exists() else None

    def rendered(self) -> int:
        """Number of image shards."""
        return len(list((self.folder / "render").glob("m*_v*.parquet")))

    def manifest(self) -> list[dict[str, Any]] | None:
        """Rows of the dataset's manifest."""
        folder = self.folder / "sample"
        if not (folder / MANIFEST).exists():
            return None
        self._noted(folder / MANIFEST)
        return read_manifest(folder)[0]

    def images(self, video: Mapping[str, Any], positions: list[int]) -> list[bytes]:
        """PNG bytes of a video's sampled frames at some positions."""
        path = self.folder / "sample" / video["file"]
        if not path.exists():
            return []
        wanted = sorted(positions)
        frames = read_frames(self._noted(path), video["video"])
        found = {position: png for _, position, png in frames}
        return [found[position] for position in wanted if position in found]

    def _trainings(self) -> Iterator[tuple[Path, str, str, int]]:
        """The configured trainings: folder, split, network, seed."""
        for split in self.config.train.splits:
            for network, seed in self.config.train.trainings(split):
                yield self.folder / f"train/{split}/{network}/seed{seed}", split, network, seed
        for split in self.config.train.splits:
            for seed in self.config.instrument.seeds:
                yield self.folder / f"instrument/{split}/seed{seed}", split, "instrument", seed

    def histories(self) -> list[History]:
        """Training curves, in the order of the configuration; others, left by another, not."""
        found = []
        for folder, split, network, seed in self._trainings():
            path = folder / "history.csv"
            if not path.exists():
                continue
            try:
                rows = list(csv.DictReader(io.StringIO(self.content(path).decode())))
                epochs = [
                    {key: _number(value) for key, value in row.items() if key is not None}
                    for row in rows
                ]
                found.append(History(split, network, seed, epochs))
            except ValueError as error:
                raise BadInput(f"{path}: not a training history: {error}") from None
        return [history for history in found if history.epochs]

    def metrics(self) -> Mapping[str, Any] | None:
        """Content of metrics.json."""
        return self._json("evaluate", "metrics.json")

    def details(self) -> Mapping[str, Any]:
        """Content of details.json; empty if there is none."""
        return self._json("evaluate", "details.json") or {}

    def predictions(self) -> list[dict[str, Any]] | None:
        """Rows of predictions.parquet."""
        path = self.folder / "evaluate" / "predictions.parquet"
        if not path.exists():
            return None
        columns = ["simulation", "split", "network", "seed", "true_value", "predicted_value"]
        return read_parquet(self._noted(path), columns).to_pylist()

    def capture_metrics(self) -> Mapping[str, Any] | None:
        """Scores on captures, by subset and model."""
        return self._json("captures", "metrics.json")

    def capture_predictions(self) -> list[dict[str, Any]] | None:
        """Predictions of every model for every capture."""
        path = self.folder / "captures" / "predictions.parquet"
        if not path.exists():
            return None
        columns = ["video", "pair", "mu_ref", "mu_ref_error", "reflective", "surrogate"]
        columns += ["model", "trained_on", "seed", "friction"]
        return read_parquet(self._noted(path), columns).to_pylist()

    def captures_of_other_networks(self) -> bool:
        """Whether the captures' scores are of a network that the test sets' are not of."""
        weights = []
        for stage in ("captures", "evaluate"):
            try:
                inputs = read_sidecar(self.folder / stage / "metrics.json").get("inputs", {})
            except FileNotFoundError:
                return False
            weights.append({inputs[name] for name in inputs if name.endswith(".safetensors")})
        return not weights[0] <= weights[1]

    def verdict(self, case: str) -> dict[str, Any] | None:
        """Content of a measured case's verdict.json."""
        return self._json("criticise", case, "verdict.json")

    def criticism_picture(self, case: str) -> str | None:
        """What the friction law leaves over in a case, as the text of an SVG."""
        path = self.folder / "criticise" / case / "picture.svg"
        return self.content(path).decode() if path.exists() else None

    def simulated_again(self, case: str) -> Mapping[str, Any] | None:
        """Errors of a case's runs in the cloth simulator, without and with the extended law."""
        again = self._json("criticise", case, "resimulation.json") or {}
        return again.get("all")

    def audit(self) -> Mapping[str, Any] | None:
        """What an audit of the release found."""
        return self._json("audit", "audit.json")

    def benchmarks(self, job_classes: bool = False) -> list[Benchmark]:
        """Cost of every stage that has benchmark files, in the order of the chain.

        With `job_classes`, of every class of jobs that the files' names tell: ``render/shade``.
        """
        folder = self.folder / "benchmarks"
        classes: dict[str, list[Path]] = {}
        for path in sorted(folder.glob("*/*.tsv")):
            name = path.parent.name
            if job_classes:
                # A network, or the word before what the job was of: sweep_..., shade_...
                job = re.search(r"[a-z]+_[a-z]+(?=_seed)|^(?!by_)[a-z]+(?=_|$)", path.stem)
                name += f"/{job[0]}" if job else ""
            classes.setdefault(name, []).append(path)
        stages = {name: name.split("/")[0] for name in classes}
        found = []
        for name in sorted(
            classes,
            key=lambda name: (STAGES.index(stages[name]) if stages[name] in STAGES else 99, name),
        ):
            jobs = [cost for path in classes[name] if (cost := read_benchmark(path))]
            if not jobs:
                continue
            wall = [job.wall_s for job in jobs]
            cpu = [job.cpu_s for job in jobs if not math.isnan(job.cpu_s)] or [math.nan]
            memory = [job.memory_mib for job in jobs if not math.isnan(job.memory_mib)]
            found.append(
                Benchmark(
                    stage=name,
                    jobs=len(wall),
                    wall_s=sum(wall),
                    cpu_s=sum(cpu),
                    wall_median_s=float(np.median(wall)),
                    cpu_median_s=float(np.median(cpu)),
                    memory_mib=max(memory) if memory else None,
                )
            )
        return found

    def runs(self) -> list[Run]:
        """Runs of the workflow that left a journal, the last one last."""
        return read_runs(self.folder)

    def failures(self) -> list[Failure]:
        """Every failed attempt at a job, the oldest first."""
        return failures(self.folder, self.runs())

    def provenance(self) -> list[tuple[str, dict[str, Any]]]:
        """One record of each stage, with the artefact that carries it."""
        candidates = [
            self.folder / "calibrate" / "calibration.json",
            *map(self.simulation_path, self.simulated()[:1]),
            *sorted((self.folder / "render").glob("m*_v*.parquet"))[:1],
            self.folder / "sample" / "manifest.parquet",
            *[
                path
                for folder, *_ in self._trainings()
                if (path := folder / "model.safetensors").exists()
            ][:1],
            self.folder / "evaluate" / "metrics.json",
        ]
        found = []
        for path in candidates:
            with suppress(FileNotFoundError, ValueError):
                found.append((str(path.relative_to(self.folder)), read_provenance(path)))
                self._noted(path)
        return found


def _number(text: Any) -> Any:
    try:
        value = float(text)
    except (TypeError, ValueError):
        return text
    return value if np.isfinite(value) else None
