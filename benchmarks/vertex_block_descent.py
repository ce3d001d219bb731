"""Newton physics' SolverVBD on the same mesh, sheet and clamps as the project's own solver.

Needs the optional extra: ``pip install slipstitch[benchmark]``. The sheet is isotropic, because
SolverVBD has no data-driven law: its stable neo-Hookean membrane and its hinges have the same
stiffness at small strain as `slipstitch.physics.fabric.isotropic_tables`.
"""

import newton
import numpy as np
import torch
import warp as wp

from slipstitch.physics import GRAVITY_M_S2

RADIUS_M = 1.0e-3  # particles touch the ground at this height; the ground lies as much lower


def hinge_stiffness(mesh, hinge_N_m):
    """SolverVBD's stiffness k (N) of each hinge, so that k l / 2 equals ke l^2 / (8 (a0 + a1))."""
    start, end, first, second = (mesh.rest_uv_m[mesh.hinges[:, k]] for k in range(4))
    edge = end - start
    double = sum(
        np.abs(edge[:, 0] * (tip - start)[:, 1] - edge[:, 1] * (tip - start)[:, 0])
        for tip in (first, second)
    )
    length_m = np.linalg.norm(edge, axis=1)
    return hinge_N_m * length_m / (4 * double / 2)


class VertexBlockDescent:
    """A sheet on the ground, stepped by SolverVBD on the CPU.

    Parameters
    ----------
    mesh : ClothMesh
    positions_m : ndarray, shape (V, 3)
    fixed : ndarray of bool, shape (V,)
    sheet : dict
        ``density_kg_m2``, ``membrane_N_m``, ``poisson_ratio``, ``hinge_N_m``.
    friction : float
    contact_N_m : float
        Stiffness of a particle's contact with the ground.
    iterations : int
    friction_epsilon : float
        Speed below which SolverVBD smooths friction, in m/s.
    gravity : sequence of 3 floats
    """

    def __init__(
        self, mesh, positions_m, fixed, sheet, *, friction, contact_N_m, iterations,
        friction_epsilon=1e-2, gravity=(0.0, 0.0, -GRAVITY_M_S2),
    ):  # fmt: skip
        self.mesh, self.fixed, self.sheet, self.gravity = mesh, fixed, sheet, gravity
        E, nu = sheet["membrane_N_m"], sheet["poisson_ratio"]
        self.shear_N_m = E / (2 * (1 + nu))
        self.dilation_N_m = E * nu / (1 - nu**2)
        builder = newton.ModelBuilder()
        ground = builder.default_shape_cfg.copy()
        ground.ke, ground.kd, ground.mu = contact_N_m, 0.0, friction
        builder.add_ground_plane(cfg=ground, height=-RADIUS_M)
        flat = np.column_stack([mesh.rest_uv_m, np.zeros(mesh.vertex_count)])
        builder.add_cloth_mesh(
            pos=wp.vec3(0.0), rot=wp.quat_identity(), scale=1.0, vel=wp.vec3(0.0),
            vertices=[wp.vec3(*p) for p in flat], indices=mesh.faces.ravel().tolist(),
            density=sheet["density_kg_m2"], tri_ke=self.shear_N_m, tri_ka=self.dilation_N_m,
            tri_kd=0.0, edge_ke=1.0, edge_kd=0.0, particle_radius=RADIUS_M,
        )  # fmt: skip
        builder.color(include_bending=True)
        self.model = builder.finalize(device="cpu")
        self.model.soft_contact_ke, self.model.soft_contact_kd = contact_N_m, 0.0
        self.model.soft_contact_mu = friction
        self.model.set_gravity(gravity)
        self._stiffen_hinges()
        mass = self.model.particle_mass.numpy()
        self.mass_kg = mass.astype(float)
        inverse = np.where(fixed, 0.0, 1.0 / mass).astype(np.float32)
        self.model.particle_inv_mass.assign(inverse)
        self.model.particle_mass.assign(np.where(fixed, 0.0, mass).astype(np.float32))
        flags = self.model.particle_flags.numpy()
        active = int(newton.ParticleFlags.ACTIVE)
        self.model.particle_flags.assign(np.where(fixed, flags & ~active, flags))
        self.solver = newton.solvers.SolverVBD(
            self.model, iterations=iterations, friction_epsilon=friction_epsilon
        )
        self.before, self.after = self.model.state(), self.model.state()
        for state in (self.before, self.after):
            state.particle_q.assign(np.asarray(positions_m, np.float32))
            state.particle_qd.zero_()
        self.control, self.contacts = self.model.control(), self.model.contacts()

    def _stiffen_hinges(self):
        """Give each hinge its own stiffness, whatever order SolverVBD keeps them in."""
        wanted = {
            tuple(sorted(edge)): stiffness
            for edge, stiffness in zip(
                self.mesh.hinges[:, :2].tolist(),
                hinge_stiffness(self.mesh, self.sheet["hinge_N_m"]),
                strict=True,
            )
        }
        ends = self.model.edge_indices.numpy()[:, 2:]
        properties = self.model.edge_bending_properties.numpy()
        properties[:, 0] = [wanted.get(tuple(sorted(edge)), 0.0) for edge in ends.tolist()]
        self.model.edge_bending_properties.assign(properties)

    @property
    def positions_m(self):
        """Positions, shape (V, 3), float64."""
        return self.before.particle_q.numpy().astype(float)

    def advance(self, step_s, prescribed_m=None):
        """One step; positions of the fixed particles are given."""
        if prescribed_m is not None:
            for state in (self.before, self.after):
                q = state.particle_q.numpy()
                q[self.fixed] = prescribed_m[self.fixed]
                state.particle_q.assign(q)
        self.before.clear_forces()
        self.model.collide(self.before, self.contacts)
        self.solver.step(self.before, self.after, self.control, self.contacts, step_s)
        self.before, self.after = self.after, self.before

    def out_of_balance(self, target_m, positions_m, step_s):
        """Out-of-balance force in N, without contact, shape (V, 3); 0 on the fixed particles.

        The gradient, in float64, of the energy whose minimum SolverVBD's step is.

        Parameters
        ----------
        target_m : ndarray, shape (V, 3)
            Where inertia alone would have taken the particles, without gravity.
        """
        x = torch.tensor(positions_m, dtype=torch.float64, requires_grad=True)
        mass = torch.tensor(self.mass_kg)[:, None]
        y = torch.tensor(target_m) + step_s**2 * torch.tensor(self.gravity, dtype=torch.float64)
        energy = (mass * (x - y) ** 2).sum() / (2 * step_s**2)
        energy = energy + self._membrane(x) + self._hinges(x)
        energy.backward()
        return np.where(self.fixed[:, None], 0.0, x.grad.numpy())

    def _membrane(self, x):
        faces = torch.tensor(self.mesh.faces.astype(np.int64))
        rest = self.mesh.rest_uv_m[self.mesh.faces]
        inverse = np.linalg.inv(np.stack([rest[:, 1] - rest[:, 0], rest[:, 2] - rest[:, 0]], 2))
        p = x[faces]
        F = torch.stack([p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]], 2) @ torch.tensor(inverse)
        stretched = torch.linalg.norm(torch.linalg.cross(F[:, :, 0], F[:, :, 1]), dim=1)
        mu, lam = self.shear_N_m, self.dilation_N_m + self.shear_N_m
        density = mu / 2 * (F**2).sum((1, 2)) + lam / 2 * (stretched - 1 - mu / lam) ** 2
        return (torch.tensor(self.mesh.face_areas_m2()) * density).sum()

    def _hinges(self, x):
        a, b, c, d = (x[torch.tensor(self.mesh.hinges[:, k].astype(np.int64))] for k in range(4))
        edge = b - a
        first, second = torch.linalg.cross(edge, c - a), torch.linalg.cross(d - a, edge)
        along = edge / torch.linalg.norm(edge, dim=1, keepdim=True)
        angle = torch.atan2(
            (torch.linalg.cross(first, second) * along).sum(1), (first * second).sum(1)
        )
        stiffness = torch.tensor(hinge_stiffness(self.mesh, self.sheet["hinge_N_m"]))
        ends = self.mesh.rest_uv_m[self.mesh.hinges[:, :2]]
        length = torch.tensor(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1))
        return (stiffness * length * angle**2).sum() / 2
