"""What an instrument says of the videos that calibrate it, and the file that keeps it."""

import os
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from slipstitch.base.provenance import read_parquet, write_parquet
from slipstitch.learning.instrument.alarm import SCORES

FILE = "calibration.parquet"
SCHEMA = pa.schema(
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
_NAMES = ("video", "simulation", "material", "friction")


@dataclass(frozen=True)
class CalibrationAnswers:
    """Uncalibrated answers on n videos that did not train.

    Attributes
    ----------
    rows : list of dict
        ``video, simulation, material, friction`` of each.
    probabilities : ndarray, shape (n, G)
        On the grid of mu.
    material_logits : ndarray, shape (n, M)
    strangeness : ndarray, shape (n, 4)
        Scores of the alarm, before they are scaled.
    """

    rows: list[dict[str, Any]]
    probabilities: np.ndarray
    material_logits: np.ndarray
    strangeness: np.ndarray

    @property
    def groups(self) -> list[str]:
        """The simulation of each."""
        return [row["simulation"] for row in self.rows]

    @property
    def friction(self) -> np.ndarray:
        """The coefficient of each, shape (n,)."""
        return np.array([row["friction"] for row in self.rows])

    def table(self) -> pa.Table:
        """As `FILE` keeps them: the answers of the networks in float32."""
        return pa.Table.from_pylist(
            [
                {name: row[name] for name in _NAMES}
                | {"probabilities": shares.tolist(), "material_logits": logits.tolist()}
                | dict(zip(SCORES, map(float, scores), strict=True))
                for row, shares, logits, scores in zip(
                    self.rows,
                    self.probabilities,
                    self.material_logits,
                    self.strangeness,
                    strict=True,
                )
            ],
            schema=SCHEMA,
        )


def from_table(table: pa.Table) -> CalibrationAnswers:
    """The inverse of `CalibrationAnswers.table`, rounded to what it keeps."""
    rows = table.to_pylist()
    return CalibrationAnswers(
        rows=[{name: row[name] for name in _NAMES} for row in rows],
        probabilities=np.array([row["probabilities"] for row in rows], np.float64),
        material_logits=np.array([row["material_logits"] for row in rows], np.float64),
        strangeness=np.array([[row[name] for name in SCORES] for row in rows], np.float64),
    )


def read_answers(path: str | os.PathLike) -> CalibrationAnswers:
    """Read `FILE`.

    Raises
    ------
    BadInput
        If the file is missing, damaged or another one.
    """
    return from_table(read_parquet(path, SCHEMA.names))


def write_answers(
    answers: CalibrationAnswers | None, path: str | os.PathLike, record: dict[str, Any]
) -> None:
    """Write `FILE`, without any row where nothing calibrates."""
    table = SCHEMA.empty_table() if answers is None else answers.table()
    write_parquet(table, path, {}, record)
