"""A made-up drop-and-drag trajectory for tests of the renderer: a shape, not a simulation.

The profile is a vertical drop, a quarter circle and a flat tail, with wrinkles across the width;
the tail trails behind the stage's motion. Nothing here obeys any mechanics.
"""

import json

import numpy as np

SIDE_M = 0.2


def grid(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rest positions (V, 3), texture coordinates (V, 2), faces (F, 3); vertex i * n + j."""
    v, u = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n), indexing="ij")
    rest = np.stack([np.zeros_like(u), SIDE_M * (u - 0.5), SIDE_M * (1 - v)], axis=-1)
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.concatenate(
        [
            np.stack([corner, corner + 1, corner + n], axis=1),
            np.stack([corner + 1, corner + n + 1, corner + n], axis=1),
        ]
    )
    return rest.reshape(-1, 3), np.stack([u, v], axis=-1).reshape(-1, 2), faces


def shape(n: int, stage_x_m: float, stage_z_m: float, lean: float, wrinkle_m: float) -> np.ndarray:
    """Positions (V, 3) with the tail lying to the side of `lean` (-1 ... 1)."""
    s, u = np.meshgrid(np.linspace(0, SIDE_M, n), np.linspace(0, 1, n), indexing="ij")
    radius = 0.04
    drop = stage_z_m - radius
    arc = np.clip((s - drop) / radius, 0, np.pi / 2)
    flat = np.clip(s - drop - radius * np.pi / 2, 0, None)
    x = radius * (1 - np.cos(arc)) + flat
    z = stage_z_m - np.minimum(s, drop) - radius * np.sin(arc)
    ripple = wrinkle_m * np.sin(2 * np.pi * (2.5 * u + 3 * s)) * np.sin(np.pi * s / SIDE_M)
    x = stage_x_m + (1.0 if lean >= 0 else -1.0) * (0.3 + 0.7 * abs(lean)) * x + ripple
    z = z + np.abs(ripple) * np.sin(arc)
    y = SIDE_M * (u - 0.5) * (1 - 2 * wrinkle_m * np.sin(np.pi * s / SIDE_M))
    return np.stack([x, y, np.maximum(z, 0)], axis=-1).reshape(-1, 3).astype(np.float32)


def path(time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Roughly the stage's places x, z (m): 7 s down, then to and fro over 0.3 m in 31 s."""
    z = 0.21 - 0.06 * np.clip(time_s / 7, 0, 1)
    phase = np.clip(time_s - 7, 0, None) / 31 % 2
    return 0.3 * np.where(phase < 1, phase, 2 - phase), z


def motion(frames: int, n: int = 21, frame_rate_hz: float = 2.4) -> dict:
    """What a trajectory file holds, as keyword arguments of the trajectory type."""
    rest, uv, faces = grid(n)
    time_s = np.arange(frames) / frame_rate_hz
    x, z = path(time_s)
    lean = np.where((time_s - 7) / 31 % 2 < 1, -1.0, 1.0) * np.clip((time_s - 3) / 4, 0.1, 1)
    wrinkle = 0.006 + 0.004 * np.sin(0.3 * time_s)
    positions = np.stack([shape(n, *row) for row in zip(x, z, lean, wrinkle, strict=True)])
    return {
        "rest_positions_m": rest,
        "uv": uv,
        "faces": faces,
        "pinned": np.array([0, n - 1]),
        "frame": np.arange(frames, dtype=np.int32),
        "time_s": time_s,
        "stage_x_m": x,
        "stage_z_m": z,
        "positions_m": positions,
    }


def mesh_text(trajectory) -> str:
    """The mesh of a trajectory as a file ``mesh.json``, which stands beside many."""
    names = ("rest_positions_m", "uv", "faces", "pinned")
    return json.dumps({name: getattr(trajectory, name).tolist() for name in names})
