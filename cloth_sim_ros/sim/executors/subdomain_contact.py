# SPDX-License-Identifier: Apache-2.0
"""How far a member of a subdomain may go before it can touch a collider, so that most need not ask in every substep."""

import warp as wp

from cloth_sim_ros.sim.colliders import make_signed_distance
from cloth_sim_ros.sim.executors.subdomain_forces import InSubdomain
from cloth_sim_ros.sim.model import Features
from cloth_sim_ros.sim.stages.near import moved_of

_ROUNDING = wp.constant(1.0e-5)  # [m], of a signed distance, and for each metre from the origin
_ENOUGH = 1.0  # [m] what may go farther than this between two looks is tested more often than it needs


@wp.func
def travelled(d: wp.vec3) -> float:
    """A bound of |d| [m] without a root."""
    return wp.abs(d[0]) + wp.abs(d[1]) + wp.abs(d[2])


def make_clearance(features: Features):
    """A Warp function: how far [m] a particle at x may go between two fractions of the frame without touching.

    The particle is at the distance s of the surface. It moves by p in the world, and the collider by u and about its
    origin o by the angle a. In the axes of the collider it then moves by at most p + u + a (|x - o| + p + u). Contact
    cannot be before that is s minus the thickness. A particle that goes farther is tested in every substep, so that the
    bound saves work and decides nothing.
    """
    signed_distance = make_signed_distance(features.shapes)

    @wp.func
    def clearance(x: wp.vec3, before: float, after: float, here: InSubdomain) -> float:
        least = float(wp.static(_ENOUGH))
        for c in range(here.colliders.shape[0]):
            collider = here.colliders[c]
            offset = x - collider.start_position - before * (collider.end_position - collider.start_position)
            moved = moved_of(collider, after - before)
            used = here.material.thickness + moved[1] * wp.length(offset)
            # Of most colliders the ball around them tells that another one is nearer.
            if (wp.length(offset) - collider.reach - used) / (1.0 + moved[1]) - moved[0] < least:
                q = collider.start_orientation
                if wp.length_sq(collider.start_orientation - collider.end_orientation) > 0.0:
                    q = wp.quat_slerp(collider.start_orientation, collider.end_orientation, before)
                p = wp.quat_rotate_inv(q, offset)
                surface = signed_distance(collider.shape, p, collider.size, collider.data)
                least = wp.min(least, (surface[3] - used) / (1.0 + moved[1]) - moved[0])
        return least - _ROUNDING * (1.0 + travelled(x))

    return clearance
