"""The ten fabrics of Wang, O'Brien and Ramamoorthi (2011)."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from slipstitch.base.errors import BadInput
from slipstitch.config.catalogue import FABRICS_FILE


@dataclass(frozen=True)
class Fabric:
    """Measured elastic parameters of one fabric.

    Attributes
    ----------
    name : str
    areal_density_kg_m2 : float
    stretching_N_m : ndarray, shape (6, 4)
        Rows: zero strain, then principal stretch at 0, 22.5, 45, 67.5, 90 degrees from u.
        Columns: c11, c12, c22, c33.
    bending_N_m : ndarray, shape (3, 5)
        Hinge stiffness. Rows: fold line at 0, 45, 90 degrees from u. Columns: curvature
        parameter 0, 5, 10, 15, 20 1/m.
    """

    name: str
    areal_density_kg_m2: float
    stretching_N_m: np.ndarray
    bending_N_m: np.ndarray

    def scaled(self, density: float, stretching: float, bending: float) -> Fabric:
        """Return the fabric with its three groups of parameters multiplied by factors."""
        return replace(
            self,
            areal_density_kg_m2=self.areal_density_kg_m2 * density,
            stretching_N_m=self.stretching_N_m * stretching,
            bending_N_m=self.bending_N_m * bending,
        )


def read_fabric_file(path: str | Path) -> dict[str, Fabric]:
    """Read a file of fabrics, in the layout of the project's own ``fabrics.json``.

    Raises
    ------
    BadInput
        A key is missing, a table has the wrong shape, or a value is not finite, or a value
        that must be positive (areal density, bending, stretching c11 and c22 at rest) is not.
    """
    path = Path(path)
    try:
        entries = json.loads(path.read_text(encoding="utf-8"))["fabrics"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise BadInput(f"{path}: not a fabric file with a 'fabrics' object ({error})") from None
    return {name: _fabric(path, name, entry) for name, entry in entries.items()}


def _fabric(path: Path, name: str, entry: dict) -> Fabric:
    where = f"{path}: fabric {name!r}"
    arrays = {}
    for key, shape in (
        ("areal_density_kg_m2", ()),
        ("stretching_N_m", (6, 4)),
        ("bending_N_m", (3, 5)),
    ):
        if not isinstance(entry, dict) or key not in entry:
            raise BadInput(f"{where}: {key} is missing")
        try:
            value = np.array(entry[key], dtype=float)
        except (TypeError, ValueError):
            raise BadInput(f"{where}: {key} must contain only numbers") from None
        if value.shape != shape:
            raise BadInput(f"{where}: {key} has shape {value.shape}, must be {shape}")
        if not np.isfinite(value).all():
            raise BadInput(f"{where}: {key} contains a non-finite value")
        arrays[key] = value
    if arrays["areal_density_kg_m2"] <= 0:
        raise BadInput(f"{where}: areal_density_kg_m2 must be positive")
    if (arrays["bending_N_m"] <= 0).any():
        raise BadInput(f"{where}: bending_N_m must be positive throughout")
    if (arrays["stretching_N_m"][0, [0, 2]] <= 0).any():
        raise BadInput(f"{where}: stretching_N_m row 0 must have positive c11 and c22")
    return Fabric(
        name, float(arrays["areal_density_kg_m2"]), arrays["stretching_N_m"], arrays["bending_N_m"]
    )


@cache
def _catalogue() -> dict[str, Fabric]:
    return read_fabric_file(FABRICS_FILE)


def load_fabric(name: str) -> Fabric:
    """Return a fabric of the catalogue.

    Raises
    ------
    BadInput
        The name is not in the catalogue.
    """
    try:
        return _catalogue()[name]
    except KeyError:
        allowed = ", ".join(_catalogue())
        raise BadInput(f"unknown material {name!r}; allowed: {allowed}") from None


def fabric_digest(name: str, catalogue: str | Path = FABRICS_FILE) -> str | None:
    """SHA-256 of the numbers of one fabric, whatever other fabrics there are.

    Parameters
    ----------
    name : str
    catalogue : path, optional
        File of fabrics; the project's own by default.

    Returns
    -------
    str or None
        None if there is no fabric of this name.

    Raises
    ------
    BadInput
        If the file is no file of fabrics.
    """
    fabrics = _catalogue() if catalogue == FABRICS_FILE else read_fabric_file(catalogue)
    if name not in fabrics:
        return None
    fabric = fabrics[name]
    numbers = [
        fabric.areal_density_kg_m2,
        fabric.stretching_N_m.tolist(),
        fabric.bending_N_m.tolist(),
    ]
    return hashlib.sha256(json.dumps(numbers).encode()).hexdigest()
