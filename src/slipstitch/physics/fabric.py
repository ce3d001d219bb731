"""The ten fabrics of Wang, O'Brien and Ramamoorthi (2011), and their data-driven elastic law.

The law as tables that the cloth's kernels interpolate, as ARCSim (Narain, Samii and O'Brien 2012)
and ARGUS sample it: stretching on a regular grid of Green strain, bending on fold direction and
curvature.
"""

import hashlib
import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from slipstitch.base.errors import BadInput
from slipstitch.config.catalogue import FABRICS_FILE

STRAIN_NODES = 30
NORMAL_STRAIN_MIN = -0.25  # of G00 and G11; |G01| starts at 0
STRAIN_SPACING = 1.0 / 30.0
CURVATURE_SPACING_PER_M = 5.0
FOLD_DIRECTIONS, FOLD_CURVATURES = 3, 5  # of the bending table


@dataclass(frozen=True)
class Fabric:
    """Measured elastic parameters of one fabric."""

    name: str
    areal_density_kg_m2: float
    # Rows: zero strain, then principal stretch at 0, 22.5, 45, 67.5, 90 degrees from u. Columns:
    # c11, c12, c22, c33.
    stretching_N_m: np.ndarray
    # Hinge stiffness. Rows: fold line at 0, 45, 90 degrees from u. Columns: curvature parameter 0,
    # 5, 10, 15, 20 1/m.
    bending_N_m: np.ndarray

    def scaled(self, density: float, stretching: float, bending: float) -> "Fabric":
        """Return the fabric with its three groups of parameters multiplied by factors."""
        scaled = self.stretching_N_m * stretching, self.bending_N_m * bending
        return Fabric(self.name, self.areal_density_kg_m2 * density, *scaled)


def read_fabric_file(path: str | Path) -> dict[str, Fabric]:
    """Read a file of fabrics, in the layout of ``fabrics.json``; BadInput says what is wrong."""
    path = Path(path)
    try:
        entries = json.loads(path.read_text(encoding="utf-8-sig"))["fabrics"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise BadInput(f"{path}: not a fabric file with a 'fabrics' object ({error})") from None
    return {name: _fabric(path, name, entry) for name, entry in entries.items()}


def _fabric(path: Path, name: str, entry: dict) -> Fabric:
    where = f"{path}: fabric {name!r}"
    arrays: dict = {}
    shapes = {"areal_density_kg_m2": (), "stretching_N_m": (6, 4), "bending_N_m": (3, 5)}
    for key, shape in shapes.items():
        if not isinstance(entry, dict) or key not in entry:
            raise BadInput(f"{where}: {key} is missing")
        try:
            arrays[key] = np.array(entry[key], dtype=float)
        except (TypeError, ValueError):
            raise BadInput(f"{where}: {key} must contain only numbers") from None
        if arrays[key].shape != shape or not np.isfinite(arrays[key]).all():
            raise BadInput(f"{where}: {key} must be finite numbers of shape {shape}")
    at_rest = arrays["stretching_N_m"][0, [0, 2]]
    for key, values in (arrays | {"stretching_N_m": at_rest}).items():
        if (values <= 0).any():
            raise BadInput(f"{where}: {key} must be positive (of stretching c11 and c22, row 0)")
    return Fabric(name, **arrays | {"areal_density_kg_m2": float(arrays["areal_density_kg_m2"])})


@cache
def _catalogue() -> dict[str, Fabric]:
    return read_fabric_file(FABRICS_FILE)


def load_fabric(name: str) -> Fabric:
    """Return a fabric of the catalogue, or BadInput."""
    if name not in _catalogue():
        raise BadInput(f"unknown material {name!r}; allowed: {', '.join(_catalogue())}")
    return _catalogue()[name]


def fabric_digest(name: str, catalogue: str | Path = FABRICS_FILE) -> str | None:
    """SHA-256 of the numbers of one fabric, whatever other fabrics there are; None without it."""
    fabrics = _catalogue() if catalogue == FABRICS_FILE else read_fabric_file(catalogue)
    if name not in fabrics:
        return None
    one = fabrics[name]
    numbers = [one.areal_density_kg_m2, one.stretching_N_m.tolist(), one.bending_N_m.tolist()]
    return hashlib.sha256(json.dumps(numbers).encode()).hexdigest()


@dataclass(frozen=True)
class ElasticTables:
    """The tables interpolated by the kernels."""

    areal_density_kg_m2: float
    # (30, 30, 30, 4): k0...k3 over (G00, G11, abs(G01)); nodes -0.25 + i/30, -0.25 + i/30, j/30.
    stretching_N_m: np.ndarray
    bending_N_m: np.ndarray  # (3, 5), as of a `Fabric`
    rest_curvature_per_m: float = 0.0  # about the u axis; positive curls to the face's normal

    @classmethod
    def of_fabric(cls, fabric: Fabric) -> "ElasticTables":
        """Sample the law of a fabric, on the nodes that the original samples it on."""
        normal = NORMAL_STRAIN_MIN + STRAIN_SPACING * np.arange(STRAIN_NODES)
        shear = STRAIN_SPACING * np.arange(STRAIN_NODES)
        strains = np.ix_(normal, normal, shear)
        stretching_N_m = stretching_stiffness(fabric.stretching_N_m, *strains)
        return cls(fabric.areal_density_kg_m2, stretching_N_m, np.maximum(fabric.bending_N_m, 0.0))


def stretching_stiffness(rows: np.ndarray, G00, G11, G01) -> np.ndarray:
    """Stiffness k0...k3 (..., 4) of a fabric's rows at given Green strains (...), in N/m."""
    C00, C11, C01 = np.broadcast_arrays(
        1 + 2 * np.asarray(G00, float), 1 + 2 * np.asarray(G11, float), 2 * np.asarray(G01, float)
    )
    middle, half = (C00 + C11) / 2, (C00 - C11) / 2
    stretch = np.sqrt(np.maximum(middle + np.hypot(half, C01), 0.0))
    # Direction of the largest principal stretch; where there is none, ARCSim reads 0.
    angle_deg = np.degrees(np.abs(0.5 * np.arctan2(C01, half)))
    weight = np.clip(6.0 * (stretch - 1.0), 0.0, 1.0)[..., None]
    position = np.clip(angle_deg / 22.5, 0.0, 4.0)
    low = np.minimum(position.astype(int), 3)
    fraction = (position - low)[..., None]
    directional = (1 - fraction) * rows[1 + low] + fraction * rows[2 + low]
    return 2.0 * np.maximum((1 - weight) * rows[0] + weight * directional, 0.0)


def isotropic_tables(
    areal_density_kg_m2: float,
    membrane_stiffness_N_m: float,
    hinge_stiffness_N_m: float,
    poisson_ratio: float = 0.0,
) -> ElasticTables:
    """Return tables of an isotropic, linear sheet, for comparison with theory.

    The plate rigidity is a quarter of the hinges' stiffness where the sheet is held cylindrical.
    """
    plane = membrane_stiffness_N_m / (1 - poisson_ratio**2)
    k = np.array([plane, poisson_ratio * plane, plane, (1 - poisson_ratio) * plane])
    stretching_N_m = np.broadcast_to(k, (*[STRAIN_NODES] * 3, 4)).copy()
    bending_N_m = np.full((FOLD_DIRECTIONS, FOLD_CURVATURES), hinge_stiffness_N_m)
    return ElasticTables(areal_density_kg_m2, stretching_N_m, bending_N_m)
