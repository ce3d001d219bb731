"""A cloth between simulated ones: the weighted mean of their vertices, where that is a cloth.

Two simulations that roll over at other moments, or lie to other sides of the clamps, have no cloth
between them: in their mean, edges collapse. So each frame shows the mean of all parents if its
edges keep their lengths, else that of the film's own fabric alone, else the film's own simulation.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from slipstitch.base.errors import BadInput
from slipstitch.physics.simulation.trajectory import Trajectory

#: A frame of which one edge in a hundred is stretched or shortened by more is no cloth.
#: Of simulated ones it is 0.022 at most.
STRAIN_MAX = 0.03
#: Of which means the frames are: `interpolated` counts them under these names.
MIXED, OF_ONE_FABRIC, SIMULATED = "mixed", "of_one_fabric", "simulated"


def edge_strain(trajectory: Trajectory, positions_m: np.ndarray) -> np.ndarray:
    """The 99th percentile, over the edges, of the absolute strain of a cloth, shape (T,).

    Parameters
    ----------
    trajectory : Trajectory
        With the mesh and its rest positions.
    positions_m : ndarray (T, V, 3)
    """
    sides = np.sort(trajectory.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    tail, head = np.unique(sides, axis=0).T
    rest_m = trajectory.rest_positions_m
    lengths_m = np.linalg.norm(positions_m[:, tail] - positions_m[:, head], axis=2)
    strain = lengths_m / np.linalg.norm(rest_m[tail] - rest_m[head], axis=1) - 1
    return np.percentile(np.abs(strain), 99, axis=1)


def interpolated(
    parents: Mapping[str, Trajectory], weights: Mapping[str, float], own: str
) -> Trajectory:
    """The weighted mean of trajectories, frame by frame as far as it is a cloth.

    Parameters
    ----------
    parents : mapping
        Simulation id -> trajectory, on one mesh, at the same times.
    weights : mapping
        Simulation id -> weight, adding up to 1.
    own : str
        Simulation of the film; its id begins with its fabric's.

    Returns
    -------
    Trajectory
        ``metadata["interpolated_frames"]`` counts the frames by what they show.

    Raises
    ------
    BadInput
        If the trajectories do not fit one another.
    """
    first = parents[own]
    for name, other in parents.items():
        for field in ("faces", "uv", "frame", "time_s", "stage_x_m"):
            if not np.array_equal(getattr(other, field), getattr(first, field)):
                raise BadInput(f"{name}: its {field} is not that of {own}")
    of_fabric = {
        name: weight for name, weight in weights.items() if name.split("_")[0] == own.split("_")[0]
    }
    positions_m, stage_z_m = first.positions_m.astype(np.float64), first.stage_z_m.copy()
    shows = np.full(len(positions_m), SIMULATED, dtype="<U13")
    # The better replaces the worse, where it is a cloth.
    for kind, used in ((OF_ONE_FABRIC, of_fabric), (MIXED, weights)):
        if kind == MIXED and len(used) == len(of_fabric):
            continue
        total = sum(used.values())
        shares = {name: weight / total for name, weight in used.items()}
        mean_m, mean_z_m = np.zeros_like(positions_m), np.zeros_like(stage_z_m)
        for name, share in shares.items():
            mean_m += share * parents[name].positions_m
            mean_z_m += share * parents[name].stage_z_m
        whole = edge_strain(first, mean_m) <= STRAIN_MAX
        positions_m[whole], stage_z_m[whole] = mean_m[whole], mean_z_m[whole]
        shows[whole] = kind
    counts = {kind: int((shows == kind).sum()) for kind in (MIXED, OF_ONE_FABRIC, SIMULATED)}
    return replace(
        first,
        positions_m=positions_m.astype(np.float32),
        stage_z_m=stage_z_m,
        metadata={**first.metadata, "interpolated_frames": counts},
    )
