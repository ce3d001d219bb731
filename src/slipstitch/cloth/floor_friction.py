"""The friction of the floor: its law, and what each node remembers of its contact."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, sin

import numpy as np
import warp as wp

from slipstitch.cloth import contact
from slipstitch.cloth.mesh import ClothMesh
from slipstitch.friction_law import FrictionLaw
from slipstitch.friction_law.contact import REFERENCE_HUMIDITY_PCT


@dataclass(frozen=True)
class ContactConditions:
    """What an extended law needs to know beside the motion.

    Attributes
    ----------
    warp_angle_rad : float
        From the cloth's u axis to its warp, towards v.
    relative_humidity_pct : float
    repeats : float
        Slides that the cloth has made before.
    """

    warp_angle_rad: float = 0.0
    relative_humidity_pct: float = REFERENCE_HUMIDITY_PCT
    repeats: float = 0.0


class FloorFriction:
    """Law and contact history of the nodes of a cloth, as the kernels read them.

    Parameters
    ----------
    mesh : ClothMesh
    friction : float, ndarray of shape (V,), or FrictionLaw
        Coulomb's coefficient, for all nodes or node by node, or a law.
    conditions : ContactConditions
    device : str
    """

    def __init__(
        self,
        mesh: ClothMesh,
        friction: float | np.ndarray | FrictionLaw,
        conditions: ContactConditions,
        device: str,
    ):
        law = friction if isinstance(friction, FrictionLaw) else None
        coefficient = law.coefficient if law else np.asarray(friction, float)
        V = mesh.vertex_count
        self.coefficient = np.broadcast_to(coefficient, V).copy()
        self.extended = bool(law and law.mechanisms)
        self.kernels = contact.contact_kernels(self.extended)
        self._mesh, self._conditions = mesh, conditions

        def array(values, dtype=wp.float64):
            return wp.array(np.ascontiguousarray(values), dtype=dtype, device=device)

        self.state = state = contact.FrictionState()
        state.coefficient = array(self.coefficient)
        state.relative_humidity_pct = conditions.relative_humidity_pct
        if not self.extended:
            return
        state.values = array(law.parameter_values())
        state.area_m2 = array(mesh.vertex_areas_m2())
        state.warp = array(np.zeros((V, 2)), wp.vec2d)
        state.start = array(np.zeros((V, 3)), wp.vec3d)
        state.sliding = array(np.zeros(V), wp.int32)
        state.dwell_s, state.slid_m = array(np.zeros(V)), array(np.zeros(V))
        state.repeats = array(np.full(V, conditions.repeats))

    def set_directions(self, place_m: np.ndarray) -> None:
        """Take the warp's direction on the ground from the present shape.

        Parameters
        ----------
        place_m : ndarray, shape (V, 3)
            Coordinates along, across and above the ground.
        """
        grid = place_m.reshape(*self._mesh.shape, 3)
        rest = self._mesh.rest_uv_m.reshape(*self._mesh.shape, 2)
        along_u = np.gradient(grid[..., :2], rest[0, :, 0], axis=1)
        along_v = np.gradient(grid[..., :2], rest[:, 0, 1], axis=0)
        angle = self._conditions.warp_angle_rad
        warp = cos(angle) * along_u + sin(angle) * along_v
        self.state.warp.assign(np.ascontiguousarray(warp.reshape(-1, 2)))

    def rest(self, duration_s: float) -> None:
        """Let every resting node grow older without anything moving."""
        if self.extended:
            resting = self.state.sliding.numpy() == 0
            self.state.dwell_s.assign(self.state.dwell_s.numpy() + duration_s * resting)
