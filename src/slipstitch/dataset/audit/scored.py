"""What the scores of a published run are scores of, by the record of their evaluation."""

from collections.abc import Mapping, Sequence
from typing import Any

from slipstitch.dataset.manifest import MANIFEST

#: Files of an evaluation, each with the same record.
SCORES = ("metrics.json", "details.json", "predictions.parquet")
#: Before a model without scores, in the list of what a published run lacks.
SCORES_OF = "scores of "
#: Where datasets of other benches, which calibrate an average, are published.
FURTHER = "calibration_datasets/"


def compare(record: Any, digests: Mapping[str, str]) -> tuple[list[str], list[str]]:
    """Models and dataset of an evaluation against those that are there, by their digests alone.

    Parameters
    ----------
    record : mapping
        Provenance of the scores. Its paths are those of the results folder of then.
    digests : mapping
        File -> SHA-256; of these count weights and the dataset's manifest.

    Returns
    -------
    others : list of str
        What was evaluated and is not there, as the record calls it.
    unscored : list of str
        What is there and was not evaluated.
    """
    inputs = record.get("inputs") if isinstance(record, Mapping) else None
    evaluated = _counting(inputs if isinstance(inputs, Mapping) else {})
    there = _counting(digests)
    others = [name for name, digest in evaluated.items() if digest not in there.values()]
    # Datasets of other benches calibrate; the scores are of the run's own.
    unscored = [
        name
        for name, digest in there.items()
        if not name.startswith(FURTHER) and digest not in evaluated.values()
    ]
    return sorted(others), sorted(unscored)


def _counting(digests: Mapping[str, str]) -> dict[str, str]:
    return {name: one for name, one in digests.items() if name.endswith((".safetensors", MANIFEST))}


def and_more(names: Sequence[str]) -> str:
    """The first of some names, and how many more there are."""
    return names[0] + (f" and {len(names) - 1} more" if len(names) > 1 else "")
