"""Several trainings of the instrument as one, with error bars of their own.

Its networks differ only in their seed. What they say is averaged (`measuring.Instrument`), and the
error bars and the alarm are calibrated for the average, on the videos that calibrated each of them.
Its conformal scale may allow for its predictions on other benches too.
"""

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import torch

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import (
    file_digest,
    provenance_record,
    read_parquet,
    read_provenance,
    start_clock,
    write_parquet,
    write_sidecar,
)
from slipstitch.config.train import split_of
from slipstitch.dataset.manifest import MANIFEST
from slipstitch.dataset.videos import Videos, read_videos, takes_part
from slipstitch.learning.instrument.alarm import Alarm
from slipstitch.learning.instrument.calibration import (
    ANSWERS,
    ANSWERS_SCHEMA,
    READINGS,
    READINGS_SCHEMA,
    Readings,
    answers_on,
    groups_of,
    kept_readings,
    pooled_scales,
    read_readings,
    readings_on,
    sources_of,
    with_error_bars,
)
from slipstitch.learning.instrument.distribution import grouped_quantile
from slipstitch.learning.instrument.measuring import (
    CARD,
    COVERAGE,
    NETWORKS_MAX,
    WEIGHTS,
    Instrument,
    check_fits,
    halved,
    load_instrument,
    restored,
    save_instrument,
)
from slipstitch.learning.instrument.network import InstrumentNetwork
from slipstitch.learning.torch_setup import set_up_torch

# What is the same for all members; the rest of a card is of one training.
_COMMON = (
    *("materials", "frames", "pixels", "viewpoints", "pose_range", "split", "frictions"),
    *("interpolated_videos", "calibration_simulations", "bfloat16", "settings", "dataset_digest"),
    *("training_videos", "training_simulations", "epochs", "chance_loss", "use", "started_from"),
)
_SUMMED = ("parameters", "multiply_accumulates_per_frame")


def combine_instruments(
    members: Sequence[str | Path],
    dataset: str | Path,
    split: str,
    out_dir: str | Path,
    further: Sequence[str | Path] = (),
    threads: int = 1,
) -> dict[str, Any]:
    """Average trained instruments, calibrate the error bars and the alarm of the average, write it.

    Parameters
    ----------
    members : sequence of path
        Folders of instruments that differ in their seed alone; if no video calibrated them, the
        average has no error bars.
    dataset, split
        On which they were trained; its validation videos calibrate.
    out_dir : path
        Gets the instrument, `ANSWERS`, from which other error bars can be fitted, and `READINGS`.
    further : sequence of path
        Datasets of other benches, of which all videos calibrate the intervals too.

    Returns the card: as the members' where they agree, and ``networks``, their number, ``seeds``,
    ``members_sha256``, ``train_loss``, one a member; ``calibration_readings``, a row for each of
    `further`. BadInput if members or datasets do not belong together, or are of no use.
    """
    started = start_clock()
    set_up_torch(threads)
    weights = [Path(member) / WEIGHTS for member in members]
    if not 2 <= len(members) <= NETWORKS_MAX:
        raise BadInput(f"{len(members)} instrument(s) given; 2 to {NETWORKS_MAX} are combined")
    trained = [load_instrument(member) for member in members]
    _check_alike(trained, members, split)
    networks = tuple(_rounded(instrument) for instrument in trained)
    combined = Instrument(networks, _common_card(trained, weights), None)
    alarms = [one.error_bars.alarm for one in trained if one.error_bars]
    held, readings = None, []
    if alarms:
        alarm = _joined(alarms)
        videos = _held_out(trained[0], dataset, split)
        held = answers_on(combined, alarm, videos, np.random.default_rng(0)).cast(ANSWERS_SCHEMA)
        combined = with_error_bars(combined, alarm, held)
        readings = _read_further(combined, [], further)
        combined = _rescaled(combined, held, readings)
    elif further:
        raise BadInput(
            f"{members[0]}: has no alarm, as none of its videos calibrated it; further datasets "
            "cannot calibrate it alone"
        )
    record = provenance_record(
        "instrument",
        # The manifest has the digest of every video's pixels, with which they are compared.
        inputs=[*weights, Path(dataset) / MANIFEST],
        config={"instrument": combined.settings},
        started=started,
    )
    record["inputs"] |= _inputs(further, (), 0)
    record["threads"] = threads
    return _write(combined, held, readings, out_dir, record)


def _common_card(trained: Sequence[Instrument], weights: Sequence[Path]) -> dict[str, Any]:
    """The card of an average, as `combine_instruments` says."""
    cards = [one.card for one in trained]
    return {name: cards[0].get(name) for name in _COMMON} | {
        "networks": len(cards),
        "seeds": [card["seed"] for card in cards],
        "members_sha256": [file_digest(path) for path in weights],
        "train_loss": [card["train_loss"] for card in cards],
        **{name: sum(card[name] for card in cards) for name in _SUMMED},
    }


def recalibrate_instrument(
    folder: str | Path,
    out_dir: str | Path,
    further: Sequence[str | Path] = (),
    files: Sequence[str | Path] = (),
    threads: int = 1,
) -> dict[str, Any]:
    """Stretch the intervals of an average by what it reads of other benches too, write it.

    All else stays as it is: medians, spread, fabrics and alarm. Datasets (`further`) give the
    intervals that `combine_instruments` gives with these; `files` have readings
    (`calibration.read_readings`). ``recalibrated_from`` in the card has ``weights_sha256`` and
    ``factor`` of before. BadInput if the instrument is no calibrated average, a file is damaged, or
    a source is of no use or known.
    """
    started = start_clock()
    set_up_torch(threads)
    before = load_instrument(folder)
    if len(before.networks) == 1:
        raise BadInput(f"{folder}: is a single training; averages alone keep what calibrated them")
    if before.error_bars is None:
        raise BadInput(f"{folder}: has no alarm, as nothing has calibrated it")
    held = read_parquet(Path(folder) / ANSWERS, ANSWERS_SCHEMA.names)
    readings = kept_readings(folder)
    try:
        inputs = read_provenance(Path(folder) / WEIGHTS)["inputs"]
    except FileNotFoundError:
        raise BadInput(f"{Path(folder) / WEIGHTS}: has no record of what trained it") from None
    first = len(sources_of(readings))
    readings = _read_further(before, readings, further, files)
    # A card names the weights beside it, which are others now.
    card = {name: entry for name, entry in before.card.items() if name != "weights_sha256"}
    card["recalibrated_from"] = {
        "weights_sha256": before.card["weights_sha256"],
        "factor": before.conformal_scale if math.isfinite(before.conformal_scale) else None,
    }
    combined = _rescaled(dataclasses.replace(before, card=card), held, readings)
    record = provenance_record(
        "instrument", config={"instrument": combined.settings}, started=started
    )
    record["inputs"] = inputs | _inputs(further, files, first)
    record["threads"] = threads
    return _write(combined, held, readings, out_dir, record)


def _inputs(
    further: Sequence[str | Path], files: Sequence[str | Path], first: int
) -> dict[str, str]:
    """Digests of what other benches are known from, by names that tell them apart."""
    paths = [
        *(("calibration_datasets", Path(folder) / MANIFEST) for folder in further),
        *(("calibration_readings", Path(file)) for file in files),
    ]
    return {
        f"{kind}/{number}/{path.name}": file_digest(path)
        for number, (kind, path) in enumerate(paths, first)
    }


def _read_further(
    combined: Instrument,
    readings: Readings,
    further: Sequence[str | Path],
    files: Sequence[str | Path] = (),
) -> Readings:
    """The readings and those of further datasets and files; BadInput if these cannot be used."""

    def in_view(row: dict[str, Any]) -> bool:
        return row["viewpoint"] in combined.card["viewpoints"]

    for path, is_dataset in (*((one, True) for one in further), *((one, False) for one in files)):
        if is_dataset:
            videos = read_videos(path, in_view, combined.settings.pixels)
            check_fits(videos, combined.card["frames"], combined.settings, path)
            found = readings_on(combined, videos)
        else:
            found = read_readings(path, combined)
        of_found, known = (
            {row[name] for row in rows for name in ("source", "dataset")} - {None}
            for rows in (found, readings)
        )
        if of_found & {combined.card["dataset_digest"], *known}:
            raise BadInput(f"{path}: trained or calibrates the instrument already")
        readings = readings + found
    return readings


def _rescaled(combined: Instrument, held: pa.Table, readings: Readings) -> Instrument:
    """The average whose conformal scale, and card, count the readings' simulations too."""
    simulations = len({*held["simulation"].to_pylist()}) + len({*groups_of(readings)})
    card = combined.card | {"calibration_simulations": simulations}
    bars = combined.error_bars
    if bars and readings:
        card["calibration_readings"] = sources_of(readings)
        scale = grouped_quantile(*pooled_scales(combined, held, readings), COVERAGE)
        bars = dataclasses.replace(bars, conformal_scale=scale)
    return dataclasses.replace(combined, card=card, error_bars=bars)


def _write(
    combined: Instrument,
    held: pa.Table | None,
    readings: Readings,
    out_dir: str | Path,
    record: dict[str, Any],
) -> dict[str, Any]:
    """Write the four files, tables without rows where nothing calibrates; return the card."""
    out = Path(out_dir)
    written = save_instrument(combined, out)
    for name in (WEIGHTS, CARD):
        write_sidecar(out / name, record)
    write_parquet(held or ANSWERS_SCHEMA.empty_table(), out / ANSWERS, {}, record)
    table = pa.Table.from_pylist(readings, schema=READINGS_SCHEMA)
    write_parquet(table, out / READINGS, {}, record)
    return written


def _check_alike(trained: Sequence[Instrument], members: Sequence[str | Path], split: str) -> None:
    """BadInput unless all are single networks, alike but for their seeds."""
    first = trained[0]
    seeds: dict[int, str | Path] = {}
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


def _held_out(instrument: Instrument, dataset: str | Path, split: str) -> Videos:
    """The videos that calibrate; BadInput if the dataset is not the one of the training."""
    column, views = f"split_{split_of(split)}", instrument.card["viewpoints"]

    def held(row: dict[str, Any]) -> bool:
        return takes_part(row, split) and row[column] == "validation" and row["viewpoint"] in views

    videos = read_videos(dataset, held, instrument.settings.pixels)
    if videos.digest != instrument.card["dataset_digest"]:
        raise BadInput(f"{dataset}: not the dataset on which the instruments were trained")
    return videos


def _rounded(instrument: Instrument) -> InstrumentNetwork:
    """The network of an instrument, rounded as it will be stored."""
    (network,) = instrument.networks
    state = {name: restored(halved(value)) for name, value in network.state_dict().items()}
    network.load_state_dict(state)
    return network


def _joined(alarms: Sequence[Alarm]) -> Alarm:
    """An alarm over all networks, its statistics rounded as they are stored; not calibrated."""
    # The first three are of the videos alone, and so the same for all.
    first = alarms[0]
    parts = (
        *(first.mean, first.components, first.variances),
        np.concatenate([alarm.embedding_mean for alarm in alarms]),
        np.concatenate([alarm.embedding_whitening for alarm in alarms]),
    )
    return Alarm(*(restored(halved(torch.from_numpy(part))).numpy() for part in parts))
