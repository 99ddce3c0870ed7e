# SPDX-License-Identifier: Apache-2.0
"""Contact on displacements: the push of a compliant collider, and Coulomb friction."""

import warp as wp

# Slip [m/s] from which on friction is kinetic. Slower slips have more, up to the static friction at 0 (Stribeck 1902).
# With a jump there, a sheet on a tray that speeds up would break loose, as BDF2 overshoots in its first two substeps.
SLOW = wp.constant(0.05)


@wp.func
def coefficient(friction: wp.vec3, slip: float) -> float:
    """Return the coefficient of friction at a slip [m] in a substep.

    friction: coefficients, static and kinetic, and the slip in a substep from which on it is kinetic [m].
    """
    return friction[0] + wp.min(slip / wp.max(friction[2], 1.0e-20), 1.0) * (friction[1] - friction[0])


@wp.func
def friction_correction(slip: wp.vec3, before: wp.vec3, pressed: float, friction: wp.vec3) -> wp.vec3:
    """The tangential correction of a substep [m] that Coulomb's law allows.

    slip: tangential displacement relative to the surface that is left [m]; before: correction given so far; pressed:
    total normal correction [m], the normal impulse times h w; friction: see `coefficient`. Sticks while the whole
    correction stays in the static cone, else slides (Macklin et al. 2014, sec. 6.1, on accumulated corrections).
    """
    wanted = before - slip
    size = wp.length(wanted)
    if size > friction[0] * pressed:
        most = coefficient(friction, size - friction[0] * pressed) * pressed
        wanted *= wp.min(1.0, most / wp.max(size, 1.0e-20))
    return wanted


@wp.func
def outward(gap: float, before: float, softness: float) -> float:
    """Additional push [m] of a point in contact that lies `-gap` [m] deep and was pushed by `before` [m] so far.

    softness: compliance of the collider over inverse mass of the point x h^2. The force is the total push over the same
    inverse mass x h^2 (Macklin et al. 2016, eq. 18). A softness of 0 pushes the point out fully. Contacts never pull.
    """
    return wp.max(-(gap + softness * before) / (1.0 + softness), -before)
