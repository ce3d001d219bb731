"""The isotropic cloth of the rigid friction experiments: any cloth would do."""

AREAL_DENSITY_KG_M2 = 0.2
MEMBRANE_STIFFNESS_N_M = 200.0
HINGE_STIFFNESS_N_M = 5.0e-5
