"""One variant of a question with one seed: trained, and tested on held-out simulations."""

import dataclasses
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import provenance_record, start_clock, write_json
from slipstitch.config import Config
from slipstitch.config.train import InstrumentSettings, TrainSettings
from slipstitch.dataset.manifest import MANIFEST, read_manifest
from slipstitch.dataset.videos import read_videos
from slipstitch.design.trainable import view_order
from slipstitch.learning.ablation.questions import QUESTIONS, selected
from slipstitch.learning.instrument.measuring import Instrument, load_instrument
from slipstitch.learning.instrument.training import train_instrument
from slipstitch.learning.lrcn import TRUE, LrcnModel, load_model
from slipstitch.learning.lrcn_training import progressive_schedule, train_network
from slipstitch.learning.trainer import DivergedError, Phase, Run


@dataclass(frozen=True)
class Case:
    """Which variant of which question, with which network and seed."""

    question: str
    network: str
    variant: str
    seed: int


def lrcn_settings(config: Config, overrides: dict[str, Any]) -> TrainSettings:
    """Return the section `train` with overrides; staying at chance is a result, no failure."""
    whole = config.train.model_dump() | config.ablate.train | overrides
    return TrainSettings.model_validate(whole | {"plateau_margin": None})


def phases(settings: TrainSettings, viewpoints: list[str], passes: int, joint: bool) -> list[Phase]:
    """Return epochs by viewpoints; joint and progressive show as many videos.

    One viewpoint: `passes` epochs. V of them: cycles of E = 2 passes / (V + 1) epochs, rounded (and
    even where V is), show E V (V + 1) / 2 times the videos of a viewpoint, as do E (V + 1) / 2
    epochs of all. Both end with the same fine-tuning on the first viewpoint.
    """
    count = len(viewpoints)
    if count == 1:
        return [Phase("one viewpoint", tuple(viewpoints), passes)]
    epochs = max(1, round(2 * passes / (count + 1)))
    epochs += (count % 2 == 0) and (epochs % 2)
    changes = {"epochs_per_cycle": epochs, "flat_epochs": None}
    planned = progressive_schedule(settings.model_copy(update=changes), viewpoints)
    if joint:
        planned[:count] = [Phase("joint", tuple(viewpoints), epochs * (count + 1) // 2)]
    return planned


def run_case(
    config: Config, dataset: str | Path, case: Case, folder: Path, threads: int = 1
) -> dict[str, Any]:
    """Train a variant, its models in a folder, and test it.

    Returns the case, ``dataset_digest``; ``left_out``, why the dataset cannot answer the question;
    the training: ``phrase, training_videos, training_simulations, passes, failure,
    stayed_at_chance``; and ``predictions``, a list of ``tested_on, video, simulation, true,
    predicted``. BadInput if the dataset cannot answer a question that the configuration names.
    """
    rows, digest = read_manifest(dataset)
    result: dict[str, Any] = asdict(case) | {"dataset_digest": digest, "left_out": None}
    try:
        views, videos = selected(case.question, rows, view_order(config), config.ablate, case.seed)
    except BadInput as reason:
        if config.ablate.questions is not None:
            raise
        return result | {"left_out": str(reason), "predictions": []}
    variant = QUESTIONS[case.question].variants[case.variant]
    settings = lrcn_settings(config, variant.train)
    planned = phases(settings, views, config.ablate.passes, variant.joint)
    passes = sum(phase.epochs * len(phase.viewpoints) for phase in planned) / len(views)
    training = videos.training[case.variant]
    is_instrument = case.network == "instrument"
    result |= {
        "phrase": variant.phrase.format(**videos.numbers),
        "training_videos": len(training),
        "training_simulations": len({name.rsplit("_", 2)[0] for name in training}),
        "passes": config.ablate.instrument_passes if is_instrument else passes,
        "failure": None,
        "stayed_at_chance": False,
        "material_stayed_at_chance": False,
        "predictions": [],
    }
    run = Run(
        dataset,
        "by_simulation",
        case.seed,
        folder,
        frames=config.sample.frames,
        uses=lambda row: row["video"] in training,
        threads=threads,
    )
    try:
        if is_instrument:
            model: LrcnModel | Instrument = _instrument(config, run, views)
        else:
            model = _lrcn(settings, run, variant.material, views, planned)
    except DivergedError as failure:
        return result | {"failure": str(failure)}
    margin = (config.instrument if is_instrument else config.train).plateau_margin
    result["stayed_at_chance"] = _at_chance(model, margin)
    if isinstance(model, LrcnModel) and model.material is not None:
        result["material_stayed_at_chance"] = _at_chance(model.material, margin)
    return result | {"predictions": _predictions(model, dataset, videos.tests)}


def _predictions(
    model: LrcnModel | Instrument, dataset: str | Path, tests: dict[str, frozenset[str]]
) -> list[dict[str, Any]]:
    """Predictions for the videos of some test sets."""
    tested = frozenset().union(*tests.values())
    videos = read_videos(dataset, lambda row: row["video"] in tested)
    predictions = model.predict(videos)
    rows = [
        {"video": row["video"], "simulation": row["simulation"], "true": row["friction"]}
        | {"predicted": prediction.friction_coefficient}
        for row, prediction in zip(videos.rows, predictions, strict=True)
    ]
    return [
        {"tested_on": name} | row
        for name, ids in tests.items()
        for row in rows
        if row["video"] in ids
    ]


def _lrcn(
    settings: TrainSettings, run: Run, conditioned_on: str, views: list[str], planned: list[Phase]
) -> LrcnModel:
    """The paper's network as a variant trains it, with its material network if it has one."""

    def train(network: str, name: str, material: Any = None) -> LrcnModel:
        own = dataclasses.replace(run, out=Path(run.out) / name)
        train_network(settings, own, network, views, material_model=material, phases=planned)
        return load_model(own.out)

    if conditioned_on == "none":
        return train("friction_baseline", "friction")
    if conditioned_on == "true":
        return train("friction_conditional", "friction", TRUE)
    material = train("material_baseline", "material")
    friction = train("friction_conditional", "friction", Path(run.out) / "material")
    return dataclasses.replace(friction, material=material)


def _instrument(config: Config, run: Run, views: list[str]) -> Instrument:
    """The instrument trained with the overrides; staying at chance does not fail."""
    own = {"epochs": config.ablate.instrument_passes, "plateau_margin": None}
    whole = config.instrument.model_dump() | config.ablate.instrument | own
    train_instrument(InstrumentSettings.model_validate(whole), run, views[:1])
    return load_instrument(run.out)


def _at_chance(model: LrcnModel | Instrument, margin: float | None) -> bool:
    """Whether a training is still within the margin of chance."""
    return bool(model.card["train_loss"] > (1.0 - (margin or 0.0)) * model.card["chance_loss"])


def write_case(
    config: Config, dataset: str | Path, case: Case, out: str | Path, threads: int = 1
) -> dict[str, Any]:
    """Write what `run_case` returns as JSON; the models lie in a folder of that name."""
    started = start_clock()
    found = run_case(config, dataset, case, Path(out).with_suffix(""), threads)
    record = provenance_record(
        "ablate",
        inputs=[Path(dataset) / MANIFEST],
        config=config.model_dump(mode="json", include={"ablate", "train", "instrument"}),
        seed=case.seed,
        started=started,
    )
    write_json(out, found, record)
    return found
