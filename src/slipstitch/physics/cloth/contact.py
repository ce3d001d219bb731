"""Inertia, gravity, and contact with the ground under dry friction (Warp kernels).

The ground is the floor z = 0, or a cylinder about a line along y whose crest is that floor's line x
= 0 (for the capstan): contact is worked out in coordinates along, across and above it.

Normal contact is a stiff penalty, a pressure that grows with depth (a micrometre or less under the
cloth's weight). Friction is exact, by :mod:`return mapping <cloth.friction>`: a node in contact
hangs on an anchor that does not move while |Q| is below the law's limit, mu P or an extended law's
(no creep, an elastic microslip of about a micrometre). Both springs are as stiff as a node's area
is large: cloth that lies evenly sinks in evenly, and all of it reaches the limit together.
"""

from dataclasses import dataclass
from math import cos, sin

import numpy as np
import warp as wp

from slipstitch.physics import GRAVITY_M_S2
from slipstitch.physics.cloth.friction import (
    ContactState,
    force_limit,
    kept_pull,
    returned_force,
    returned_stiffness,
)
from slipstitch.physics.cloth.mesh import ClothMesh
from slipstitch.physics.cloth.tangent import Entries, add_entry
from slipstitch.physics.friction_law import FrictionLaw
from slipstitch.physics.friction_law.mechanisms import REFERENCE_HUMIDITY_PCT

wp.set_module_options({"enable_backward": False})

ZERO = wp.constant(wp.float64(0.0))
ONE = wp.constant(wp.float64(1.0))

OPEN = wp.constant(0)
STICK = wp.constant(1)
SLIP = wp.constant(2)

LEAST_SLIDE_M = wp.constant(wp.float64(1.0e-3))  # a shorter motion from rest to rest is no slide
HALF_DIFFERENCE = wp.constant(wp.float64(1.0e-10))  # m, by which contact forces are differenced


@wp.struct
class GroundPoint:
    """A point as the ground sees it."""

    place: wp.vec2d  # along and across the ground, in m
    gap: wp.float64  # height above it, in m
    along: wp.vec3d  # unit vectors; the one across is y
    normal: wp.vec3d


@wp.func
def ground_point(p: wp.vec3d, curvature: wp.float64) -> GroundPoint:
    """Coordinates of a point over ground of a given curvature (1/m; 0: the plane z = 0)."""
    point = GroundPoint()
    if curvature == ZERO:
        point.place = wp.vec2d(p[0], p[1])
        point.gap = p[2]
        point.along = wp.vec3d(ONE, ZERO, ZERO)
        point.normal = wp.vec3d(ZERO, ZERO, ONE)
    else:
        radius = ONE / curvature
        up = p[2] + radius
        distance = wp.sqrt(p[0] * p[0] + up * up)
        point.place = wp.vec2d(radius * wp.atan2(p[0], up), p[1])
        point.gap = distance - radius
        point.along = wp.vec3d(up / distance, ZERO, -p[0] / distance)
        point.normal = wp.vec3d(p[0] / distance, ZERO, up / distance)
    return point


def ground_coordinates(x: np.ndarray, curvature: float) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates of points (n, 3) along, across, above the ground, and their unit vectors."""
    frames = np.broadcast_to(np.eye(3), (len(x), 3, 3)).copy()
    if curvature == 0:
        return x, frames
    up = x[:, 2] + 1 / curvature
    distance = np.hypot(x[:, 0], up)
    frames[:, 0, 0] = frames[:, 2, 2] = up / distance
    frames[:, 2, 0] = x[:, 0] / distance
    frames[:, 0, 2] = -frames[:, 2, 0]
    angle = np.arctan2(x[:, 0], up)
    coordinates = np.column_stack([angle / curvature, x[:, 1], distance - 1 / curvature])
    return coordinates, frames


@wp.struct
class FrictionState:
    """The friction law, and what it may ask of a node; Coulomb's law uses only the coefficient.

    Direction and speed are implicit; rest or motion, dwell and slides are those before the step.
    """

    extended: bool  # whether the limit is other than Coulomb's
    coefficient: wp.array(dtype=wp.float64)
    values: wp.array(dtype=wp.float64)  # of the mechanisms' parameters
    area_m2: wp.array(dtype=wp.float64)
    warp: wp.array(dtype=wp.vec2d)  # the warp's direction on the floor
    start: wp.array(dtype=wp.vec3d)  # place at the beginning of the step
    sliding: wp.array(dtype=wp.int32)
    dwell_s: wp.array(dtype=wp.float64)
    slid_m: wp.array(dtype=wp.float64)  # path since the last rest
    repeats: wp.array(dtype=wp.float64)
    relative_humidity_pct: wp.float64
    full_touch_N: wp.float64  # load that makes a node's whole area touch


@wp.struct
class Nodes:
    """Inertia of the nodes, what of them is solved for, and the ground below them."""

    mass_kg: wp.array(dtype=wp.float64)
    target: wp.array(dtype=wp.vec3d)  # where they would go by inertia alone
    free: wp.array(dtype=wp.vec3d)  # 1 where a coordinate is solved for, 0 where prescribed
    anchor: wp.array(dtype=wp.vec2d)  # on the ground, what friction remembers
    gravity_m_s2: wp.array(dtype=wp.vec3d)  # one vector
    inverse_step_squared: wp.array(dtype=wp.float64)  # one number, in 1/s^2
    curvature: wp.float64  # of the ground, in 1/m
    bedding: wp.float64  # the ground's stiffness per area, along and across, in N/m^3


@wp.struct
class Touch:
    """A node in contact with the ground."""

    point: GroundPoint
    normal_force: wp.float64
    stiffness: wp.float64  # in N/m, along the ground and into it
    pull: wp.vec2d  # from the anchor, in m
    limit: wp.float64  # of the tangential force


@wp.func
def limit_of(node: int, touch: Touch, nodes: Nodes, law: FrictionState) -> wp.float64:
    """Largest tangential force that a contact can bear: Coulomb's mu P, or an extended law's."""
    if not law.extended:
        return law.coefficient[node] * touch.normal_force
    start = ground_point(law.start[node], nodes.curvature)
    moved = wp.length(touch.point.place - start.place)
    warp = law.warp[node]
    pull = touch.pull
    state = ContactState()
    state.normal_force_N = touch.normal_force
    # A force that the area bears would jump where a node just touches, and leave the step
    # without a solution: the area comes to bear with the first part of the load.
    state.area_m2 = law.area_m2[node] * wp.min(ONE, touch.normal_force / law.full_touch_N)
    state.direction_rad = wp.atan2(warp[0] * pull[1] - warp[1] * pull[0], wp.dot(warp, pull))
    state.dwell_s = law.dwell_s[node]
    state.speed_m_s = moved * wp.sqrt(nodes.inverse_step_squared[0])
    state.repeats = law.repeats[node]
    state.relative_humidity_pct = law.relative_humidity_pct
    state.place_m = touch.point.place[0]
    return force_limit(law.coefficient[node], law.values, law.sliding[node] == 0, state)


@wp.func
def touched(node: int, point: GroundPoint, nodes: Nodes, law: FrictionState) -> Touch:
    """What a node bears at a point below the ground's surface."""
    touch = Touch()
    touch.point = point
    touch.stiffness = nodes.bedding * law.area_m2[node]
    touch.normal_force = -touch.stiffness * point.gap
    touch.pull = point.place - nodes.anchor[node]
    touch.limit = limit_of(node, touch, nodes, law)
    return touch


@wp.func
def ground_force(touch: Touch) -> wp.vec3d:
    """Force of a node in contact on the ground."""
    point = touch.point
    q = returned_force(touch.pull * touch.stiffness, touch.limit)
    return point.along * q[0] - point.normal * touch.normal_force + wp.vec3d(ZERO, q[1], ZERO)


@wp.kernel
def node_residual(
    x: wp.array(dtype=wp.vec3d),
    nodes: Nodes,
    law: FrictionState,
    minus_force: wp.array(dtype=wp.vec3d),
    residual: wp.array(dtype=wp.vec3d),
    state: wp.array(dtype=wp.int32),
):
    """Out-of-balance force of each node; reads and clears ``minus_force``."""
    i = wp.tid()
    p = x[i]
    r = minus_force[i] + nodes.mass_kg[i] * (
        (p - nodes.target[i]) * nodes.inverse_step_squared[0] - nodes.gravity_m_s2[0]
    )
    minus_force[i] = wp.vec3d()
    s = OPEN
    point = ground_point(p, nodes.curvature)
    if point.gap < ZERO:
        touch = touched(i, point, nodes, law)
        s = STICK
        if wp.length(touch.pull * touch.stiffness) > touch.limit:
            s = SLIP
        r += ground_force(touch)
    state[i] = s
    residual[i] = wp.cw_mul(r, nodes.free[i])


@wp.func
def symmetric_block(node: int, p: wp.vec3d, nodes: Nodes, law: FrictionState) -> wp.mat33d:
    """Positive part of the tangent: how the limit changes, and the normal turns, left out."""
    block = wp.mat33d()
    point = ground_point(p, nodes.curvature)
    if point.gap < ZERO:
        touch = touched(node, point, nodes, law)
        across = wp.vec3d(ZERO, ONE, ZERO)
        surface = wp.outer(point.along, point.along) + wp.outer(across, across)
        pull = wp.length(touch.pull)
        sideways = (across * touch.pull[0] - point.along * touch.pull[1]) / pull
        block = returned_stiffness(
            pull, surface, wp.outer(sideways, sideways), touch.stiffness, touch.limit
        )
        block += wp.outer(point.normal, point.normal) * touch.stiffness
    return block


@wp.kernel
def node_stiffness(x: wp.array(dtype=wp.vec3d), nodes: Nodes, law: FrictionState, entries: Entries):
    """Add inertia and contact's symmetric part to each node's block."""
    i = wp.tid()
    inertia = nodes.mass_kg[i] * nodes.inverse_step_squared[0]
    block = wp.identity(n=3, dtype=wp.float64) * inertia
    block += symmetric_block(i, x[i], nodes, law)
    for row in range(3):
        for column in range(3):
            add_entry(entries, i, 3 * row + column, block[row, column])


@wp.kernel
def move_anchors(x: wp.array(dtype=wp.vec3d), nodes: Nodes, law: FrictionState):
    """After an accepted step: anchors of slipping nodes follow, those of open nodes reset."""
    i = wp.tid()
    point = ground_point(x[i], nodes.curvature)
    if point.gap < ZERO:
        touch = touched(i, point, nodes, law)
        kept = kept_pull(wp.length(touch.pull), touch.stiffness, touch.limit)
        if kept < ONE:
            nodes.anchor[i] = point.place - touch.pull * kept
    else:
        nodes.anchor[i] = point.place


@wp.kernel
def contact_tangent(
    x: wp.array(dtype=wp.vec3d),
    nodes: Nodes,
    law: FrictionState,
    numbers: wp.array(dtype=wp.int32),
    symmetric: bool,
    blocks: wp.array(dtype=wp.mat33d),
):
    """Tangents of the ground's force on some nodes: exact, or as `node_stiffness` adds them."""
    k = wp.tid()
    i = numbers[k]
    if symmetric:
        blocks[k] = symmetric_block(i, x[i], nodes, law)
    else:
        for c in range(3):
            shift = wp.vec3d()
            shift[c] = HALF_DIFFERENCE
            ahead = touched(i, ground_point(x[i] + shift, nodes.curvature), nodes, law)
            behind = touched(i, ground_point(x[i] - shift, nodes.curvature), nodes, law)
            change = ground_force(ahead) - ground_force(behind)
            change = change / (HALF_DIFFERENCE + HALF_DIFFERENCE)
            for r in range(3):
                blocks[k][r, c] = change[r]


@wp.kernel
def advance_friction_state(
    x: wp.array(dtype=wp.vec3d), nodes: Nodes, law: FrictionState, state: wp.array(dtype=wp.int32)
):
    """After an accepted step: who rests and who slides, for how long, how often."""
    i = wp.tid()
    here = ground_point(x[i], nodes.curvature)
    before = ground_point(law.start[i], nodes.curvature)
    law.start[i] = x[i]
    if state[i] == SLIP:
        law.sliding[i] = 1
        law.dwell_s[i] = ZERO
        law.slid_m[i] = law.slid_m[i] + wp.length(here.place - before.place)
    else:
        if law.slid_m[i] > LEAST_SLIDE_M:
            law.repeats[i] = law.repeats[i] + ONE
        law.slid_m[i] = ZERO
        law.sliding[i] = 0
        if state[i] == STICK:
            law.dwell_s[i] = law.dwell_s[i] + ONE / wp.sqrt(nodes.inverse_step_squared[0])
        else:
            law.dwell_s[i] = ZERO


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
    """Law and contact history of the nodes, as the kernels read them."""

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
