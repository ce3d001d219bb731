"""The questions: their variants as overrides of the configuration, and which videos train them.

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
from slipstitch.config.train import VARIANTS, AblateSettings
from slipstitch.dataset.videos import takes_part

Row = dict[str, Any]
Videos = frozenset[str]


@dataclass(frozen=True)
class Variant:
    """One way to train."""

    phrase: str  # names it in a sentence; may hold numbers of a `Selection`
    train: dict[str, Any] = field(default_factory=dict)  # overrides of the section ``train``
    # what the friction network is conditioned on
    material: Literal["none", "predicted", "true"] = "none"
    joint: bool = False  # all viewpoints from the first epoch, instead of one more each cycle


@dataclass(frozen=True)
class Selection:
    """Ids of the videos that train each variant, and of each test set; numbers for phrases."""

    training: dict[str, Videos]
    tests: dict[str, Videos]
    numbers: dict[str, int] = field(default_factory=dict)


@dataclass
class Candidates:
    """The videos of a manifest available for training and testing, from some viewpoints."""

    training: list[Row]
    held_out: list[Row]

    def __post_init__(self):
        self.textures = sorted({row["texture_id"] for row in self.training})
        # by material and friction, one row of each training simulation
        found: dict[tuple[str, str], dict[str, Row]] = defaultdict(dict)
        for row in self.training:
            found[row["material_id"], row["friction_id"]][row["simulation"]] = row
        self.pairs = {pair: [of[name] for name in sorted(of)] for pair, of in sorted(found.items())}
        self.simulations = [row for of_pair in self.pairs.values() for row in of_pair]

    def ids(self, wanted: set[tuple[str, str]]) -> Videos:
        """Return the training videos of some (simulation, texture), from all viewpoints."""
        seen = (row for row in self.training if (row["simulation"], row["texture_id"]) in wanted)
        return frozenset(row["video"] for row in seen)

    def tests(self, counts: Callable[[Row], bool] = lambda row: True) -> Videos:
        """Return the held-out videos that count."""
        return frozenset(row["video"] for row in self.held_out if counts(row))

    def dealt(self, simulations: list[Row], generator: np.random.Generator) -> dict[str, str]:
        """Return a texture for each simulation, such that none gives a coefficient away."""
        by_friction: dict[str, set[str]] = defaultdict(set)
        for row in simulations:
            by_friction[row["friction_id"]].add(row["simulation"])
        textures, result = self.textures, {}
        for _, names in sorted(by_friction.items()):
            first = int(generator.integers(len(textures)))
            for place, name in enumerate(generator.permutation(sorted(names)), first):
                result[str(name)] = textures[place % len(textures)]
        return result


def _diversity(videos: Candidates, generator: np.random.Generator) -> Selection:
    """Replicates against textures at an equal number of videos.

    Both variants see every texture equally often: else the test videos would be new to one only.
    """
    fewest = min(map(len, videos.pairs.values()))
    count = min(len(videos.textures), fewest)
    if count < 2:
        raise BadInput(
            "diversity: 2 training replicates of every pair and 2 training textures are "
            f"required, not {fewest} and {len(videos.textures)}"
        )
    textures = videos.textures[:count]
    drawn = {
        pair: [rows[k]["simulation"] for k in generator.permutation(len(rows))[:count]]
        for pair, rows in videos.pairs.items()
    }
    many = {
        (simulation, texture)
        for of_pair in drawn.values()
        for simulation, texture in zip(of_pair, generator.permutation(textures), strict=True)
    }
    first_only = {(of_pair[0], texture) for of_pair in drawn.values() for texture in textures}
    return Selection(
        {"replicates": videos.ids(many), "textures": videos.ids(first_only)},
        {"held-out": videos.tests(lambda row: row["texture_id"] in textures)},
        {"count": count},
    )


def _floors(videos: Candidates, generator: np.random.Generator) -> Selection:
    """Matte floors only, against half of them exchanged for mirroring ones.

    An exchanged simulation makes room for one of the same friction coefficient, and material if
    there is one. Coefficients with fewer than two matte or no reflective ones are left out, in
    tests too.
    """
    matte: dict[str, list[Row]] = defaultdict(list)
    mirrors: dict[str, list[Row]] = defaultdict(list)
    for row in videos.simulations:
        (mirrors if _mirrors(row) else matte)[row["friction_id"]].append(row)
    frictions = [f for f in sorted(matte) if len(matte[f]) >= 2 and mirrors[f]]
    held = {_mirrors(row) for row in videos.held_out if row["friction_id"] in frictions}
    if len(frictions) < 2 or held != {True, False}:
        raise BadInput(
            "floors: 2 friction coefficients with 2 matte training simulations and 1 reflective "
            "one each, and held-out ones on both kinds of floor, are required (render.floors); "
            f"found: {len(frictions)} such coefficients, {sum(map(len, matte.values()))} matte and "
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
    dealt = videos.dealt(only + mixed, generator)

    def tests(mirroring: bool) -> Videos:
        return videos.tests(
            lambda row: row["friction_id"] in frictions and _mirrors(row) == mirroring
        )

    return Selection(
        {
            name: videos.ids({(row["simulation"], dealt[row["simulation"]]) for row in rows})
            for name, rows in (("matte", only), ("mixed", mixed))
        },
        {"matte floors": tests(False), "mirroring floors": tests(True)},
        {"exchanged": sum(map(_mirrors, mixed)), "all": len(mixed)},
    )


def _mirrors(row: Row) -> bool:
    return row["floor_reflectance"] > 0


@dataclass(frozen=True)
class Question:
    """What is asked, and how it is answered."""

    asks: str
    variants: dict[str, Variant]  # the others are compared with the first
    # which videos train each variant; by default all training simulations train every one, each in
    # one texture
    select: Callable[[Candidates, np.random.Generator], Selection] | None = None
    needs: int = 1  # viewpoints: that many at least, and all; 1: the calibrated one alone


QUESTIONS = {
    "diversity": Question(
        "Which additional video helps more: a new replicate, or a new texture of an old one?",
        {
            "replicates": Variant("{count} replicates in one texture each"),
            "textures": Variant("one replicate in {count} textures"),
        },
        _diversity,
    ),
    "conditioning": Question(
        "Does material input help the friction network?",
        {
            "none": Variant("without material input"),
            "predicted": Variant("with the predicted material", material="predicted"),
            "true": Variant("with the true material", material="true"),
        },
    ),
    "schedule": Question(
        "Does it help to add viewpoints one after another?",
        {
            "progressive": Variant("adding a viewpoint each cycle"),
            "joint": Variant("training on all viewpoints from the first epoch", joint=True),
        },
        needs=2,
    ),
    "initialisation": Question(
        "How should the weights be initialised?",
        {
            "he": Variant("He's initialisation", {"initialisation": "he"}),
            "glorot": Variant("Glorot's initialisation", {"initialisation": "glorot"}),
            "pytorch": Variant("PyTorch's own initialisation", {"initialisation": "pytorch"}),
        },
    ),
    "floors": Question(
        "Are reflective floors needed in training?",
        {
            "matte": Variant("training on matte floors only"),
            "mixed": Variant("training with {exchanged} reflective floors out of {all}"),
        },
        _floors,
    ),
}


def selected(
    name: str, rows: Sequence[Row], viewpoints: Sequence[str], settings: AblateSettings, seed: int
) -> tuple[list[str], Selection]:
    """Return the viewpoints of a question, and its videos.

    Of the manifest's rows and the training viewpoints, the calibrated one first; the seed draws
    which videos train. BadInput, with what is needed, if the dataset cannot answer the question.
    """
    question = QUESTIONS[name]
    if not set(VARIANTS[name]) & set(settings.networks):
        raise BadInput(f"{name}: requires the network lrcn, which is not in ablate.networks")
    views = list(viewpoints) if question.needs > 1 else list(viewpoints[:1])
    usable = [row for row in rows if takes_part(row) and row["viewpoint"] in views]
    videos = Candidates(
        [row for row in usable if row["split_by_simulation"] == "train"],
        [row for row in usable if row["split_by_simulation"] != "train"],
    )
    for part, kind in ((videos.training, "training"), (videos.held_out, "held-out")):
        if not part:
            raise BadInput(f"{name}: a {kind} simulation seen from {views[0]} is required")
    materials = {row["material_id"] for row in videos.training}
    if name == "conditioning" and len(materials) < 2:
        raise BadInput(f"conditioning: 2 training materials are required, not {len(materials)}")
    if len(views) < question.needs:
        raise BadInput(f"{name}: 2 training viewpoints are required, not {len(views)}")
    generator = np.random.default_rng([seed, 5])
    if question.select is not None:
        return views, question.select(videos, generator)
    chosen = videos.ids({*videos.dealt(videos.simulations, generator).items()})
    tests = {"held-out": videos.tests()}
    if len(views) > 1:
        calibrated = videos.tests(lambda row: row["viewpoint"] == views[0])
        tests = {"calibrated viewpoint": calibrated, "all viewpoints": videos.tests()}
    return views, Selection(dict.fromkeys(question.variants, chosen), tests)
