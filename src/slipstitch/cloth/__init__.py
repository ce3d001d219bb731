"""Cloth with frictional contact: mesh, elasticity, bending, contact, time stepping.

Knows nothing of files, Snakemake or Blender.
"""

from slipstitch.warp_start import start_warp

start_warp()

from slipstitch.cloth.floor_friction import ContactConditions  # noqa: E402
from slipstitch.cloth.mesh import ClothMesh, rectangle  # noqa: E402
from slipstitch.cloth.sheets import Sheets, check_device, run_together  # noqa: E402
from slipstitch.cloth.solver import ClothSolver, SolverSettings, StepRecord  # noqa: E402

__all__ = [
    "ClothMesh",
    "ClothSolver",
    "ContactConditions",
    "Sheets",
    "SolverSettings",
    "StepRecord",
    "check_device",
    "rectangle",
    "run_together",
]
