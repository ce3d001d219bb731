"""Dry friction by return mapping (Warp functions): of the floor and between layers alike.

A contact hangs on what it remembers by a stiff tangential spring. While the spring's force is
below the friction law's limit the memory stays (stick); at the limit the force is the limit,
along the spring, and the memory is dragged after (slip). Simo and Hughes, Computational
Inelasticity (1998), ch. 1; Wriggers, Computational Contact Mechanics (2006).
"""

from __future__ import annotations

from typing import Any

import warp as wp

ZERO = wp.constant(wp.float64(0.0))
ONE = wp.constant(wp.float64(1.0))


@wp.func
def returned_force(force: Any, limit: wp.float64):
    """Force of the spring (N), cut to the limit."""
    size = wp.length(force)
    if size > limit:
        force = force * (limit / size)
    return force


@wp.func
def kept_pull(pull_m: wp.float64, stiffness: wp.float64, limit: wp.float64) -> wp.float64:
    """Part of the spring's length that is left once the memory has been dragged after."""
    reach = limit / stiffness
    if pull_m > reach:
        return reach / pull_m
    return ONE


@wp.func
def returned_stiffness(
    pull_m: wp.float64,
    surface: wp.mat33d,
    sideways: wp.mat33d,
    stiffness: wp.float64,
    limit: wp.float64,
) -> wp.mat33d:
    """Symmetric part of the tangent (N/m): how the limit follows the load is left out.

    Parameters
    ----------
    pull_m : float64
        Length of the spring.
    surface, sideways : mat33d
        Projectors on the surface, and on its direction across the spring.
    """
    if pull_m * stiffness <= limit:
        return surface * stiffness
    return sideways * (limit / pull_m)
