# SPDX-License-Identifier: Apache-2.0
"""Rotation of a bent rope's rest shape in a substep: one rotation for all of it, found together with displacements.

The rest vectors r point along the turn vectors before the substep. Turned by a rotation R, they give the energy of half
the sum of EI / span |kappa - R r|^2. It is nowhere below the energy from the lengths of kappa alone, and equal to it at
the start, with R = 1. So minimizing it together with inertia, over displacements and R, adds no energy to the rope
(majorization, Hunter and Lange 2004). At the best R, moments exert no torque as a whole: a free rope keeps its angular
momentum, and one that hangs by an end swings.

For any R the matrix of the solve is the same A = m + G^T (EI / span) G. Let u be the solution for R = 1, and A y =
G^T (EI / span) r. Bending then moves particles by u + (R - 1) y, in all solves of the substep together. R brings y
nearest to y - u and z = G y - r nearest to z - (kappa - r), weighted by masses and by EI / span (Procrustes:
Schoenemann 1966). Newton's method on the torque finds it. The sums have terms of one sign or as small as the motion. So
single precision resolves R - 1 as well as it resolves a displacement.
"""

import warp as wp

from cloth_sim_ros.sim.kernels.intrinsics import load4, store4, sum_of_warp, sync

SUMS = wp.constant(4)  # vec4 in which a warp hands on its sums
STEPS = wp.constant(2)  # steps of Newton's method
LARGEST = wp.constant(0.5)  # largest rotation of a step of Newton's method [rad]


@wp.struct
class Sums:
    """Sums over the particles and joints of a rope [kg m^2]."""

    inertia: wp.mat33  # sum of m y y^T and EI / span z z^T
    lag: wp.mat33  # sum of m y u^T and EI / span z (kappa - r)^T


@wp.func
def with_particle(sums: Sums, mass: float, u: wp.vec3, y: wp.vec3) -> Sums:
    """Add a particle, which bending moves by u + (R - 1) y if the rest shape turns by R."""
    sums.inertia += mass * wp.outer(y, y)
    sums.lag += mass * wp.outer(y, u)
    return sums


@wp.func
def with_joint(sums: Sums, stiff: float, z: wp.vec3, lack: wp.vec3) -> Sums:
    """Add a joint; `lack` is its turn vector minus its rest vector after particles moved by u."""
    sums.inertia += stiff * wp.outer(z, z)
    sums.lag += stiff * wp.outer(z, lack)
    return sums


@wp.func
def sums_of_block(t: int, threads: int, own: Sums, at: int, shared: wp.uint64) -> Sums:
    """Return the sums of all threads of a block, in the order of warps; shared memory is free from `at` on."""
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
    """Return the sum of x cross y, from a sum of x y^T."""
    return wp.vec3(a[1, 2] - a[2, 1], a[2, 0] - a[0, 2], a[0, 1] - a[1, 0])


@wp.func
def _rotation(t: wp.vec3) -> wp.mat33:
    """Return R - 1 of the rotation about t by 2 atan(|t| / 2) (Cayley)."""
    cross = wp.skew(t)
    return (cross + 0.5 * (cross * cross)) / (1.0 + 0.25 * wp.dot(t, t))


@wp.func
def rotation_of(sums: Sums) -> wp.mat33:
    """Return R - 1 of the rotation of the rest shape; 0 for a straight rope."""
    rotation = wp.mat33(0.0)
    size = wp.trace(sums.inertia)
    if size > 1.0e-30:
        lag = sums.lag / size
        alike = sums.inertia / size - lag
        for _ in range(STEPS):
            # The symmetric part exerts no torque, exactly.
            turned = rotation * alike
            now = alike + turned
            about = (wp.trace(now) + 1.0e-6) * wp.identity(n=3, dtype=float) - 0.5 * (now + wp.transpose(now))
            t = wp.inverse(about) * _axis(turned - lag)
            t *= wp.min(1.0, LARGEST / wp.max(wp.length(t), 1.0e-9))
            change = _rotation(t)
            rotation += change + change * rotation
        # Newton's method may also find the rotation of largest distance; then keep R = 1.
        if wp.trace(rotation * alike) < -1.0e-6 * wp.length(_axis(rotation)):
            rotation = wp.mat33(0.0)
    return rotation
