"""One question, one seed: its variants trained one after another, then tested.

A variant whose training is finished is not trained again: a file beside its model says what it was
trained on, with which settings and code. Killed within a training, it goes on from its checkpoint.
"""

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import code_digest, provenance_record, start_clock, write_json
from slipstitch.config import Config
from slipstitch.config.ablate import QUESTIONS
from slipstitch.config.instrument import InstrumentSettings
from slipstitch.config.train import TrainSettings
from slipstitch.dataset.manifest import MANIFEST, read_manifest
from slipstitch.dataset.videos import Videos, read_videos
from slipstitch.learning.ablation.questions import Plan, Variant, plan
from slipstitch.learning.classes import labels_of
from slipstitch.learning.instrument.augmentation import phased
from slipstitch.learning.instrument.measuring import WEIGHTS as INSTRUMENT_WEIGHTS
from slipstitch.learning.instrument.measuring import load_instrument
from slipstitch.learning.instrument.training import train_instrument
from slipstitch.learning.lrcn_model import FINE_TUNING, TRUE, LrcnModel, load_model, train_network
from slipstitch.learning.lrcn_model import WEIGHTS as LRCN_WEIGHTS
from slipstitch.learning.torch_setup import set_up_torch
from slipstitch.learning.trainer import DivergedError, Phase, Run

SPLIT = "by_simulation"
FINISHED = "finished.json"
WEIGHTS = (LRCN_WEIGHTS, INSTRUMENT_WEIGHTS)


def lrcn_settings(config: Config, changes: dict[str, Any]) -> TrainSettings:
    """The section `train` as the ablation and a variant change it.

    A run that stays at chance is a result here, so that it does not fail.
    """
    whole = {**config.train.model_dump(), **config.ablate.train, **changes, "plateau_margin": None}
    return TrainSettings.model_validate(whole)


def instrument_settings(config: Config) -> InstrumentSettings:
    """The section `instrument` as the ablation changes it; staying at chance does not fail."""
    whole = {
        **config.instrument.model_dump(),
        **config.ablate.instrument,
        "epochs": config.ablate.instrument_passes,
        "plateau_margin": None,
    }
    return InstrumentSettings.model_validate(whole)


def phases(viewpoints: list[str], passes: int, fine_tuning: int, joint: bool) -> list[Phase]:
    """Epochs by viewpoints; joint and progressive show as many videos, however many viewpoints.

    One viewpoint: `passes` epochs. V of them: cycles of E = 2 passes / (V + 1) epochs, rounded (and
    even where V is), show E V (V + 1) / 2 times the videos of a viewpoint, as do E (V + 1) / 2
    epochs of all. Both end with the same fine-tuning on the first viewpoint.
    """
    count = len(viewpoints)
    if count == 1:
        return [Phase("one viewpoint", tuple(viewpoints), passes)]
    epochs = max(1, round(2 * passes / (count + 1)))
    epochs += (count % 2 == 0) and (epochs % 2)
    if joint:
        whole = [Phase("joint", tuple(viewpoints), epochs * (count + 1) // 2)]
    else:
        whole = [
            Phase(f"cycle {seen}", tuple(viewpoints[:seen]), epochs) for seen in range(1, count + 1)
        ]
    if fine_tuning:
        whole.append(Phase(FINE_TUNING, (viewpoints[0],), fine_tuning))
    return whole


def answer(
    config: Config,
    dataset: str | os.PathLike,
    question: str,
    seed: int,
    folder: str | os.PathLike,
    threads: int = 1,
) -> dict[str, Any]:
    """Train all variants of a question with one seed, and test them.

    Parameters
    ----------
    config : Config
    dataset : path
        Folder that the sample stage wrote.
    question : str
    seed : int
    folder : path
        Gets a folder a training.
    threads : int

    Returns
    -------
    dict
        ``question, seed, asks, left_out, variants, predictions``: see docs/how/learning.md.

    Raises
    ------
    BadInput
        If the dataset cannot answer a question that the configuration names.
    """
    if question not in QUESTIONS:
        raise BadInput(f"unknown question {question!r}; known: {', '.join(QUESTIONS)}")
    rows, digest = read_manifest(dataset)
    viewpoints = config.view_order
    empty: dict[str, Any] = {"question": question, "seed": seed, "asks": None, "left_out": None}
    empty |= {"dataset_digest": digest, "variants": [], "predictions": []}
    try:
        planned = plan(question, rows, viewpoints, config.ablate, seed)
    except BadInput as reason:
        if config.ablate.questions is not None:
            raise
        return {**empty, "left_out": str(reason)}
    set_up_torch(threads)
    runs = _Runs(config, Path(dataset), digest, seed, Path(folder), planned, threads)
    variants, predictions = [], []
    for network in planned.networks:
        run = runs.lrcn if network == "lrcn" else runs.instrument
        for variant in planned.variants:
            row, predicted = run(variant)
            variants.append({"network": network, "variant": variant.name, **row})
            predictions += [
                {"network": network, "variant": variant.name, **prediction}
                for prediction in predicted
            ]
    return {**empty, "asks": planned.asks, "variants": variants, "predictions": predictions}


class _Runs:
    """The trainings of one question and seed."""

    def __init__(self, config, dataset, digest, seed, folder, planned: Plan, threads):
        self.config, self.dataset, self.digest = config, dataset, digest
        self.seed, self.folder, self.plan, self.threads = seed, folder, planned, threads
        self.tested = frozenset().union(*planned.tests.values())
        self.read: dict[tuple, Videos] = {}

    def videos(self, pixels: int | None, frames: int | None) -> Videos:
        """The test videos, decoded once."""
        if (pixels, frames) not in self.read:
            self.read = {
                (pixels, frames): read_videos(
                    self.dataset, lambda row: row["video"] in self.tested, pixels, frames
                )
            }
        return self.read[pixels, frames]

    def lrcn(self, variant: Variant) -> tuple[dict[str, Any], list[dict[str, Any]]]:
        """Train and test the paper's network; its row and its predictions."""
        settings = lrcn_settings(self.config, variant.changes)
        frames = self.config.sample.frames
        planned = phases(
            self.plan.viewpoints,
            self.config.ablate.passes,
            settings.fine_tuning_epochs,
            variant.joint,
        )
        folder = self.folder / f"lrcn_{variant.name}"

        def train(network: str, name: str, **told) -> dict[str, Any]:
            identity = {
                "network": network,
                "settings": settings.model_dump(mode="json"),
                "phases": [[phase.name, *phase.viewpoints, phase.epochs] for phase in planned],
                "code_digest": code_digest("train"),
                "frames": frames,
                "condition": told.get("condition_sha256", variant.condition),
            }
            return self._once(
                folder / name,
                variant,
                identity,
                lambda: train_network(
                    settings,
                    self._training(variant, folder / name),
                    network,
                    self.plan.viewpoints,
                    phases=planned,
                    material_model=told.get("material_model"),
                ),
            )

        passes = sum(phase.epochs * len(phase.viewpoints) for phase in planned)
        row = self._row(variant, passes / len(self.plan.viewpoints))
        material = None
        if variant.condition == "none":
            found = train("friction_baseline", "friction")
        elif variant.condition == "true":
            found = train("friction_conditional", "friction", material_model=TRUE)
        else:
            found = train("material_baseline", "material")
            if found["failure"] is None:
                material = load_model(folder / "material")
                row["material_stayed_at_chance"] = _at_chance(
                    found, self.config.train.plateau_margin
                )
                found = train(
                    "friction_conditional",
                    "friction",
                    material_model=folder / "material",
                    condition_sha256=material.card["weights_sha256"],
                )
        row |= {
            "failure": found["failure"],
            "stayed_at_chance": _at_chance(found, self.config.train.plateau_margin),
        }
        if found["failure"] is not None:
            return row, []
        model = load_model(folder / "friction")
        row |= {key: model.card[key] for key in ("train_loss", "chance_loss")}
        videos = self.videos(settings.pixels, frames)
        condition = self._condition(variant, model, material, videos)
        probabilities = model.probabilities(videos, condition)
        values = np.array([entry["value"] for entry in model.card["classes"]])
        return row, self._predictions(videos, values[probabilities.argmax(1)])

    def _condition(
        self, variant: Variant, model: LrcnModel, material: LrcnModel | None, videos: Videos
    ) -> np.ndarray | None:
        """Material class numbers that a conditional network is told of the test videos."""
        if material is not None:
            return material.probabilities(videos).argmax(1)
        if variant.condition == "true":
            return labels_of(videos.rows, model.card["condition_classes"], "material")
        return None

    def instrument(self, variant: Variant) -> tuple[dict[str, Any], list[dict[str, Any]]]:
        """Train and test the instrument's network; its row and its predictions (medians)."""
        settings = instrument_settings(self.config)
        folder = self.folder / f"instrument_{variant.name}"
        identity = {
            "network": "instrument",
            "settings": settings.model_dump(mode="json"),
            "code_digest": code_digest("instrument"),
            "frames": self.config.sample.frames,
        }
        found = self._once(
            folder,
            variant,
            identity,
            lambda: train_instrument(
                settings, self._training(variant, folder), self.plan.viewpoints[:1]
            ),
        )
        row = self._row(variant, settings.epochs)
        row |= {
            "failure": found["failure"],
            "stayed_at_chance": _at_chance(found, self.config.instrument.plateau_margin),
        }
        if found["failure"] is not None:
            return row, []
        instrument = load_instrument(folder)
        row |= {key: instrument.card[key] for key in ("train_loss", "chance_loss")}
        videos = self.videos(settings.pixels, None)
        frames = phased(videos.pixels, instrument.card["frames"], None)
        measured = [instrument.measure(video).friction_coefficient for video in frames]
        return row, self._predictions(videos, np.array(measured))

    def _training(self, variant: Variant, folder: Path) -> Run:
        return Run(
            self.dataset,
            SPLIT,
            self.seed,
            folder,
            self.config.sample.frames,
            lambda row: row["video"] in variant.videos,
            self.threads,
        )

    def _once(
        self,
        folder: Path,
        variant: Variant,
        identity: dict[str, Any],
        train: Callable[[], dict[str, Any]],
    ) -> dict[str, Any]:
        """Train, unless the folder says that just this was trained; the losses, or the failure."""
        identity = {
            **identity,
            "seed": self.seed,
            "dataset_digest": self.digest,
            "videos": sorted(variant.videos),
        }
        marker = folder / FINISHED
        noted = _finished(marker)
        if noted.pop("identity", None) == identity:
            return noted
        try:
            card = train()
            found = {key: card[key] for key in ("train_loss", "chance_loss")} | {"failure": None}
        except DivergedError as failure:
            found = {"failure": str(failure)}
        write_json(marker, {**found, "identity": identity}, indent=None, allow_nan=True)
        return found

    def _row(self, variant: Variant, passes: float) -> dict[str, Any]:
        simulations = {name.rsplit("_", 2)[0] for name in variant.videos}
        return {
            "phrase": variant.phrase,
            "training_videos": len(variant.videos),
            "training_simulations": len(simulations),
            "passes": passes,
            "train_loss": None,
            "chance_loss": None,
        }

    def _predictions(self, videos: Videos, predicted: np.ndarray) -> list[dict[str, Any]]:
        return [
            {
                "tested_on": name,
                "video": row["video"],
                "simulation": row["simulation"],
                "true": row["friction"],
                "predicted": float(value),
            }
            for name, ids in self.plan.tests.items()
            for row, value in zip(videos.rows, predicted, strict=True)
            if row["video"] in ids
        ]


def _at_chance(found: dict[str, Any], margin: float | None) -> bool:
    """Whether a training that did not diverge is still within the margin of chance."""
    return found["failure"] is None and (
        found["train_loss"] > (1.0 - (margin or 0.0)) * found["chance_loss"]
    )


def _finished(marker: Path) -> dict[str, Any]:
    """The record of a finished training whose model still exists; else nothing."""
    try:
        noted = json.loads(marker.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    whole = isinstance(noted, dict) and {"identity", "failure"} <= set(noted)
    return (
        noted
        if whole and (noted["failure"] or any((marker.parent / name).is_file() for name in WEIGHTS))
        else {}
    )


def write_answer(
    config: Config,
    dataset: str | os.PathLike,
    question: str,
    seed: int,
    out: str | os.PathLike,
    threads: int = 1,
) -> dict[str, Any]:
    """`answer`, written as JSON with its record; the trainings lie in a folder of that name."""
    started = start_clock()
    out = Path(out)
    found = answer(config, dataset, question, seed, out.with_suffix(""), threads)
    record = provenance_record(
        "ablate",
        inputs=[Path(dataset) / MANIFEST],
        config=config.model_dump(mode="json", include={"ablate", "train", "instrument"}),
        seed=seed,
        started=started,
    )
    write_json(out, found, record)
    return found
