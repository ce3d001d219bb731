"""The questions, their variants, and their training and test videos.

Every variant of a question is trained with as many passes of videos as the others, on the split by
simulation, and tested on the same videos of held-out simulations. Those for validation count among
these: nothing is selected on them here.
"""

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from slipstitch.base.errors import BadInput
from slipstitch.config.ablate import AblateSettings
from slipstitch.dataset.videos import takes_part

Row = dict[str, Any]


@dataclass(frozen=True)
class Variant:
    """One way to train.

    Attributes
    ----------
    name : str
        Names its folder and its row.
    phrase : str
        Names it in a sentence.
    videos : frozenset of str
        Training videos.
    changes : dict
        Keys of the section ``train`` that are different.
    condition : {"none", "predicted", "true"}
        What the friction network is told of the material.
    joint : bool
        All viewpoints from the first epoch, instead of one more each cycle.
    """

    name: str
    phrase: str
    videos: frozenset[str]
    changes: dict[str, Any] = field(default_factory=dict)
    condition: Literal["none", "predicted", "true"] = "none"
    joint: bool = False


@dataclass(frozen=True)
class Plan:
    """A question as this dataset can answer it.

    Attributes
    ----------
    asks : str
    viewpoints : list of str
        That train and test; the first is the calibrated one.
    variants : list of Variant
        The others are compared with the first.
    tests : dict
        Name of a test set -> ids of its videos, none of a training simulation.
    networks : list of str
        Of lrcn and instrument.
    """

    asks: str
    viewpoints: list[str]
    variants: list[Variant]
    tests: dict[str, frozenset[str]]
    networks: Sequence[str]


@dataclass(frozen=True)
class Candidates:
    """The videos of a manifest available for training and testing, from some viewpoints."""

    training: list[Row]
    held_out: list[Row]

    @property
    def textures(self) -> list[str]:
        """Training textures, by id."""
        return sorted({row["texture_id"] for row in self.training})

    def simulations(self) -> dict[tuple[str, str], list[Row]]:
        """(material, friction) -> one row of each training simulation."""
        pairs: dict[tuple[str, str], dict[str, Row]] = defaultdict(dict)
        for row in self.training:
            pairs[row["material_id"], row["friction_id"]][row["simulation"]] = row
        return {pair: [of[name] for name in sorted(of)] for pair, of in sorted(pairs.items())}


def plan(
    question: str,
    rows: Sequence[Row],
    viewpoints: Sequence[str],
    settings: AblateSettings,
    seed: int,
) -> Plan:
    """The plan for answering a question with a dataset.

    Parameters
    ----------
    question : str
        One of `QUESTIONS`.
    rows : sequence of dict
        The manifest.
    viewpoints : sequence of str
        Training viewpoints, the calibrated one first.
    settings : AblateSettings
    seed : int
        Draws which videos train, where there is a choice: so the spread over seeds holds it too.

    Raises
    ------
    BadInput
        If the dataset cannot answer it: what is needed.
    """
    views = list(viewpoints) if question == "schedule" else list(viewpoints[:1])
    usable = [row for row in rows if takes_part(row) and row["viewpoint"] in views]
    videos = Candidates(
        training=[row for row in usable if row["split_by_simulation"] == "train"],
        held_out=[row for row in usable if row["split_by_simulation"] != "train"],
    )
    for part, name in ((videos.training, "training"), (videos.held_out, "held-out")):
        if not part:
            raise BadInput(f"{question}: a {name} simulation seen from {views[0]} is required")
    generator = np.random.default_rng([seed, 5])
    return _PLANS[question](videos, views, settings, generator)


def diversity(videos: Candidates, views: list[str], settings: AblateSettings, generator) -> Plan:
    """Replicates against textures at an equal number of videos.

    Both variants see every texture equally often: the replicates' textures are dealt among them.
    With one texture for all, the test videos' other textures would be new to one variant only.
    """
    pairs = videos.simulations()
    count = min(len(videos.textures), min(map(len, pairs.values())))
    if count < 2:
        raise BadInput(
            "diversity: 2 training replicates of every pair and 2 training textures are "
            f"required, not {min(map(len, pairs.values()))} and {len(videos.textures)}"
        )
    textures = videos.textures[:count]
    drawn = {
        pair: [rows[k]["simulation"] for k in generator.permutation(len(rows))[:count]]
        for pair, rows in pairs.items()
    }
    many = {
        (simulation, texture)
        for of_pair in drawn.values()
        for simulation, texture in zip(of_pair, generator.permutation(textures), strict=True)
    }
    first_only = {(of_pair[0], texture) for of_pair in drawn.values() for texture in textures}
    return Plan(
        asks="Which additional video helps more: a new replicate, or a new texture of an old one?",
        viewpoints=views,
        variants=[
            Variant(
                "replicates", f"{count} replicates in one texture each", _ids(videos.training, many)
            ),
            Variant(
                "textures", f"one replicate in {count} textures", _ids(videos.training, first_only)
            ),
        ],
        tests={"held-out": _tests(videos, lambda row: row["texture_id"] in textures)},
        networks=settings.networks,
    )


def conditioning(videos: Candidates, views: list[str], settings: AblateSettings, generator) -> Plan:
    """Nothing, the predicted or the true material told to the friction network."""
    materials = {row["material_id"] for row in videos.training}
    if len(materials) < 2:
        raise BadInput(f"conditioning: 2 training materials are required, not {len(materials)}")
    chosen = _dealt(videos, settings, generator)
    phrases = {
        "none": "without material input",
        "predicted": "with the predicted material",
        "true": "with the true material",
    }
    return Plan(
        asks="Does material input help the friction network?",
        viewpoints=views,
        variants=[
            Variant(name, phrase, chosen, condition=name) for name, phrase in phrases.items()
        ],
        tests={"held-out": _tests(videos)},
        networks=_lrcn("conditioning", settings),
    )


def schedule(videos: Candidates, views: list[str], settings: AblateSettings, generator) -> Plan:
    """One viewpoint more each cycle, against all from the first epoch."""
    if len(views) < 2:
        raise BadInput(f"schedule: 2 training viewpoints are required, not {len(views)}")
    chosen = _dealt(videos, settings, generator)
    return Plan(
        asks="Does it help to add viewpoints one after another?",
        viewpoints=views,
        variants=[
            Variant("progressive", "adding a viewpoint each cycle", chosen),
            Variant("joint", "training on all viewpoints from the first epoch", chosen, joint=True),
        ],
        tests={
            "calibrated viewpoint": _tests(videos, lambda row: row["viewpoint"] == views[0]),
            "all viewpoints": _tests(videos),
        },
        networks=_lrcn("schedule", settings),
    )


def initialisation(
    videos: Candidates, views: list[str], settings: AblateSettings, generator
) -> Plan:
    """Initialisation of the weights."""
    chosen = _dealt(videos, settings, generator)
    phrases = {
        "he": "He's initialisation",
        "glorot": "Glorot's initialisation",
        "pytorch": "PyTorch's own initialisation",
    }
    return Plan(
        asks="How should the weights be initialised?",
        viewpoints=views,
        variants=[
            Variant(name, phrase, chosen, changes={"initialisation": name})
            for name, phrase in phrases.items()
        ],
        tests={"held-out": _tests(videos)},
        networks=_lrcn("initialisation", settings),
    )


def floors(videos: Candidates, views: list[str], settings: AblateSettings, generator) -> Plan:
    """Matte floors only, against half of them exchanged for mirroring ones.

    Each exchanged simulation makes room for one with the same friction coefficient, and the same
    material where there is one, so that both variants have as many of every coefficient.
    Coefficients with fewer than two matte or no reflective training simulations are left out, in
    the tests too.
    """
    matte: dict[str, list[Row]] = defaultdict(list)
    mirrors: dict[str, list[Row]] = defaultdict(list)
    for of_pair in videos.simulations().values():
        for row in of_pair:
            (mirrors if _mirrors(row) else matte)[row["friction_id"]].append(row)
    frictions = [f for f in sorted(matte) if len(matte[f]) >= 2 and mirrors[f]]
    held = {_mirrors(row) for row in videos.held_out if row["friction_id"] in frictions}
    if len(frictions) < 2 or held != {True, False}:
        raise BadInput(
            "floors: 2 friction coefficients with 2 matte training simulations and 1 reflective "
            "one each, and held-out ones on both kinds of floor, are required (render.floors); "
            "found: "
            f"{len(frictions)} such coefficients, {sum(map(len, matte.values()))} matte and "
            f"{sum(map(len, mirrors.values()))} reflective training simulations"
        )
    only, mixed = [], []
    for friction in frictions:
        kept = list(matte[friction])
        only += kept
        count = min(len(kept) // 2, len(mirrors[friction]))
        for k in generator.permutation(len(mirrors[friction]))[:count]:
            new = mirrors[friction][k]
            same = [row for row in kept if row["material_id"] == new["material_id"]]
            kept.remove((same or kept)[0])
            mixed.append(new)
        mixed += kept
    dealt = _deal(only + mixed, videos.textures, settings, generator)
    exchanged = sum(map(_mirrors, mixed))

    def told(row: Row, mirroring: bool) -> bool:
        return row["friction_id"] in frictions and _mirrors(row) == mirroring

    return Plan(
        asks="Are reflective floors needed in training?",
        viewpoints=views,
        variants=[
            Variant("matte", "training on matte floors only", _ids_of(videos, only, dealt)),
            Variant(
                "mixed",
                f"training with {exchanged} reflective floors out of {len(mixed)}",
                _ids_of(videos, mixed, dealt),
            ),
        ],
        tests={
            "matte floors": _tests(videos, lambda row: told(row, False)),
            "mirroring floors": _tests(videos, lambda row: told(row, True)),
        },
        networks=settings.networks,
    )


_PLANS: dict[str, Callable[..., Plan]] = {
    "diversity": diversity,
    "conditioning": conditioning,
    "schedule": schedule,
    "initialisation": initialisation,
    "floors": floors,
}


def _mirrors(row: Row) -> bool:
    return row["floor_reflectance"] > 0


def _lrcn(question: str, settings: AblateSettings) -> list[str]:
    """The one network that has what is asked after; BadInput if it is not to be trained."""
    if "lrcn" not in settings.networks:
        raise BadInput(f"{question}: requires the network lrcn, which is not in ablate.networks")
    return ["lrcn"]


def _dealt(videos: Candidates, settings: AblateSettings, generator) -> frozenset[str]:
    """All training simulations, each in so many textures as the settings say."""
    simulations = [row for of_pair in videos.simulations().values() for row in of_pair]
    return _ids_of(videos, simulations, _deal(simulations, videos.textures, settings, generator))


def _deal(
    simulations: list[Row], textures: list[str], settings: AblateSettings, generator
) -> dict[str, list[str]]:
    """Simulation -> its textures: among those of a friction coefficient, each equally often.

    So no texture gives a coefficient away.
    """
    count = min(settings.textures_per_simulation or len(textures), len(textures))
    by_friction: dict[str, list[str]] = defaultdict(list)
    for row in simulations:
        if row["simulation"] not in by_friction[row["friction_id"]]:
            by_friction[row["friction_id"]].append(row["simulation"])
    dealt = {}
    for _, names in sorted(by_friction.items()):
        first = int(generator.integers(len(textures)))
        for place, name in enumerate(generator.permutation(sorted(names))):
            start = first + place * count
            dealt[str(name)] = [textures[(start + k) % len(textures)] for k in range(count)]
    return dealt


def _ids_of(
    videos: Candidates, simulations: list[Row], dealt: dict[str, list[str]]
) -> frozenset[str]:
    wanted = {
        (row["simulation"], texture) for row in simulations for texture in dealt[row["simulation"]]
    }
    return _ids(videos.training, wanted)


def _ids(rows: list[Row], wanted: set[tuple[str, str]]) -> frozenset[str]:
    """Ids of the videos of some (simulation, texture), from all viewpoints."""
    return frozenset(
        row["video"] for row in rows if (row["simulation"], row["texture_id"]) in wanted
    )


def _tests(videos: Candidates, counts: Callable[[Row], bool] = lambda row: True) -> frozenset[str]:
    return frozenset(row["video"] for row in videos.held_out if counts(row))
