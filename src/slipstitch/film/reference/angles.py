"""The table of slip angles."""

import os
from collections import defaultdict
from dataclasses import dataclass

import numpy as np

from slipstitch.base.angles import in_radians
from slipstitch.base.errors import BadInput
from slipstitch.film.csv_table import TableColumn, name, number, read_table, whole_number


@dataclass(frozen=True)
class SlipAngles:
    """All measurements of one pair of fabric and substrate.

    Attributes
    ----------
    material, substrate : str
    position, orientation : list of str
        Of each measurement: the place on the substrate, the direction of the fabric.
    angle_rad : ndarray (n,)
        At which the specimen slipped.
    bench_error_rad : float
        The largest error of the bench's angle, the same in all measurements.
    """

    material: str
    substrate: str
    position: list[str]
    orientation: list[str]
    angle_rad: np.ndarray
    bench_error_rad: float


def read_angles(path: str | os.PathLike) -> list[SlipAngles]:
    """Slip angles by pair, in the order of the table.

    Raises
    ------
    BadInput
        If a cell is wrong, a measurement is there twice, or a pair has two bench errors.
    """
    rows = read_table(
        path,
        [
            TableColumn("material", name),
            TableColumn("substrate", name),
            TableColumn("position", name),
            TableColumn("orientation", name),
            TableColumn("repeat", whole_number(9999)),
            TableColumn("angle_deg", number(0, 85, open_ends=True)),
            TableColumn("bench_error_deg", number(0, 10)),
        ],
    )
    lines: dict[tuple, int] = {}
    pairs: dict[tuple[str, str], list[dict]] = defaultdict(list)
    for row in rows:
        key = tuple(row[title] for title in ("material", "substrate", "position", "orientation"))
        key += (row["repeat"],)
        if key in lines:
            raise BadInput(f"{path} line {row['line']}: duplicates line {lines[key]}")
        lines[key] = row["line"]
        pair = pairs[key[:2]]
        if pair and pair[0]["bench_error_deg"] != row["bench_error_deg"]:
            raise BadInput(
                f"{path} line {row['line']}: {key[0]} on {key[1]} differs in bench_error_deg "
                f"from line {pair[0]['line']}"
            )
        pair.append(row)
    for (material, substrate), measured in pairs.items():
        if in_radians(row["angle_deg"] for row in measured):
            raise BadInput(
                f"{path}: {material} on {substrate}: no angle_deg reaches 2; angles in radians?"
            )
    return [
        SlipAngles(
            material,
            substrate,
            [row["position"] for row in measured],
            [row["orientation"] for row in measured],
            np.radians([row["angle_deg"] for row in measured]),
            float(np.radians(measured[0]["bench_error_deg"])),
        )
        for (material, substrate), measured in pairs.items()
    ]
