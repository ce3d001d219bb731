"""Stretching of the sheet: forces and stiffness per triangle (Warp kernels).

St. Venant-Kirchhoff with strain-dependent stiffness (Wang, O'Brien and Ramamoorthi 2011, as
read by ARCSim): Green strain G, stress S00 = k0 G00 + k1 G11, S11 = k2 G11 + k1 G00,
S01 = k3 G01; nodal force -A F S grad N. The strain dependence of k is left out of the force,
as in the original. Damping is Kelvin-Voigt: the stress of the strain's change over the step,
times damping time over step.
"""

import numpy as np
import warp as wp

from slipstitch.physics.cloth.mesh import ClothMesh
from slipstitch.physics.cloth.tangent import Entries, add_entry
from slipstitch.physics.fabric import NORMAL_STRAIN_MIN, STRAIN_NODES, STRAIN_SPACING, ElasticTables

wp.set_module_options({"enable_backward": False})

ORIGIN = wp.constant(wp.float64(NORMAL_STRAIN_MIN))
PER_SPACING = wp.constant(wp.float64(1.0 / STRAIN_SPACING))
LAST_NODE = wp.constant(wp.float64(STRAIN_NODES - 1))
ZERO = wp.constant(wp.float64(0.0))
ONE = wp.constant(wp.float64(1.0))
HALF = wp.constant(wp.float64(0.5))


def shape_gradients(mesh: ClothMesh) -> np.ndarray:
    """Gradients of the three shape functions of each face, shape (F, 3, 2), in 1/m."""
    a, b, c = (mesh.rest_uv_m[mesh.faces[:, k]] for k in range(3))
    edges = np.stack([b - a, c - a], axis=2)  # columns
    inverse = np.linalg.inv(edges)
    return np.stack([-inverse.sum(axis=1), inverse[:, 0], inverse[:, 1]], axis=1)


@wp.struct
class Faces:
    """The faces of the sheet and their stretching law."""

    nodes: wp.array(dtype=wp.int32, ndim=2)
    gradients: wp.array(dtype=wp.vec2d, ndim=2)  # of the shape functions, in 1/m
    area_m2: wp.array(dtype=wp.float64)
    strain_before: wp.array(dtype=wp.vec3d)  # (G00, G11, G01) at the beginning of the step
    table: wp.array(dtype=wp.vec4d, ndim=3)  # k0...k3 in N/m
    damping_ratio: wp.array(dtype=wp.float64)  # one number: damping time over step


def faces_of(mesh: ClothMesh, tables: ElasticTables, damping_ratio: wp.array, device: str) -> Faces:
    """Put the faces of a sheet on a device."""
    faces = Faces()
    faces.nodes = wp.array(mesh.faces, dtype=wp.int32, device=device)
    faces.gradients = wp.array(shape_gradients(mesh), dtype=wp.vec2d, device=device)
    faces.area_m2 = wp.array(mesh.face_areas_m2(), dtype=wp.float64, device=device)
    faces.strain_before = wp.zeros(len(mesh.faces), dtype=wp.vec3d, device=device)
    faces.table = wp.array(tables.stretching_N_m, dtype=wp.vec4d, device=device)
    faces.damping_ratio = damping_ratio
    return faces


@wp.func
def stiffness_at(
    table: wp.array(dtype=wp.vec4d, ndim=3), G00: wp.float64, G11: wp.float64, G01: wp.float64
) -> wp.vec4d:
    """Interpolate k0...k3 trilinearly, clamped to the table."""
    x = wp.clamp((G00 - ORIGIN) * PER_SPACING, ZERO, LAST_NODE)
    y = wp.clamp((G11 - ORIGIN) * PER_SPACING, ZERO, LAST_NODE)
    z = wp.clamp(wp.abs(G01) * PER_SPACING, ZERO, LAST_NODE)
    i = wp.min(int(x), int(LAST_NODE) - 1)
    j = wp.min(int(y), int(LAST_NODE) - 1)
    k = wp.min(int(z), int(LAST_NODE) - 1)
    fx = x - wp.float64(i)
    fy = y - wp.float64(j)
    fz = z - wp.float64(k)
    c00 = table[i, j, k] * (ONE - fx) + table[i + 1, j, k] * fx
    c10 = table[i, j + 1, k] * (ONE - fx) + table[i + 1, j + 1, k] * fx
    c01 = table[i, j, k + 1] * (ONE - fx) + table[i + 1, j, k + 1] * fx
    c11 = table[i, j + 1, k + 1] * (ONE - fx) + table[i + 1, j + 1, k + 1] * fx
    return (c00 * (ONE - fy) + c10 * fy) * (ONE - fz) + (c01 * (ONE - fy) + c11 * fy) * fz


@wp.struct
class Deformation:
    """Columns of the deformation gradient F, and Green strain (G00, G11, G01)."""

    f0: wp.vec3d
    f1: wp.vec3d
    G: wp.vec3d


@wp.func
def deformation(x: wp.array(dtype=wp.vec3d), faces: Faces, t: int) -> Deformation:
    f0 = wp.vec3d()
    f1 = wp.vec3d()
    for a in range(3):
        g = faces.gradients[t, a]
        p = x[faces.nodes[t, a]]
        f0 += p * g[0]
        f1 += p * g[1]
    face = Deformation()
    face.f0 = f0
    face.f1 = f1
    face.G = wp.vec3d(
        HALF * (wp.dot(f0, f0) - ONE), HALF * (wp.dot(f1, f1) - ONE), HALF * wp.dot(f0, f1)
    )
    return face


@wp.kernel
def green_strains(x: wp.array(dtype=wp.vec3d), faces: Faces):
    """Note the Green strain (G00, G11, G01) of each face."""
    t = wp.tid()
    faces.strain_before[t] = deformation(x, faces, t).G


@wp.kernel
def stretching_force(
    x: wp.array(dtype=wp.vec3d), faces: Faces, minus_force: wp.array(dtype=wp.vec3d)
):
    """Add minus the elastic and viscous nodal forces of each face."""
    t = wp.tid()
    face = deformation(x, faces, t)
    k = stiffness_at(faces.table, face.G[0], face.G[1], face.G[2])
    d = faces.damping_ratio[0]
    area = faces.area_m2[t]
    E = face.G + (face.G - faces.strain_before[t]) * d
    S00 = area * (k[0] * E[0] + k[1] * E[1])
    S11 = area * (k[2] * E[1] + k[1] * E[0])
    S01 = area * k[3] * E[2]
    for a in range(3):
        g = faces.gradients[t, a]
        wp.atomic_add(
            minus_force,
            faces.nodes[t, a],
            face.f0 * (S00 * g[0] + S01 * g[1]) + face.f1 * (S01 * g[0] + S11 * g[1]),
        )


@wp.kernel
def stretching_stiffness(x: wp.array(dtype=wp.vec3d), faces: Faces, entries: Entries):
    """Add each face's stiffness, kept positive definite: of stress only the tensile part."""
    t = wp.tid()
    face = deformation(x, faces, t)
    k = stiffness_at(faces.table, face.G[0], face.G[1], face.G[2])
    d = faces.damping_ratio[0]
    area = faces.area_m2[t]
    E = face.G + (face.G - faces.strain_before[t]) * d
    S00 = k[0] * E[0] + k[1] * E[1]
    S11 = k[2] * E[1] + k[1] * E[0]
    S01 = k[3] * E[2]
    # Tensile part of the symmetric 2 x 2 stress.
    mean = HALF * (S00 + S11)
    half = HALF * (S00 - S11)
    radius = wp.sqrt(half * half + S01 * S01)
    high = wp.max(mean + radius, ZERO)
    low = wp.max(mean - radius, ZERO)
    if radius > wp.float64(1.0e-300):
        c = half / radius
        s = S01 / radius
        m = HALF * (high + low)
        r = HALF * (high - low)
        S00 = m + r * c
        S11 = m - r * c
        S01 = r * s
    else:
        S00 = high
        S11 = high
        S01 = ZERO
    scale = area * (ONE + d)
    k0 = scale * k[0]
    k2 = scale * k[2]
    k1 = wp.min(scale * k[1], wp.float64(0.99) * wp.sqrt(k0 * k2))
    k3 = scale * HALF * k[3]
    identity = wp.identity(n=3, dtype=wp.float64)
    for b in range(3):
        gb = faces.gradients[t, b]
        # Strains (G00, G11, 2 G01) per displacement of vertex b are the rows of Q_b.
        b0 = face.f0 * gb[0]
        b1 = face.f1 * gb[1]
        b2 = face.f0 * gb[1] + face.f1 * gb[0]
        for a in range(3):
            ga = faces.gradients[t, a]
            a0 = face.f0 * ga[0]
            a1 = face.f1 * ga[1]
            a2 = face.f0 * ga[1] + face.f1 * ga[0]
            geometric = area * (
                ga[0] * (S00 * gb[0] + S01 * gb[1]) + ga[1] * (S01 * gb[0] + S11 * gb[1])
            )
            block = (
                wp.outer(a0, b0 * k0 + b1 * k1)
                + wp.outer(a1, b0 * k1 + b1 * k2)
                + wp.outer(a2, b2 * k3)
                + identity * geometric
            )
            for p in range(3):
                for q in range(3):
                    add_entry(entries, t, (a * 3 + p) * 9 + b * 3 + q, block[p, q])
