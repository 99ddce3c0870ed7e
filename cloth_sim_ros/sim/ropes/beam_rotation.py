# SPDX-License-Identifier: Apache-2.0
"""How the rest shape of a bent rope turns with it in a substep: all of it by one rotation, found with displacements.

Let the rest turn vectors r point where the turn vectors did before the substep. Turned by any rotation R they leave the
energy of half the sum of EI / span |kappa - R r|^2. It is nowhere less than what the lengths of kappa alone tell, and
at first, with R = 1, the same. So what makes the least of it and of inertia, displacements and R together, gives no
energy to the rope (majorization, Hunter and Lange 2004). And where no other R is better, moments bear no torque as a
whole: a free rope keeps its angular momentum, and one that hangs by an end swings.

For any R the matrix of the solve is the same A = m + G^T (EI / span) G. With u for R = 1 and A y = G^T (EI / span) r
bending moves particles by u + (R - 1) y, in all solves of the substep together. R brings y nearest to y - u and
z = G y - r nearest to z - (kappa - r), weighted by masses and by EI / span (Procrustes: Schoenemann 1966), by Newton's
method on the torque. What is summed is of one sign or as small as the motion, so that single precision knows R - 1 as
well as it knows a displacement.
"""

import warp as wp

from cloth_sim_ros.sim.kernels.intrinsics import load4, store4, sum_of_warp, sync

SUMS = wp.constant(4)  # vec4 by which a warp hands on its sums
STEPS = wp.constant(2)
LARGEST = wp.constant(0.5)  # a step of Newton's method turns by no more [rad]


@wp.struct
class Sums:
    """Over the particles and joints of a rope [kg m^2]."""

    inertia: wp.mat33  # m y y^T and EI / span z z^T
    lag: wp.mat33  # m y u^T and EI / span z (kappa - r)^T


@wp.func
def with_particle(sums: Sums, mass: float, u: wp.vec3, y: wp.vec3) -> Sums:
    """The sums with a particle, which bending moves by u, or if the rest shape turns by u + (R - 1) y."""
    sums.inertia += mass * wp.outer(y, y)
    sums.lag += mass * wp.outer(y, u)
    return sums


@wp.func
def with_joint(sums: Sums, stiff: float, z: wp.vec3, lack: wp.vec3) -> Sums:
    """The sums with a joint whose turn vector lacks so much to its rest when particles move by u."""
    sums.inertia += stiff * wp.outer(z, z)
    sums.lag += stiff * wp.outer(z, lack)
    return sums


@wp.func
def sums_of_block(t: int, threads: int, own: Sums, at: int, shared: wp.uint64) -> Sums:
    """The sums of all threads of a block, in the order of their numbers; shared memory is free from `at` on."""
    a = own.inertia
    b = own.lag
    mine = at + SUMS * (t / 32)
    first = sum_of_warp(wp.vec4(a[0, 0], a[0, 1], a[0, 2], a[1, 1]))
    second = sum_of_warp(wp.vec4(a[1, 2], a[2, 2], b[0, 0], b[0, 1]))
    third = sum_of_warp(wp.vec4(b[0, 2], b[1, 0], b[1, 1], b[1, 2]))
    fourth = sum_of_warp(wp.vec4(b[2, 0], b[2, 1], b[2, 2], 0.0))
    if t % 32 == 0:
        store4(shared, mine, first)
        store4(shared, mine + 1, second)
        store4(shared, mine + 2, third)
        store4(shared, mine + 3, fourth)
    sync()
    total = Sums()
    for warp in range((threads + 31) / 32):
        p = load4(shared, at + SUMS * warp)
        q = load4(shared, at + SUMS * warp + 1)
        r = load4(shared, at + SUMS * warp + 2)
        l = load4(shared, at + SUMS * warp + 3)
        total.inertia += wp.mat33(p[0], p[1], p[2], p[1], p[3], q[0], p[2], q[0], q[1])
        total.lag += wp.mat33(q[2], q[3], r[0], r[1], r[2], r[3], l[0], l[1], l[2])
    return total


@wp.func
def _axis(a: wp.mat33) -> wp.vec3:
    """The sum of x cross y, of a sum of x y^T."""
    return wp.vec3(a[1, 2] - a[2, 1], a[2, 0] - a[0, 2], a[0, 1] - a[1, 0])


@wp.func
def _rotation(t: wp.vec3) -> wp.mat33:
    """R - 1 of the rotation about t by 2 atan(|t| / 2) (Cayley)."""
    cross = wp.skew(t)
    return (cross + 0.5 * (cross * cross)) / (1.0 + 0.25 * wp.dot(t, t))


@wp.func
def rotation_of(sums: Sums) -> wp.mat33:
    """R - 1 of the rotation by which the rest shape turns; 0 of a rope that is straight."""
    rotation = wp.mat33(0.0)
    size = wp.trace(sums.inertia)
    if size > 1.0e-30:
        lag = sums.lag / size
        alike = sums.inertia / size - lag
        for _ in range(STEPS):
            # What is symmetric bears no torque, to the bit.
            turned = rotation * alike
            now = alike + turned
            about = (wp.trace(now) + 1.0e-6) * wp.identity(n=3, dtype=float) - 0.5 * (now + wp.transpose(now))
            t = wp.inverse(about) * _axis(turned - lag)
            t *= wp.min(1.0, LARGEST / wp.max(wp.length(t), 1.0e-9))
            change = _rotation(t)
            rotation += change + change * rotation
        # Newton's method may as well find where it is the farthest.
        if wp.trace(rotation * alike) < -1.0e-6 * wp.length(_axis(rotation)):
            rotation = wp.mat33(0.0)
    return rotation
