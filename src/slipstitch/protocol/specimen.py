"""The isotropic cloth of the known-answer experiments."""

from dataclasses import replace

from slipstitch.material import ElasticTables, isotropic_tables

AREAL_DENSITY_KG_M2 = 0.2
MEMBRANE_STIFFNESS_N_M = 200.0
HINGE_STIFFNESS_N_M = 5.0e-5
DIAGONALS_OVER_EDGES = 1000.0


def cylindrical_strip_tables(membrane_stiffness_N_m: float, rigidity_Nm: float) -> ElasticTables:
    """Tables of a strip that bends about the mesh lines across it and resists twist.

    A narrow mesh of alternating diagonals bends more easily than a cylinder, by ke/4.95 instead
    of ke/4: its cross edges tilt to and fro. Stiff diagonals keep them from it, and the
    rigidity is the cylinder's. The cells of the mesh must be squares.

    Parameters
    ----------
    membrane_stiffness_N_m : float
        Young's modulus times thickness.
    rigidity_Nm : float
        B of a unit width.
    """
    tables = isotropic_tables(AREAL_DENSITY_KG_M2, membrane_stiffness_N_m, 4 * rigidity_Nm)
    bending_N_m = tables.bending_N_m.copy()
    bending_N_m[1] *= DIAGONALS_OVER_EDGES
    return replace(tables, bending_N_m=bending_N_m)
