"""The friction of the floor: its law, and what each node remembers of its contact."""

from dataclasses import dataclass
from math import cos, sin

import numpy as np
import warp as wp

from slipstitch.physics import GRAVITY_M_S2
from slipstitch.physics.cloth.contact import FrictionState
from slipstitch.physics.cloth.mesh import ClothMesh
from slipstitch.physics.friction_law import FrictionLaw
from slipstitch.physics.friction_law.mechanisms import REFERENCE_HUMIDITY_PCT


@dataclass(frozen=True)
class Conditions:
    """What acts on the cloth beside its clamps, and what an extended friction law may ask for."""

    gravity_m_s2: tuple[float, float, float] = (0.0, 0.0, -GRAVITY_M_S2)  # tilted for an incline
    # 0 for the floor z = 0; 1/R for a cylinder of radius R about the line x = 0, z = -R.
    ground_curvature_per_m: float = 0.0
    # What a node of the cloth typically bears, which penetration and tolerance refer to; None: the
    # median nodal weight. The share of the load where something else presses.
    nodal_force_N: float | None = None
    warp_angle_rad: float = 0.0  # from the cloth's u axis to its warp, towards v
    relative_humidity_pct: float = REFERENCE_HUMIDITY_PCT
    repeats: float = 0.0  # slides that the cloth has made before


class FloorFriction:
    """Law and contact history of the nodes, as the kernels read them.

    From a load of ``full_touch_N`` on, a node touches with its whole area.
    """

    def __init__(
        self,
        mesh: ClothMesh,
        friction: float | np.ndarray | FrictionLaw,
        conditions: Conditions,
        full_touch_N: float,
        device: str,
    ):
        law = friction if isinstance(friction, FrictionLaw) else None
        coefficient = law.coefficient if law else np.asarray(friction, float)
        self.coefficient = np.broadcast_to(coefficient, mesh.vertex_count).copy()
        self.extended = bool(law and (law.mechanisms or law.curve))  # other than Coulomb's
        self._mesh, self._warp_angle_rad = mesh, conditions.warp_angle_rad
        V = mesh.vertex_count

        def numbers(values):
            return wp.array(values, dtype=wp.float64, device=device)

        state = self.state = FrictionState()
        state.extended = self.extended
        state.coefficient = numbers(self.coefficient)
        state.values = numbers((law or FrictionLaw(0.0)).parameter_values())
        state.area_m2 = numbers(mesh.vertex_areas_m2())
        state.warp = wp.zeros(V, dtype=wp.vec2d, device=device)
        state.start = wp.zeros(V, dtype=wp.vec3d, device=device)
        state.sliding = wp.zeros(V, dtype=wp.int32, device=device)
        state.dwell_s, state.slid_m = numbers(np.zeros(V)), numbers(np.zeros(V))
        state.repeats = numbers(np.full(V, conditions.repeats))
        state.relative_humidity_pct = conditions.relative_humidity_pct
        state.full_touch_N = full_touch_N

    def begin(self, positions_m: np.ndarray, place_m: np.ndarray) -> None:
        """Take positions (V, 3) as the beginning of a step; ``place_m`` as `set_directions`."""
        if self.extended:
            self.state.start.assign(positions_m)
            self.set_directions(place_m)

    def set_directions(self, place_m: np.ndarray) -> None:
        """Take the warp's direction from coordinates (V, 3) along, across and above the ground."""
        grid = place_m.reshape(*self._mesh.shape, 3)
        rest = self._mesh.rest_uv_m.reshape(*self._mesh.shape, 2)
        along_u = np.gradient(grid[..., :2], rest[0, :, 0], axis=1)
        along_v = np.gradient(grid[..., :2], rest[:, 0, 1], axis=0)
        angle = self._warp_angle_rad
        warp = cos(angle) * along_u + sin(angle) * along_v
        self.state.warp.assign(np.ascontiguousarray(warp.reshape(-1, 2)))

    def go_on_from(self, other: "FloorFriction") -> None:
        """Take the contact history of another one of the same cloth."""
        for name in ("sliding", "dwell_s", "repeats"):
            getattr(self.state, name).assign(getattr(other.state, name))

    def rest(self, duration_s: float) -> None:
        """Let every resting node grow older without anything moving."""
        if self.extended:
            resting = self.state.sliding.numpy() == 0
            self.state.dwell_s.assign(self.state.dwell_s.numpy() + duration_s * resting)
