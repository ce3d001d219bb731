"""The classes of a dataset, materials or friction coefficients, and the labels of its videos."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import entr

from slipstitch.base.errors import BadInput


def classes_of(rows: list[dict[str, Any]], target: str) -> list[dict[str, Any]]:
    """The classes in manifest rows, in the order of their ids: ``{id, name | value}``.

    An interpolated video belongs to the class of its simulation, the nearest, and defines none.
    BadInput if an id refers to two materials or coefficients.
    """
    key = "name" if target == "material" else "value"
    rows = [row for row in rows if target == "material" or not row.get("interpolated")]
    found = {row[f"{target}_id"]: row[target] for row in rows}
    for row in rows:
        if found[row[f"{target}_id"]] != row[target]:
            raise BadInput(
                f"{target} {row[f'{target}_id']} is {row[target]!r} in {row['video']} "
                f"and {found[row[f'{target}_id']]!r} elsewhere"
            )
    return [{"id": class_id, key: found[class_id]} for class_id in sorted(found)]


def labels_of(rows: list[dict[str, Any]], classes: list[dict[str, Any]], target: str) -> np.ndarray:
    """Class numbers of videos, int64 of shape (n,); BadInput for a class that is not listed."""
    number = {entry["id"]: index for index, entry in enumerate(classes)}
    try:
        return np.array([number[row[f"{target}_id"]] for row in rows], np.int64)
    except KeyError as unknown:
        raise BadInput(
            f"a video has {target} {unknown.args[0]}, known classes: {', '.join(number)}"
        ) from None


def chance_loss(labels: ArrayLike) -> float:
    """Cross-entropy of the best guess that ignores the video: the entropy of the labels.

    ln K where the K classes are equally frequent.
    """
    return max(0.0, float(entr(np.bincount(labels) / len(labels)).sum()))
