"""Several trainings of the instrument as one, with error bars of their own.

Its networks differ only in their seed. What they say is averaged (`measuring.Instrument`), and the
error bars and the alarm are calibrated for the average, on the videos that calibrated each of them.
"""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import torch

from slipstitch.config.train import split_of
from slipstitch.errors import BadInput
from slipstitch.instrument.alarm import SCORES, Alarm
from slipstitch.instrument.augmentation import phased
from slipstitch.instrument.error_bars import with_error_bars
from slipstitch.instrument.measuring import (
    CARD,
    NETWORKS_MAX,
    WEIGHTS,
    Answers,
    Instrument,
    halved,
    load_instrument,
    restored,
    save_instrument,
)
from slipstitch.instrument.network import InstrumentNetwork
from slipstitch.instrument.poses import poses_of
from slipstitch.provenance import (
    file_digest,
    provenance_record,
    start_clock,
    write_parquet,
    write_sidecar,
)
from slipstitch.sample.manifest import MANIFEST
from slipstitch.sample.videos import Videos, read_videos, takes_part
from slipstitch.train.torch_setup import set_up_torch

CALIBRATION = "calibration.parquet"
# What is the same for all members; the rest of a card is of one training.
_COMMON = (
    "materials",
    "frames",
    "pixels",
    "viewpoints",
    "pose_range",
    "split",
    "frictions",
    "interpolated_videos",
    "calibration_simulations",
    "bfloat16",
    "settings",
    "dataset_digest",
    "training_videos",
    "training_simulations",
    "epochs",
    "chance_loss",
    "use",
)
_SCHEMA = pa.schema(
    [
        ("video", pa.string()),
        ("simulation", pa.string()),
        ("material", pa.string()),
        ("friction", pa.float64()),
        ("probabilities", pa.list_(pa.float32())),  # on the grid of mu, before any calibration
        ("material_logits", pa.list_(pa.float32())),
        *((name, pa.float64()) for name in SCORES),  # of the alarm, before they are scaled
    ]
)


def combine_instruments(
    members: Sequence[str | os.PathLike],
    dataset: str | os.PathLike,
    split: str,
    out_dir: str | os.PathLike,
    threads: int = 1,
) -> dict[str, Any]:
    """Average trained instruments, calibrate the error bars and the alarm of the average, write it.

    Parameters
    ----------
    members : sequence of path
        Folders of instruments that differ in their seed alone.
    dataset : path
        Folder that the sample stage wrote, on which they were trained.
    split : {"by_video", "by_simulation", "by_video_reflective"}
        On which they were trained; its validation videos calibrate.
    out_dir : path
        Gets ``instrument.safetensors``, ``instrument.json`` and ``calibration.parquet``, what the
        average says of the videos that calibrate it, from which any other error bar can be fitted.
        Members that no video calibrated give an average without error bars.
    threads : int

    Returns
    -------
    dict
        The card: as the members' cards where they agree, and ``networks``, their number, and
        ``seeds``, ``members_sha256``, ``train_loss``, one a member.

    Raises
    ------
    BadInput
        If the members are fewer than two or do not belong together, or the dataset is another one.
    """
    started = start_clock()
    set_up_torch(threads)
    weights = [Path(member) / WEIGHTS for member in members]
    if not 2 <= len(members) <= NETWORKS_MAX:
        raise BadInput(f"{len(members)} instrument(s) given; 2 to {NETWORKS_MAX} are combined")
    trained = [load_instrument(member) for member in members]
    _check_alike(trained, members, split)
    networks = tuple(_rounded(instrument) for instrument in trained)
    card: dict[str, Any] = {name: trained[0].card.get(name) for name in _COMMON}
    card |= {
        "networks": len(trained),
        "seeds": [one.card["seed"] for one in trained],
        "members_sha256": [file_digest(path) for path in weights],
        "train_loss": [one.card["train_loss"] for one in trained],
        "parameters": sum(one.card["parameters"] for one in trained),
        "multiply_accumulates_per_frame": sum(
            one.card["multiply_accumulates_per_frame"] for one in trained
        ),
    }
    combined = Instrument(networks, card, None)
    rows: list[dict[str, Any]] = []
    alarms = [one.error_bars.alarm for one in trained if one.error_bars]
    if alarms:
        videos = _held_out(trained[0], dataset, split)
        frames = phased(videos.pixels, card["frames"], None)
        answers = combined.answers(frames, np.random.default_rng(0), poses_of(videos.rows))
        combined = with_error_bars(combined, _statistics(alarms), frames, answers, videos.rows)
        rows = _calibration_rows(combined, videos, frames, answers)
    out = Path(out_dir)
    written = save_instrument(combined, out)
    record = provenance_record(
        "instrument",
        # The manifest has the digest of every video's pixels, with which they are compared.
        inputs=[*weights, Path(dataset) / MANIFEST],
        config={"instrument": combined.settings},
        started=started,
    )
    record["threads"] = threads
    for name in (WEIGHTS, CARD):
        write_sidecar(out / name, record)
    write_parquet(pa.Table.from_pylist(rows, schema=_SCHEMA), out / CALIBRATION, {}, record)
    return written


def _check_alike(
    trained: Sequence[Instrument], members: Sequence[str | os.PathLike], split: str
) -> None:
    """BadInput unless all are single networks, alike but for their seeds."""
    first = trained[0]
    seeds: dict[int, str | os.PathLike] = {}
    for instrument, member in zip(trained, members, strict=True):
        card = instrument.card
        if len(instrument.networks) > 1:
            raise BadInput(f"{member}: is itself combined of {len(instrument.networks)} trainings")
        if card.get("split") != split:
            raise BadInput(f"{member}: was trained on the split {card.get('split')}, not {split}")
        if card["seed"] in seeds:
            raise BadInput(f"{member}: has seed {card['seed']}, as {seeds[card['seed']]} has")
        seeds[card["seed"]] = member
        for name in _COMMON:
            if card.get(name) != first.card.get(name):
                raise BadInput(f"{member}: differs from {members[0]} in its {name}")


def _held_out(instrument: Instrument, dataset: str | os.PathLike, split: str) -> Videos:
    """The videos that calibrate; BadInput if the dataset is not the one of the training."""
    column, views = f"split_{split_of(split)}", instrument.card["viewpoints"]
    videos = read_videos(
        dataset,
        lambda row: (
            takes_part(row, split) and row[column] == "validation" and row["viewpoint"] in views
        ),
        instrument.settings.pixels,
    )
    if videos.digest != instrument.card["dataset_digest"]:
        raise BadInput(f"{dataset}: not the dataset on which the instruments were trained")
    return videos


def _rounded(instrument: Instrument) -> InstrumentNetwork:
    """The network of an instrument, rounded as it will be stored."""
    (network,) = instrument.networks
    state = {name: restored(halved(value)) for name, value in network.state_dict().items()}
    network.load_state_dict(state)
    return network


def _statistics(alarms: Sequence[Alarm]) -> tuple[np.ndarray, ...]:
    """Those of the training videos for an alarm over all networks, rounded as they are stored."""
    # The first three are of the videos alone, and so the same for all.
    parts = (
        alarms[0].mean,
        alarms[0].components,
        alarms[0].variances,
        np.concatenate([alarm.embedding_mean for alarm in alarms]),
        np.concatenate([alarm.embedding_whitening for alarm in alarms]),
    )
    return tuple(restored(halved(torch.from_numpy(part))).numpy() for part in parts)


def _calibration_rows(
    combined: Instrument, videos: Videos, frames: np.ndarray, answers: Answers
) -> list[dict[str, Any]]:
    """A row of ``calibration.parquet`` a video."""
    assert combined.error_bars is not None
    strange = combined.error_bars.alarm.raw(frames, answers.embedding, answers.order)
    return [
        {name: row[name] for name in ("video", "simulation", "material", "friction")}
        | {"probabilities": shares.tolist(), "material_logits": logits.tolist()}
        | dict(zip(SCORES, map(float, scores), strict=True))
        for row, shares, logits, scores in zip(
            videos.rows, answers.probabilities, answers.material_logits, strange, strict=True
        )
    ]
