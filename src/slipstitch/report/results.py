"""Reading a results folder, complete or not."""

import io
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas

from slipstitch.base.errors import BadInput
from slipstitch.base.page.figures import data_uri
from slipstitch.base.provenance import (
    read_json,
    read_metadata,
    read_parquet,
    read_provenance,
    read_sidecar,
)
from slipstitch.config import Config
from slipstitch.dataset.manifest import MANIFEST, read_manifest
from slipstitch.dataset.videos import read_frames
from slipstitch.design.grid import Simulation, simulations
from slipstitch.design.trainable import trainings
from slipstitch.physics.simulation.trajectory import read_trajectory

Rows = list[dict[str, Any]]
Table = tuple[list[str], list[list[str]]]  # headings, cells as they are shown


class SimulationSummary(NamedTuple):
    """Of one simulation: times (s), and the line down the cloth's middle, from the upper edge."""

    simulation: Simulation
    time_s: np.ndarray
    centre_m: np.ndarray  # (frames, n, 2): x relative to the clamps, and height


class History(NamedTuple):
    """Training curve of one network, a row an epoch."""

    split: str
    network: str
    seed: int
    epochs: pandas.DataFrame


class Results:
    """A results folder. Everything is read when asked for; what is not there is None or empty.

    `read` has the results that were read so far; journal, logs and costs do not count. BadInput if
    there is no such folder; later, if a file in it cannot be read.
    """

    def __init__(self, folder: str | os.PathLike, config: Config):
        self.folder = Path(folder)
        self.config = config
        self.read: set[Path] = set()
        if not self.folder.is_dir():
            raise BadInput(f"{folder}: no such folder")

    def _there(self, *parts: str) -> Path | None:
        """A file's path, noted as read; None if there is no such file."""
        path = self.folder.joinpath(*parts)
        if not path.exists():
            return None
        self.read.add(path)
        return path

    def json(self, *parts: str) -> Any | None:
        """Content of a JSON file of the folder."""
        path = self._there(*parts)
        return read_json(path) if path else None

    def content(self, *parts: str) -> bytes | None:
        """The bytes of a file of the folder; BadInput if there is one that cannot be read."""
        path = self._there(*parts)
        try:
            return path.read_bytes() if path else None
        except OSError as error:
            raise BadInput(f"{path}: cannot be read: {error.strerror}") from None

    def picture(self, *parts: str) -> str | None:
        """A PNG or SVG of the folder as an address."""
        content = self.content(*parts)
        kind = "svg+xml" if parts[-1].endswith(".svg") else parts[-1].rpartition(".")[2]
        return None if content is None else data_uri(content, f"image/{kind}")

    def _rows(self, columns: Sequence[str], *parts: str) -> Rows | None:
        path = self._there(*parts)
        return read_parquet(path, columns).to_pylist() if path else None

    def convergence(self) -> Mapping[str, Any] | None:
        """The convergence study: this folder's own, else the published one in it."""
        name = "convergence", "convergence.json"
        return self.json(*name) or self.json("published", *name)

    def simulation_path(self, simulation: Simulation) -> Path:
        """Path of a simulation's trajectory."""
        return self.folder / "simulate" / f"{simulation.id}.parquet"

    def simulated(self) -> list[Simulation]:
        """The simulations of the grid whose trajectory is there."""
        return [one for one in simulations(self.config) if self.simulation_path(one).exists()]

    def largest_residual(self) -> tuple[float | None, float | None]:
        """Of all simulations: largest residual of an accepted step, and largest tolerance."""
        residuals: list[float] = []
        tolerances: list[float] = []
        for simulation in self.simulated():
            path = self.simulation_path(simulation)
            self.read.add(path)
            residuals += map(float, read_parquet(path, ["residual"])["residual"].to_numpy())
            tolerance = (read_metadata(path).get("settings") or {}).get("friction_tolerance")
            tolerances += [] if tolerance is None else [tolerance]
        return max(residuals, default=None), max(tolerances, default=None)

    def trajectories(self, chosen: Iterable[Simulation]) -> Iterator[SimulationSummary]:
        """Trajectories, one by one: they are large."""
        for simulation in chosen:
            path = self.simulation_path(simulation)
            self.read.add(path)
            run = read_trajectory(path)
            # The vertices nearest the middle, from the upper edge (v = 0) to the lower one.
            across = np.abs(run.uv[:, 0] - 0.5)
            line = np.flatnonzero(across <= across.min() + 1e-9)
            line = line[np.argsort(run.uv[line, 1], kind="stable")]
            centre = run.positions_m[:, line][:, :, [0, 2]].astype(float)
            centre[:, :, 0] -= run.stage_x_m[:, None]
            yield SimulationSummary(simulation, run.time_s, centre)

    def rendered(self) -> list[Path]:
        """The image shards."""
        return sorted((self.folder / "render").glob("m*_v*.parquet"))

    def manifest(self) -> Rows | None:
        """Rows of the dataset's manifest."""
        path = self._there("sample", MANIFEST)
        return read_manifest(path.parent)[0] if path else None

    def images(self, video: Mapping[str, Any], positions: Sequence[int]) -> list[bytes]:
        """PNG bytes of a video's sampled frames at some positions."""
        path = self._there("sample", video["file"])
        if path is None:
            return []
        found = {position: png for _, position, png in read_frames(path, video["video"])}
        return [found[position] for position in sorted(positions) if position in found]

    def _trainings(self) -> Iterator[tuple[Path, str, str, int]]:
        """The configured trainings: folder, split, network, seed."""
        train = self.config.train
        for split in train.splits:
            for network, seed in trainings(train, split):
                yield self.folder / f"train/{split}/{network}/seed{seed}", split, network, seed
        for split, seed in product(train.splits, self.config.instrument.seeds):
            yield self.folder / f"instrument/{split}/seed{seed}", split, "instrument", seed

    def histories(self) -> list[History]:
        """Training curves, in the order of the configuration; others, left by another, not."""
        found = []
        for folder, split, network, seed in self._trainings():
            path = folder / "history.csv"
            content = self.content(*path.relative_to(self.folder).parts)
            if content is None:
                continue
            try:
                epochs = pandas.read_csv(io.BytesIO(content))
            except ValueError as error:
                raise BadInput(f"{path}: not a training history: {error}") from None
            found.append(History(split, network, seed, epochs))
        return [history for history in found if len(history.epochs)]

    def predictions(self) -> Rows | None:
        """Rows of predictions.parquet."""
        columns = ["simulation", "split", "network", "seed", "true_value", "predicted_value"]
        columns += ["low", "high", "probabilities"]
        return self._rows(columns, "evaluate", "predictions.parquet")

    def capture_predictions(self) -> Rows | None:
        """Predictions of every model for every capture."""
        columns = ["video", "pair", "material", "substrate", "mu_ref", "mu_ref_error"]
        columns += ["reflective", "surrogate", "model", "trained_on", "seed", "friction", "low"]
        return self._rows(columns, "captures", "predictions.parquet")

    def captures_of_other_networks(self) -> bool:
        """Whether the captures' scores are of a network that the test sets' are not of."""
        files = [self.folder / stage / "metrics.json" for stage in ("captures", "evaluate")]
        try:
            inputs = [read_sidecar(file).get("inputs", {}) for file in files]
        except FileNotFoundError:
            return False
        of = [{one[name] for name in one if name.endswith(".safetensors")} for one in inputs]
        return not of[0] <= of[1]

    def provenance(self) -> list[tuple[str, dict[str, Any]]]:
        """One record of each stage, with the artefact that carries it."""
        models = (folder / "model.safetensors" for folder, *_ in self._trainings())
        candidates = [
            self.folder / "calibrate/calibration.json",
            *map(self.simulation_path, self.simulated()[:1]),
            *self.rendered()[:1],
            self.folder / "sample" / MANIFEST,
            *[path for path in models if path.exists()][:1],
            self.folder / "evaluate/metrics.json",
        ]
        found = []
        for path in candidates:
            with suppress(FileNotFoundError, ValueError):
                found.append((str(path.relative_to(self.folder)), read_provenance(path)))
                self.read.add(path)
        return found
