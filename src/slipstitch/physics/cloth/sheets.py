"""Sheets of cloth whose forces and stiffness are evaluated together, on one device.

The arrays hold one sheet's nodes, faces or hinges after another's, so that one launch serves every
sheet that has asked (those marked active); a single sheet is the case of one.

Numbers are float64 on every device. A step is accepted when the forces on a node balance to 1e-4 of
its friction force, some 1e-8 N; a membrane of 1000 N/m gives that for 1e-11 m, and float32 resolves
1e-8 m at the size of the cloth.

Sums over elements go through atomic additions: on the CPU, where a kernel's elements run in turn,
in a fixed order, so that a sheet gets the same bits alone and among others; on a GPU in any order.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np
import warp as wp

from slipstitch.base.errors import BadInput, NotConverged
from slipstitch.physics.cloth import bending, contact, elasticity
from slipstitch.physics.cloth.batch import Meeting, Work
from slipstitch.physics.cloth.floor_friction import friction_states
from slipstitch.physics.cloth.mesh import ClothMesh
from slipstitch.physics.cloth.self_contact import SelfContact
from slipstitch.physics.cloth.tangent import Assembly, Entries
from slipstitch.physics.fabric.law import FOLD_CURVATURES, STRAIN_NODES


class Sheets:
    """Device arrays and launches of sheets of one mesh with the same held coordinates.

    Parameters
    ----------
    mesh : ClothMesh
    fixed : ndarray of bool, shape (V, 3)
        Coordinates that are prescribed.
    count : int
        Number of sheets.
    device : str
        Warp device: ``cpu``, ``cuda``, ``cuda:1`` ...

    Raises
    ------
    BadInput
        There is no such device here.
    """

    def __init__(self, mesh: ClothMesh, fixed: np.ndarray, count: int = 1, device: str = "cpu"):
        check_device(device)
        self.mesh, self.count, self.device = mesh, count, device
        self.fixed = np.array(fixed, dtype=bool)
        self.assembly = Assembly([mesh.faces, mesh.hinges], self.fixed, device)
        self.layers: dict[int, SelfContact] = {}
        self.meeting: Meeting | None = None  # of the sheets' tasks, while they run together
        self._allocate()
        self._elements: dict[Work, list[wp.Launch]] = {}
        self._nodes: dict[tuple[Work, bool], list[wp.Launch]] = {}
        self._record_elements()

    def _allocate(self) -> None:
        mesh, count = self.mesh, self.count
        V, F, H = mesh.vertex_count, len(mesh.faces), len(mesh.hinges)

        def zeros(*shape, dtype=wp.float64):
            return wp.zeros(shape, dtype=dtype, device=self.device)

        def table(values, dtype):
            return wp.array(np.ascontiguousarray(values), dtype=dtype, device=self.device)

        def repeated(values, dtype, offset=0):
            shift = np.arange(count).repeat(len(values)) * offset
            whole = np.concatenate([values] * count)
            return table(whole + shift.reshape(-1, *[1] * (whole.ndim - 1)), dtype)

        def members(elements):
            return table(np.arange(count).repeat(elements), wp.int32)

        vectors = partial(zeros, count * V, dtype=wp.vec3d)
        self.damping_ratio = zeros(count)
        faces = self.faces = elasticity.Faces()
        faces.members, faces.nodes = members(F), repeated(mesh.faces, wp.int32, V)
        faces.gradients = repeated(elasticity.shape_gradients(mesh), wp.vec2d)
        faces.area_m2 = repeated(mesh.face_areas_m2(), wp.float64)
        faces.strain_before = zeros(count * F, dtype=wp.vec3d)
        faces.table = zeros(count * STRAIN_NODES, STRAIN_NODES, STRAIN_NODES, dtype=wp.vec4d)
        faces.damping_ratio = self.damping_ratio
        hinges = self.hinges = bending.Hinges()
        hinges.members, hinges.nodes = members(H), repeated(mesh.hinges, wp.int32, V)
        length_m, area_m2, _ = bending.hinge_geometry(mesh)
        hinges.per_angle = repeated(length_m / (2 * area_m2), wp.float64)
        hinges.shape = repeated(length_m**2 / (4 * area_m2), wp.float64)
        hinges.rest_angle, hinges.angle_before = zeros(count * H), zeros(count * H)
        hinges.stiffness_before = zeros(count * H)
        hinges.table = zeros(count * H, FOLD_CURVATURES)
        hinges.stiffness_rule = zeros(count, dtype=wp.int32)
        hinges.damping_ratio = self.damping_ratio
        nodes = self.nodes = contact.Nodes()
        nodes.members, nodes.mass_kg = members(V), zeros(count * V)
        nodes.target, nodes.free = vectors(), vectors()
        nodes.anchor = zeros(count * V, dtype=wp.vec2d)
        nodes.gravity_m_s2 = zeros(count, dtype=wp.vec3d)
        nodes.inverse_step_squared = zeros(count)
        ground = self.ground = contact.Ground()
        ground.curvature, ground.bedding = zeros(count), zeros(count)
        self.friction = friction_states(mesh, count, self.device)
        self._x, self._minus_force, self._residual = vectors(), vectors(), vectors()
        self._state = zeros(count * V, dtype=wp.int32)
        self._values = zeros(count * self.assembly.pattern.entry_count)
        self._active = zeros(count, dtype=wp.int32)
        self._asked: tuple[int, ...] = ()
        self.extended = [False] * count
        # The host's placed positions, and the last forces and contact states: on the CPU the
        # device's arrays themselves.
        self._host_x = np.zeros((count * V, 3))
        self._placed = wp.array(self._host_x, dtype=wp.vec3d, device="cpu", copy=False)
        self._shared = self._placed.device == wp.get_device(self.device)
        if self._shared:
            self._x = self._placed
        self._host_residual, self._host_state = self._residual.numpy(), self._state.numpy()
        # Each sheet's part of arrays that all share.
        entries = self.assembly.pattern.entry_count
        self._positions = [self._x[self.nodes_of(member)] for member in range(count)]
        self._forces = [self._minus_force[self.nodes_of(member)] for member in range(count)]
        self._tangents = [
            self._values[member * entries : (member + 1) * entries] for member in range(count)
        ]

    def _launch(self, kernel: wp.Kernel, inputs: list, elements: int) -> wp.Launch:
        """Record a launch over the elements of all sheets."""
        inputs = [self._active, *inputs]
        dim = self.count * elements
        return wp.launch(kernel, dim=dim, inputs=inputs, device=self.device, record_cmd=True)

    def _record_elements(self) -> None:
        F, H = len(self.mesh.faces), len(self.mesh.hinges)
        faces, hinges = [self._x, self.faces], [self._x, self.hinges]
        of_faces, of_hinges = (self._entries(places) for places in self.assembly.entries)
        self._elements[Work.FORCES] = [
            self._launch(elasticity.stretching_force, [*faces, self._minus_force], F),
            self._launch(bending.bending_force, [*hinges, self._minus_force], H),
        ]
        self._elements[Work.STIFFNESS] = [
            self._launch(elasticity.stretching_stiffness, [*faces, of_faces], F),
            self._launch(bending.bending_stiffness, [*hinges, of_hinges], H),
        ]
        self._elements[Work.STRAINS] = self._elements[Work.ACCEPT] = [
            self._launch(elasticity.green_strains, faces, F),
            self._launch(bending.dihedral_angles, hinges, H),
        ]

    def _entries(self, places: wp.array) -> Entries:
        """Positions in the matrices to which elements of one kind contribute."""
        entries = Entries()
        entries.place, entries.values = places, self._values
        entries.per_sheet = self.assembly.pattern.entry_count
        return entries

    def _node_launches(self, work: Work, extended: bool) -> list[wp.Launch]:
        """Launches over nodes, recorded when first asked for: each law is a module to compile."""
        if (work, extended) not in self._nodes:
            self._nodes[work, extended] = [
                self._launch(kernel, inputs, self.mesh.vertex_count)
                for kernel, inputs in self._node_kernels(work, extended)
            ]
        return self._nodes[work, extended]

    def _node_kernels(self, work: Work, extended: bool) -> Iterator[tuple[wp.Kernel, list]]:
        kernels = contact.contact_kernels(extended)
        nodes = [self._x, self.nodes, self.ground, self.friction]
        if work is Work.FORCES:
            yield kernels.residual, [*nodes, self._minus_force, self._residual, self._state]
        elif work is Work.STIFFNESS:
            yield kernels.stiffness, [*nodes, self._entries(self.assembly.node_entries)]
        elif work is Work.ACCEPT:
            yield kernels.move_anchors, nodes
            if extended:
                yield contact.advance_friction_state, [*nodes, self._state]

    def nodes_of(self, member: int) -> slice:
        """Places of a sheet's nodes in the arrays of all."""
        V = self.mesh.vertex_count
        return slice(member * V, (member + 1) * V)

    # -- what a sheet's solver does -------------------------------------------------------

    def place(self, member: int, x: np.ndarray) -> None:
        """Put a sheet's nodes at positions (V, 3), in m, for the work asked for next."""
        self._host_x[self.nodes_of(member)] = x

    def ask(self, work: Work, member: int) -> None:
        """Have work done for a sheet; among others, when all that still run have asked."""
        if self.meeting is None:
            self.run(work, [member])
        else:
            self.meeting.ask(work, member)

    def forces(self, member: int) -> np.ndarray:
        """Out-of-balance forces (V, 3) of a sheet when it last asked for them, in N."""
        return self._host_residual[self.nodes_of(member)].copy()

    def evaluated(self, member: int) -> tuple[np.ndarray, np.ndarray]:
        """Positions of a sheet's last force evaluation (V, 3), and the nodes' states (V,)."""
        nodes = self.nodes_of(member)
        return self._host_x[nodes], self._host_state[nodes]

    def contact_tangents(self, member: int, nodes: np.ndarray, symmetric: bool) -> np.ndarray:
        """Tangents (n, 3, 3) of the ground's force on some nodes, see :mod:`..contact`."""
        blocks = wp.zeros(len(nodes), dtype=wp.mat33d, device=self.device)
        numbers = (nodes + self.nodes_of(member).start).astype(np.int32)
        inputs = [self._x, self.nodes, self.ground, self.friction]
        inputs += [wp.array(numbers, dtype=wp.int32, device=self.device), symmetric, blocks]
        kernel = contact.contact_kernels(self.extended[member]).tangent
        wp.launch(kernel, dim=len(nodes), inputs=inputs, device=self.device)
        return blocks.numpy()

    def positions(self, member: int) -> wp.array:
        """A sheet's positions (V,) on the device, where its forces were last evaluated."""
        return self._positions[member]

    def tangent_values(self, member: int) -> wp.array:
        """Entries of a sheet's tangent on the device."""
        return self._tangents[member]

    # -- launches -------------------------------------------------------------------------

    def run(self, work: Work, members: Sequence[int]) -> None:
        """Do one kind of work for some sheets."""
        if work in (Work.FORCES, Work.STRAINS) and not self._shared:
            wp.copy(self._x, self._placed)
        if work is Work.FORCES and self.layers:
            self._add_layers(members)
        if work is Work.STIFFNESS:
            for member in members:
                wp.copy(self.tangent_values(member), self.assembly.template)
        if work is Work.ACCEPT:
            self._run_nodes(work, members)
        self._activate(members)
        for launch in self._elements[work]:
            launch.launch()
        if work in (Work.FORCES, Work.STIFFNESS):
            self._run_nodes(work, members)
        if work is Work.FORCES and not self._shared:
            self._host_residual = self._residual.numpy()
            self._host_state = self._state.numpy()

    def _add_layers(self, members: Sequence[int]) -> None:
        for member in members:
            if member in self.layers:
                self.layers[member].add_forces(self.positions(member), self._forces[member])

    def _run_nodes(self, work: Work, members: Sequence[int]) -> None:
        for extended in (False, True):
            group = [member for member in members if self.extended[member] == extended]
            if group:
                self._activate(group)
                for launch in self._node_launches(work, extended):
                    launch.launch()

    def _activate(self, members: Sequence[int]) -> None:
        """Mark the sheets that the next launches are for."""
        if tuple(members) != self._asked:
            self._asked = tuple(members)
            active = np.zeros(self.count, dtype=np.int32)
            active[list(members)] = 1
            self._active.assign(active)


def run_together(sheets: Sheets, tasks: Sequence[Callable[[], Any]]) -> list[Any]:
    """Run tasks that drive one sheet each, the device working for all at once.

    Parameters
    ----------
    sheets : Sheets
    tasks : sequence of callables
        Task k may use the solver of sheet k only.

    Returns
    -------
    list
        What each task returned, or the :class:`NotConverged` that it raised: a task that fails does
        not take the others with it. Any other exception ends all and is raised.
    """
    if len(tasks) == 1:  # nobody to wait for
        try:
            return [tasks[0]()]
        except NotConverged as error:
            return [error]
    sheets.meeting = Meeting(sheets.run, tasks)
    try:
        return sheets.meeting.run()
    finally:
        sheets.meeting = None


def check_device(name: str) -> None:
    """Whether forces can be evaluated on a device.

    Raises
    ------
    BadInput
        There is no such device here.
    """
    here = [device.alias for device in wp.get_devices()]
    if name not in here and not (name == "cuda" and wp.is_cuda_available()):
        raise BadInput(
            f"device {name}: not available on this machine; available: {', '.join(here)}"
        )
