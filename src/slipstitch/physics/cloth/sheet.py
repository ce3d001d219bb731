"""A sheet of cloth on a device: the arrays of its forces and stiffness, and the launches.

Numbers are float64 on every device. A step is accepted when the forces on a node balance to 1e-4 of
its friction force, some 1e-8 N; a membrane of 1000 N/m gives that for 1e-11 m, and float32 resolves
1e-8 m at the size of the cloth.

Sums over elements go through atomic additions: on the CPU, where a kernel's elements run in turn,
in a fixed order; on a GPU in any order.
"""

import numpy as np
import warp as wp

from slipstitch.base.errors import BadInput
from slipstitch.physics.cloth import bending, contact, elasticity
from slipstitch.physics.cloth.contact import FloorFriction
from slipstitch.physics.cloth.mesh import ClothMesh
from slipstitch.physics.cloth.self_contact import SelfContact
from slipstitch.physics.cloth.tangent import Tangent
from slipstitch.physics.fabric import ElasticTables


class Sheet:
    """Device arrays and launches of a sheet whose ``fixed`` coordinates (V, 3) are prescribed.

    The nodes come with masses and ground; the other arrays are made here.
    """

    def __init__(
        self,
        mesh: ClothMesh,
        tables: ElasticTables,
        fixed: np.ndarray,
        floor: FloorFriction,
        nodes: contact.Nodes,
        stiffness_rule: int,
        device: str,
    ):
        self.device, self.floor, self.nodes = device, floor, nodes
        self.layers: SelfContact | None = None  # whose forces are added
        V = self._vertex_count = mesh.vertex_count
        elements = [mesh.faces, mesh.hinges, np.arange(V)[:, None]]
        self.tangent = Tangent(elements, fixed, mesh.elimination_order, device)
        nodes.target = wp.zeros(V, dtype=wp.vec3d, device=device)
        nodes.free = wp.array((~fixed).astype(float), dtype=wp.vec3d, device=device)
        nodes.anchor = wp.zeros(V, dtype=wp.vec2d, device=device)
        nodes.gravity_m_s2 = wp.zeros(1, dtype=wp.vec3d, device=device)
        nodes.inverse_step_squared = wp.ones(1, dtype=wp.float64, device=device)
        self.damping_ratio = wp.zeros(1, dtype=wp.float64, device=device)
        self._faces = elasticity.faces_of(mesh, tables, self.damping_ratio, device)
        self._hinges = bending.hinges_of(mesh, tables, self.damping_ratio, device)
        self._hinges.stiffness_rule = stiffness_rule
        self._minus_force = wp.zeros(V, dtype=wp.vec3d, device=device)
        self._residual = wp.zeros(V, dtype=wp.vec3d, device=device)
        self._state = wp.zeros(V, dtype=wp.int32, device=device)
        # The host's placed positions, and the last forces and contact states: on the CPU the
        # device's arrays themselves.
        self._host_x = np.zeros((V, 3))
        self._placed = wp.array(self._host_x, dtype=wp.vec3d, device="cpu", copy=False)
        self._shared = self._placed.device == wp.get_device(device)
        self.x = self._placed if self._shared else wp.zeros(V, dtype=wp.vec3d, device=device)
        self._host_residual, self._host_state = self._residual.numpy(), self._state.numpy()
        self._record_launches()

    def _record_launches(self) -> None:
        def launches(*over):
            return [
                wp.launch(kernel, dim, [self.x, *inputs], device=self.device, record_cmd=True)
                for kernel, dim, inputs in over
            ]

        F, H, V = len(self._faces.nodes), len(self._hinges.nodes), self._vertex_count
        faces, hinges, nodes = self._faces, self._hinges, [self.nodes, self.floor.state]
        of_faces, of_hinges, of_nodes = self.tangent.entries
        force = self._minus_force
        self._forces = launches(
            (elasticity.stretching_force, F, [faces, force]),
            (bending.bending_force, H, [hinges, force]),
            (contact.node_residual, V, [*nodes, force, self._residual, self._state]),
        )
        self._stiffness = launches(
            (elasticity.stretching_stiffness, F, [faces, of_faces]),
            (bending.bending_stiffness, H, [hinges, of_hinges]),
            (contact.node_stiffness, V, [*nodes, of_nodes]),
        )
        self._strains = launches(
            (elasticity.green_strains, F, [faces]), (bending.dihedral_angles, H, [hinges])
        )
        self._history = launches((contact.move_anchors, V, nodes))
        if self.floor.extended:
            self._history += launches((contact.advance_friction_state, V, [*nodes, self._state]))

    def _place(self, x: np.ndarray) -> None:
        self._host_x[:] = x
        if not self._shared:
            wp.copy(self.x, self._placed)

    def forces(self, x: np.ndarray) -> np.ndarray:
        """Out-of-balance forces at positions x, shape (V, 3), in N; prescribed ones are 0."""
        self._place(x)
        if self.layers is not None:
            self.layers.add_forces(self.x, self._minus_force)
        for launch in self._forces:
            launch.launch()
        if not self._shared:
            self._host_residual, self._host_state = self._residual.numpy(), self._state.numpy()
        return self.last_forces()

    def last_forces(self) -> np.ndarray:
        """The forces that :meth:`forces` returned last."""
        return self._host_residual.copy()

    def evaluated(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions of the last force evaluation (V, 3), and the nodes' states (V,)."""
        return self._host_x, self._host_state

    def assemble(self) -> None:
        """Assemble the tangent at the positions last evaluated."""
        if self.layers is not None and self.layers.room is None:
            self.layers.room = self.tangent.couple(self.layers.nodes)
        self.tangent.clear()
        for launch in self._stiffness:
            launch.launch()
        self.tangent.take_elements()
        if self.layers is not None:
            self.layers.add_stiffness(self.x)

    def begin_step(self, x: np.ndarray | None = None) -> None:
        """Refer damping to the strains at x; at the positions last evaluated by default."""
        if x is not None:
            self._place(x)
        for launch in self._strains:
            launch.launch()

    def accept(self) -> None:
        """Remember the positions last evaluated as the end of a step."""
        for launch in self._history:
            launch.launch()
        self.begin_step()

    def contact_tangents(self, numbers: np.ndarray, symmetric: bool) -> np.ndarray:
        """Tangents (n, 3, 3) of the ground's force on some nodes, see :mod:`..contact`."""
        blocks = wp.zeros(len(numbers), dtype=wp.mat33d, device=self.device)
        nodes = wp.array(numbers.astype(np.int32), dtype=wp.int32, device=self.device)
        inputs = [self.x, self.nodes, self.floor.state, nodes, symmetric, blocks]
        wp.launch(contact.contact_tangent, len(numbers), inputs=inputs, device=self.device)
        return blocks.numpy()


def check_device(name: str) -> None:
    """BadInput if forces cannot be evaluated on a device, because it is not on this machine."""
    here = [device.alias for device in wp.get_devices()]
    if name not in here and not (name == "cuda" and wp.is_cuda_available()):
        raise BadInput(
            f"device {name}: not available on this machine; available: {', '.join(here)}"
        )
