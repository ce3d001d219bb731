"""The trained models that an evaluation is of: finding, checking and loading them."""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from slipstitch.base.errors import BadInput
from slipstitch.config import Config
from slipstitch.config.train import NETWORKS, TRAINED_ON
from slipstitch.design.trainable import trainings
from slipstitch.learning.evaluation.scores import (
    AVERAGE,
    CALIBRATED,
    ENSEMBLE,
    MATERIAL,
    SHIPPED,
    TRAINING,
)
from slipstitch.learning.instrument.measuring import WEIGHTS as INSTRUMENT_WEIGHTS
from slipstitch.learning.instrument.measuring import Instrument, load_instrument
from slipstitch.learning.lrcn import ALL_VIEWS, CARD, WEIGHTS, LrcnModel, load_model

#: Kinds of models, as an update of an evaluation tells them apart.
NETWORKS_KIND = "networks"
#: Split, network, seed; None: an average.
Key = tuple[str, str, int | None]


@dataclass(frozen=True)
class Trained:
    """Which models count."""

    config: Config  # splits and seeds that it has not, left by an earlier one, do not count
    # folder ``{split}/{network}/seed{seed}/`` that the train stage wrote
    networks: str | Path | None = None
    # folder ``{split}/seed{seed}/``, ``{split}/ensemble/`` that the instrument stage wrote
    instruments: str | Path | None = None
    # folder of the instrument that comes with Slipstitch, to which all test videos are new
    shipped: str | Path | None = None

    @property
    def splits(self) -> Sequence[str]:
        """Splits that count."""
        return self.config.train.splits

    def files(self) -> dict[str, list[Path]]:
        """Return the files that the predictions of every kind of model depend on."""
        found: dict[str, list[Path]] = {NETWORKS_KIND: [], TRAINING: [], AVERAGE: []}
        if self.shipped is not None:
            found[SHIPPED] = [Path(self.shipped, INSTRUMENT_WEIGHTS)]
        for split in self.splits if self.networks is not None else ():
            found[NETWORKS_KIND] += [
                file
                for network in NETWORKS
                for place in sorted(Path(self.networks, split, network).glob("seed*"))
                for folder in (place, place / ALL_VIEWS)
                for file in (folder / WEIGHTS, folder / CARD)
                if (folder / WEIGHTS).is_file() and self._has(split, network, place.name)
            ]
        for split in self.splits if self.instruments is not None else ():
            folder = Path(self.instruments, split)
            found[TRAINING] += [
                path
                for path in sorted(folder.glob(f"seed*/{INSTRUMENT_WEIGHTS}"))
                if self._has(split, TRAINING, path.parent.name)
            ]
            if self._has(split, AVERAGE, ENSEMBLE):
                found[AVERAGE] += sorted(folder.glob(f"{ENSEMBLE}/{INSTRUMENT_WEIGHTS}"))
        return found

    def elsewhere(self, scored: Mapping[str, str]) -> dict[Key, dict[str, str]]:
        """Return the models that were scored, that count, and whose weights are not here.

        As when the others were trained on another machine: by split, network and seed, path ->
        SHA-256 as in `scored`.
        """
        here = {_key_of(path) for paths in self.files().values() for path in paths}
        found: dict[Key, dict[str, str]] = {}
        for path, digest in scored.items():
            key = _key_of(Path(path))
            if key is not None and self.counts(*key) and key not in here:
                found.setdefault(key, {})[path] = digest
        return found

    def counts(self, split: str, network: str, seed: int | None) -> bool:
        """Whether the configuration has a network, a training of the instrument or an average."""
        name = ENSEMBLE if seed is None else f"seed{seed}"
        return split in self.splits and self._has(split, network, name)

    def _has(self, split: str, network: str, name: str) -> bool:
        """The same of one of its splits, by the name of the folder."""
        seeds = self.config.instrument.seeds
        if network in NETWORKS:
            of_split = trainings(self.config.train, split)
            seeds = [seed for other, seed in of_split if other == network]
        if name == ENSEMBLE:
            return len(seeds) > 1  # of a single seed no average is configured
        return name in {f"seed{seed}" for seed in seeds}

    def load(self, without: frozenset[str] = frozenset()) -> dict[Key, LrcnModel | Instrument]:
        """Return the models but those of some kinds; BadInput if one is not what its place says."""
        files = self.files()
        models: dict[Key, LrcnModel | Instrument] = {}
        if self.networks is not None and NETWORKS_KIND not in without:
            models |= _networks([path for path in files[NETWORKS_KIND] if path.name == WEIGHTS])
            if not models:
                raise BadInput(
                    f"{self.networks}: no models found "
                    f"({{split}}/{{network}}/seed{{seed}}/{WEIGHTS})"
                )
        instruments = _instruments(files[TRAINING], files[AVERAGE])
        models |= {key: one for key, one in instruments.items() if key[1] not in without}
        if self.shipped is not None and SHIPPED not in without:
            instrument = load_instrument(self.shipped)
            models |= {(split, SHIPPED, None): instrument for split in self.splits}
        return models


def place_of(row: Mapping[str, Any]) -> Key:
    """Return split, network and seed that a prediction is of, fine-tuned or not."""
    return row["trained_on"], row["network"].removesuffix(CALIBRATED), row["seed"]


def _key_of(path: Path) -> Key | None:
    """The model that a file is of, by its place; None of a file that is of none."""
    folder = path.parent.parent if path.parent.name == ALL_VIEWS else path.parent
    split, network, name = ("", "", "", *folder.parts)[-3:]
    if path.name == INSTRUMENT_WEIGHTS:
        split, network = network, AVERAGE if name == ENSEMBLE else TRAINING
    elif network not in NETWORKS:
        return None
    if split not in TRAINED_ON:  # the shipped one, which is everywhere
        return None
    seed = name.removeprefix("seed")
    if name != ENSEMBLE and not seed.isdecimal():
        return None
    return split, network, None if name == ENSEMBLE else int(seed)


def _networks(paths: list[Path]) -> dict[Key, LrcnModel]:
    """The paper's networks by split, name and seed; conditional ones with their material networks.

    Where a network before fine-tuning is kept, the fine-tuned one is named `CALIBRATED`.
    """
    found: dict[Key, LrcnModel] = {}
    for path in paths:
        model = load_model(path.parent)
        card = model.card
        kept = path.parent.name == ALL_VIEWS
        place = path.parents[1] if kept else path.parent
        if (card["split"], card["network"], f"seed{card['seed']}") != place.parts[-3:]:
            raise BadInput(
                f"{path}: holds {card['network']} {card['split']} seed {card['seed']}: "
                "does not match its folder"
            )
        name = card["network"]
        if not kept and (path.parent / ALL_VIEWS / WEIGHTS).is_file():
            name, model = name + CALIBRATED, dataclasses.replace(model, calibrated_view_alone=True)
        found[card["split"], name, card["seed"]] = model
    for (split, network, seed), model in found.items():
        condition = model.card.get("condition_sha256")
        if condition is None:
            continue
        named = f"friction_conditional {split} seed {seed}"
        tellers = [found.get((split, MATERIAL + end, seed)) for end in ("", CALIBRATED)]
        if not any(tellers):
            raise BadInput(f"{named} has no matching material_baseline")
        teller = [one for one in tellers if one and one.card["weights_sha256"] == condition]
        if not teller:
            raise BadInput(f"{named} was trained with a different material_baseline")
        teller[0].check_is_material_network_of(split, seed, model.card["dataset_digest"])
        found[split, network, seed] = dataclasses.replace(model, material=teller[0])
    return found


def _instruments(single: list[Path], averages: list[Path]) -> dict[Key, Instrument]:
    """The instruments, and the averages of those beside them."""
    found: dict[Key, Instrument] = {}
    for path in [*single, *averages]:
        instrument = load_instrument(path)
        card = instrument.card
        averaged = len(instrument.networks) > 1
        name = ENSEMBLE if averaged else f"seed{card.get('seed')}"
        if (card.get("split"), name) != path.parts[-3:-1]:
            held = "an average" if averaged else f"seed {card.get('seed')}"
            raise BadInput(f"{path}: holds {card.get('split')} {held}: does not match its folder")
        if not averaged:
            found[card["split"], TRAINING, card["seed"]] = instrument
            continue
        beside = {
            one.card["weights_sha256"]
            for (split, _, seed), one in found.items()
            if split == card["split"] and seed is not None
        }
        if set(card["members_sha256"]) != beside:
            raise BadInput(
                f"{path}: is the average of other instruments than those beside it; combine "
                "these with slipstitch instrument --members"
            )
        found[card["split"], AVERAGE, None] = instrument
    return found
