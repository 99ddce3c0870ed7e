# SPDX-License-Identifier: Apache-2.0
"""Contact with colliders: arrays of a batch, and how many elements each has."""

import warp as wp

from cloth_sim_ros.sim.arrays.model import Counts, Features

WORD = 64  # colliders a word
SWEPT = 64  # substeps whose colliders' motion a launch computes ahead
EXTENT = 8  # numbers a body: its lower and upper corner, the largest square of a speed, and if a collider is not listed


def words_of(colliders: int) -> int:
    """How many words hold a bit for each of so many colliders."""
    return -(-colliders // WORD)


# Array -> what it has a row of; cleared where a body is put elsewhere.
FORGOTTEN = {"supports": "particle"}


@wp.struct
class Sweep:
    """One collider within one substep: R^T at its end, R^T_end - R^T_start and a bound of it, position, motion [m]."""

    to_local: wp.mat33
    turn: wp.mat33
    spin: float
    position: wp.vec3
    motion: wp.vec3


@wp.struct
class Press:
    """What one collider asks of one facet, a triangle or segment, in substep `when`; in any other it asks for nothing.

    when: -1 for the last substep of the frame before. push [kg m], at the point of these weights of the corners, and
    rub, of friction, at that of weights `rubbed`. normal: out of the collider. so_far: friction and normal correction
    in this substep [kg m]. While the facet sticks, the point of weights `stuck` is held at `anchor` [m], in the
    collider's axes; all 0 where it slides. stops: the shares of their ways that its corners give up in substep
    `stopped`.
    """

    when: int
    weights: wp.vec3
    push: wp.vec3
    rubbed: wp.vec3
    rub: wp.vec3
    normal: wp.vec3
    so_far: wp.vec4
    stuck: wp.vec3
    anchor: wp.vec3
    stopped: int
    stops: wp.vec3


@wp.struct
class Look:
    """What was found when the deepest point of a facet in a collider was last looked for in this frame.

    Where its corners were then [m], in the collider's axes, the weights of that point, and the signed distance there
    [m]; known: 1 where there was such a time (a bool would leave bytes that nobody sets in what is saved).
    """

    a: wp.vec3
    b: wp.vec3
    c: wp.vec3
    weights: wp.vec3
    value: float
    known: int


@wp.struct
class ContactState:
    """Contact with colliders; see State for the letters."""

    contacts: wp.array(dtype=wp.vec4)  # (K N,) how a collider moved a particle so far in a substep, in its axes [m]
    contact_forces: wp.array(dtype=wp.vec4)  # (K N,) of each collider on each particle, mean over the frame [N]
    supports: wp.array(dtype=wp.vec4)  # (N,) by a collider in the last substep [m/s^2], and 1 + its number, of chains
    presses: wp.array(dtype=Press)  # (P K,) of surfaces that are tested between particles, as the next three
    looks: wp.array(dtype=Look)  # (P K,)
    close: wp.array(dtype=int)  # (N,) whether facets around a particle may touch a collider in this substep
    facets_moved_in: wp.array(dtype=int)  # (B,) one more than the last substep in which facets moved a particle
    pressed: wp.array(dtype=int)  # (N,) and bits of what they did to it, see facet_clamp.py
    sweeps: wp.array(dtype=Sweep)  # (SWEPT B K,)
    near: wp.array(
        dtype=wp.uint64
    )  # (B K/64,) bits of the colliders that a body may meet in this frame, see broad_phase.py
    extents: wp.array(dtype=float)  # (8 B,)
    boxes: wp.array(dtype=wp.vec4)  # (2 B,)


def sizes(features: Features, n: Counts) -> dict[str, int]:
    """Array -> its elements in one world; 0 where the features do not need it."""
    return {
        "contacts": n.particles * n.colliders,
        "contact_forces": n.particles * n.colliders,
        "supports": n.particles if features.supported else 0,
        "presses": n.panels * n.colliders if features.surface else 0,
        "looks": n.panels * n.colliders if features.surface else 0,
        "close": n.particles if features.surface else 0,
        "facets_moved_in": n.bodies if features.surface else 0,
        "pressed": n.particles if features.surface else 0,
        "sweeps": SWEPT * n.bodies * n.colliders,
        "near": n.bodies * words_of(n.colliders),
        "extents": EXTENT * n.bodies if n.colliders else 0,
        "boxes": 2 * n.bodies if n.colliders else 0,
    }
