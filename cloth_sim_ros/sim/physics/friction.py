# SPDX-License-Identifier: Apache-2.0
"""Contact on displacements: the push of a compliant collider, and Coulomb friction."""

import warp as wp


@wp.func
def friction_correction(slip: wp.vec3, before: wp.vec3, pressed: float, static: float, kinetic: float) -> wp.vec3:
    """The tangential correction of a substep [m] that Coulomb's law allows.

    slip: tangential displacement relative to the surface that is left [m]; before: correction given so far; pressed:
    total normal correction [m], the normal impulse times h w. Sticks while the whole correction stays in the static
    cone, else slides with the kinetic coefficient (Macklin et al. 2014, sec. 6.1, on accumulated corrections).
    """
    wanted = before - slip
    size = wp.length(wanted)
    if size > static * pressed:
        wanted *= wp.min(1.0, kinetic * pressed / wp.max(size, 1.0e-20))
    return wanted


@wp.func
def outward(gap: float, before: float, softness: float) -> float:
    """Additional push [m] of a point in contact that lies `-gap` [m] deep and was pushed by `before` [m] so far.

    softness: compliance of the collider over inverse mass of the point x h^2. The force is the total push over the same
    inverse mass x h^2 (Macklin et al. 2016, eq. 18). A softness of 0 pushes the point out fully. Contacts never pull.
    """
    return wp.max(-(gap + softness * before) / (1.0 + softness), -before)
