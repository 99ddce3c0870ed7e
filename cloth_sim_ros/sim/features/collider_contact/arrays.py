# SPDX-License-Identifier: Apache-2.0
"""Contact with colliders: arrays of a batch, and their sizes."""

import warp as wp

from cloth_sim_ros.sim.arrays.model import Counts, Features

WORD = 64  # colliders a word of bits
SWEPT = 64  # substeps for which one stage computes the motion of colliders ahead
# Numbers a body: lower and upper corner, largest squared speed, and 1 if a collider is not listed; then middle, margin
# and half size of its box, see Near; then 1 if it was placed into a collider.
EXTENT, BOX, OVERLAPS = 16, 8, 15


@wp.func
def words_of(colliders: int) -> int:
    """Return the number of words that hold a bit for each of `colliders`."""
    return (colliders + wp.static(WORD - 1)) // wp.static(WORD)


# Array -> the element of each of its rows. These arrays are cleared if a body is placed elsewhere.
FORGOTTEN = {"pinch_places": "particle", "contacts": "contact"}
# Arrays with an element for each collider beside each particle or facet. Colliders that no body lists change none.
BY_COLLIDER = ("contacts", "contact_forces", "leans", "presses", "looks")


@wp.struct
class Sweep:
    """Motion of one collider within one substep.

    to_local: R^T at its end. turn: R^T_end - R^T_start. spin: a bound of the norm of `turn`. position: at its end [m].
    motion: displacement in the substep [m].
    """

    to_local: wp.mat33
    turn: wp.mat33
    spin: float
    position: wp.vec3
    motion: wp.vec3


@wp.struct
class Press:
    """Corrections that one collider asks of one facet (a triangle or segment), valid in substep `when` only.

    when: the substep; -1 stands for the last substep of the frame before. push: correction [kg m] at the point with
    barycentric `weights`. rub: friction correction [kg m] at the point with weights `rubbed`. normal: out of the
    collider. so_far: friction and normal correction in this substep [kg m]; of a rope the forces [N], also of the
    last substep. lean, acted: of a rope normal and state of the contact in its solve, and the correction [kg m], see
    lean.py. friction: of a rope, see physics/friction.py. rounded: height by which a flat face is rounded there [m];
    eased: by how much less than it would be. hits: 1 if a rope hits the collider there. stuck, anchor: friction pulls
    the point with weights `stuck` to `anchor` [m], in the collider's axes. slides: 1 if it is at its limit; the anchor
    then follows at the distance that is left. stops: shares of their displacements that the corners give up in substep
    `stopped`, along `front` (in the collider's axes) or, if that is 0, of all. load: what a pinch adds along `normal`
    [kg m]. part: what of the push on a sheet ends an overlap [kg m], see part.py.
    """

    when: int
    weights: wp.vec3
    push: wp.vec3
    rubbed: wp.vec3
    rub: wp.vec3
    normal: wp.vec3
    so_far: wp.vec4
    lean: wp.vec4
    acted: wp.vec3
    friction: wp.vec3
    rounded: float
    eased: float
    hits: int
    stuck: wp.vec3
    slides: int
    anchor: wp.vec3
    stopped: int
    stops: wp.vec3
    front: wp.vec3
    load: float
    part: float


@wp.struct
class Lean:
    """How a particle of a rope leans on one collider within its solve, see lean.py.

    contact: normal and state of the contact; all 0 if they are apart. carried: correction that the last substep left
    [m], in the collider's axes, and the substep in which it was taken, plus 1.
    """

    contact: wp.vec4
    carried: wp.vec4


@wp.struct
class Look:
    """Result of the last search in this frame for the deepest point of a facet in a collider.

    a, b, c: places of the corners at that time [m], in the collider's axes. weights: barycentric weights of the point.
    value: signed distance there [m]. known: 1 if there was a search in this frame. It is an int, as a bool would leave
    undefined bytes in what is saved.
    """

    a: wp.vec3
    b: wp.vec3
    c: wp.vec3
    weights: wp.vec3
    value: float
    known: int


@wp.struct
class ContactState:
    """State of contact with colliders; see State for the letters."""

    # (K N,) correction of a particle by a collider so far in a substep, in its axes [m]; in a rope the acceleration
    # [m/s^2], also of the last substep. The last number: see touch_of
    contacts: wp.array(dtype=wp.vec4)
    contact_forces: wp.array(dtype=wp.vec4)  # (K N,) force of each collider on each particle, mean over the frame [N]
    leans: wp.array(dtype=Lean)  # (K N,) ropes
    presses: wp.array(dtype=Press)  # (P K,) of surfaces that are tested between particles, as the next four
    looks: wp.array(dtype=Look)  # (P K,)
    close: wp.array(dtype=int)  # (N,) 1 if facets around a particle may touch a collider in this substep
    facets_moved_in: wp.array(dtype=int)  # (B,) 1 + the last substep in which facets moved a particle
    pressed: wp.array(dtype=int)  # (N,) bits of what facets did to a particle, see facet_clamp.py
    sweeps: wp.array(dtype=Sweep)  # (SWEPT B K,)
    overlaps: wp.array(dtype=float)  # (4 N,) displacement out of an overlap, and what is left of that [m], see part.py
    near: wp.array(
        dtype=wp.uint64
    )  # (B K/64,) bits of the colliders that a body may touch in this frame, see broad_phase.py
    squeezed_in: wp.array(dtype=int)  # (K B,) 2 + the last substep in which a collider squeezed particles; -1: facets
    pinch_places: wp.array(dtype=wp.vec4)  # (N,) place between the colliders that hold it [m], see pinch.py
    pinch_pulls: wp.array(dtype=wp.vec4)  # (N,) force of the hold in the last substep, and load of each side [N]
    extents: wp.array(dtype=float)  # (EXTENT B,)


def sizes(features: Features, n: Counts) -> dict[str, int]:
    surface, pinches, near = features.surface, features.pinches, n.colliders > 0
    contacts, facets = n.particles * n.colliders, n.panels * n.colliders * surface
    return {
        **dict.fromkeys(("contacts", "contact_forces"), contacts),
        "leans": contacts * features.leans,
        **dict.fromkeys(("presses", "looks"), facets),
        "close": n.particles * surface,
        "facets_moved_in": n.bodies * surface,
        "pressed": n.particles * surface,
        "overlaps": 4 * n.particles * near,
        "sweeps": SWEPT * n.bodies * n.colliders,
        "near": n.bodies * words_of(n.colliders),
        "squeezed_in": n.bodies * n.colliders * pinches,
        **dict.fromkeys(("pinch_places", "pinch_pulls"), n.particles * pinches),
        "extents": EXTENT * n.bodies * near,
    }
