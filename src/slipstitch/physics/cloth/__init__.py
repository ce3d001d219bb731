"""Cloth with frictional contact: mesh, elasticity, bending, contact, time stepping.

Knows nothing of files, Snakemake or Blender.
"""

from slipstitch.base.start import start_warp

start_warp()

from slipstitch.physics.cloth.contact import Conditions  # noqa: E402
from slipstitch.physics.cloth.mesh import ClothMesh, rectangle  # noqa: E402
from slipstitch.physics.cloth.solver import ClothSolver, SolverSettings, StepRecord  # noqa: E402
