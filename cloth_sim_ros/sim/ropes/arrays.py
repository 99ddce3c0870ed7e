# SPDX-License-Identifier: Apache-2.0
"""Ropes: arrays of a batch, and their sizes."""

import warp as wp

from cloth_sim_ros.sim.arrays.model import Counts, Features

NUMBERS = 71  # float64 of scratch for each particle, see rows.h

# Array -> the element of each of its rows. These arrays are cleared if a body is placed elsewhere.
FORGOTTEN = {"tensions": "segment", "moments": "segment"}

# Point of a segment: weights of both ends, and a vector s [sqrt(kg)] along the normal. The matrix s s^T keeps the ends
# from moving apart along it, as the point runs to the end that comes nearer to the collider.
Point = wp.types.vector(length=5, dtype=wp.float32)


@wp.struct
class Between:
    """What a collider does to a point of a segment, as `pushes` and `holds` of a particle."""

    push: wp.vec3  # [kg m]
    hold: wp.mat33  # [kg]
    point: Point
    eased: float  # see Press [m]


@wp.struct
class Sewn:
    """What the stitches at a particle, and at the segment behind it, do to it (see seams/held.py)."""

    start: wp.vec3  # displacement at which it was found [m]
    pull: wp.vec3  # force x h_e^2 there [kg m]
    hold: wp.mat33  # by how much less that is for a move of the particle from there [kg]
    beyond: wp.mat33  # the same for a move of the next one [kg]


@wp.struct
class RopeState:
    """State of ropes; see State for the letters."""

    tensions: wp.array(dtype=float)  # (C,) [N]
    moments: wp.array(dtype=wp.vec3)  # (C,) bending moment [N m] after each segment of a rope that bends
    falls: wp.array(dtype=wp.vec3)  # (N,) the part of a prediction that is not due to velocity [m]
    targets: wp.array(dtype=wp.vec3)  # (N,) displacements that particles would have without the rope [m]
    solved: wp.array(dtype=wp.vec3)  # (N,) displacements after the last solve and contact [m]
    starts: wp.array(
        dtype=wp.vec3
    )  # (N,) displacements before the solve [m], if there are colliders, as the next three
    half_turns: wp.array(dtype=float)  # (N,) half the angle by which the rope turns at a particle there [rad]
    pushes: wp.array(dtype=wp.vec3)  # (N,) correction by colliders at the start of the solve [m]
    holds: wp.array(dtype=wp.mat33)  # (N,) how much of a move from there colliders take back
    between: wp.array(dtype=Between)  # (C,) the same of segments, if facets are tested
    sewn: wp.array(dtype=Sewn)  # (N,) of a rope with seams
    scratch: wp.array(dtype=wp.float64)  # see rows.h
    overstretched: wp.array(dtype=int)  # (B,) 1 if a rope is overstretched in this substep


def sizes(features: Features, n: Counts) -> dict[str, int]:
    return {
        "tensions": n.segments,
        "moments": n.joints,
        **dict.fromkeys(("falls", "targets", "solved"), n.particles * features.chain),
        **dict.fromkeys(("starts", "half_turns", "pushes", "holds"), n.particles * features.leans),
        "between": n.segments * (features.leans and features.surface),
        "sewn": n.particles * (features.chain and features.sewn),
        "scratch": NUMBERS * (n.particles + 3 * n.bodies) * features.chain,
        "overstretched": n.bodies * features.chain,
    }
