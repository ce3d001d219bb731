"""The friction of the floor: its law, and what each node remembers of its contact."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, sin

import numpy as np
import warp as wp

from slipstitch.physics.cloth import contact
from slipstitch.physics.cloth.mesh import ClothMesh
from slipstitch.physics.friction_law import FrictionLaw
from slipstitch.physics.friction_law.contact import REFERENCE_HUMIDITY_PCT


@dataclass(frozen=True)
class ContactConditions:
    """The quantities required by an extended law in addition to the motion.

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


def friction_states(mesh: ClothMesh, count: int, device: str) -> contact.FrictionState:
    """Room for the law and the contact history of every node of ``count`` sheets."""
    V = mesh.vertex_count

    def array(*shape, dtype=wp.float64):
        return wp.zeros(shape, dtype=dtype, device=device)

    state = contact.FrictionState()
    state.coefficient = array(count * V)
    state.values = array(count, len(FrictionLaw(0.0).parameter_values()))
    areas_m2 = np.tile(mesh.vertex_areas_m2(), count)
    state.area_m2 = wp.array(areas_m2, dtype=wp.float64, device=device)
    state.warp = array(count * V, dtype=wp.vec2d)
    state.start = array(count * V, dtype=wp.vec3d)
    state.sliding = array(count * V, dtype=wp.int32)
    state.dwell_s, state.slid_m, state.repeats = (array(count * V) for _ in range(3))
    state.relative_humidity_pct, state.full_touch_N = array(count), array(count)
    return state


class FloorFriction:
    """Law and contact history of the nodes of one sheet, as the kernels read them.

    Parameters
    ----------
    mesh : ClothMesh
    friction : float, ndarray of shape (V,), or FrictionLaw
        Coulomb's coefficient, for all nodes or node by node, or a law.
    conditions : ContactConditions
    full_touch_N : float
        Load from which a node touches with its whole area.
    states : FrictionState
        Of all sheets that are evaluated together.
    member : int
        Which of them.

    Attributes
    ----------
    extended : bool
        Whether the limit is other than Coulomb's.
    """

    def __init__(
        self,
        mesh: ClothMesh,
        friction: float | np.ndarray | FrictionLaw,
        conditions: ContactConditions,
        full_touch_N: float,
        states: contact.FrictionState,
        member: int,
    ):
        law = friction if isinstance(friction, FrictionLaw) else None
        coefficient = law.coefficient if law else np.asarray(friction, float)
        self.coefficient = np.broadcast_to(coefficient, mesh.vertex_count).copy()
        self.extended = bool(law and (law.mechanisms or law.curve))
        self._mesh, self._conditions = mesh, conditions
        V = mesh.vertex_count
        own = slice(member * V, (member + 1) * V)
        self.start, self._warp = states.start[own], states.warp[own]
        self.sliding, self.dwell_s = states.sliding[own], states.dwell_s[own]
        self.repeats = states.repeats[own]
        states.coefficient[own].assign(self.coefficient)
        if law:
            states.values[member].assign(law.parameter_values())
        one = slice(member, member + 1)
        states.relative_humidity_pct[one].fill_(conditions.relative_humidity_pct)
        states.full_touch_N[one].fill_(full_touch_N)
        self.repeats.fill_(conditions.repeats)

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
        self._warp.assign(np.ascontiguousarray(warp.reshape(-1, 2)))

    def go_on_from(self, other: FloorFriction) -> None:
        """Take the contact history of another one of the same cloth."""
        for own, its in [
            (self.sliding, other.sliding),
            (self.dwell_s, other.dwell_s),
            (self.repeats, other.repeats),
        ]:
            own.assign(its)

    def rest(self, duration_s: float) -> None:
        """Let every resting node grow older without anything moving."""
        if self.extended:
            resting = self.sliding.numpy() == 0
            self.dwell_s.assign(self.dwell_s.numpy() + duration_s * resting)
