# SPDX-License-Identifier: Apache-2.0
"""Time integration in displacement form: the start and the end of a substep.

A substep solves for the displacement d = x_new - x, not for x_new, so that the velocity d/h keeps its precision when h
is small. Both orders share one form with the effective step h_e and a base displacement b:

    implicit Euler: h_e = h,    b = 0,         v* = v                        v_new = d / h
    BDF2:           h_e = 2h/3, b = d_prev/3,  v* = v + (v - v_prev)/3       v_new = (d - b) / h_e

and predict d~ = b + h_e v* + h_e^2 a, with compliances divided by h_e^2 (BDF2 solved for the displacement).
"""

import warp as wp

from cloth_sim_ros.sim.kernels.intrinsics import divide, quotient

_THIRD = wp.constant(1.0 / 3.0)


@wp.func
def effective_step(h: float, second: bool) -> float:
    """h_e [s] of a substep h [s]; `second` once two substeps of smooth history exist."""
    return wp.where(second, h - h / 3.0, h)


# Families of lines pull at a particle in turn. Beside a corner that a sheet hangs by, each would move it by more than a
# spring is long, and the next would find springs that point elsewhere. So such a particle gets heavier, until all of
# them move it by this share of the spacing. Its rest position stays, since all its forces scale alike. A particle that
# moves may be moved by a multiple of its own move, and by a larger multiple of the move by its weight, as in long
# substeps.
MOST_ASIDE, MOST_WAYS, MOST_WEIGHTS = wp.constant(0.02), wp.constant(2.0), wp.constant(20.0)

# A taut line moves a particle that lies beside it by 4 w h^2 T / l times as far, where T is its tension and l the
# length of its springs. Beyond 2 it swings to and fro ever farther, beyond 1 it comes out on the other side. A particle
# gets heavier until it does not: geometric stiffness as mass, after the same paper.
MOST_TAUT = wp.constant(0.25)
# Least share of an inverse mass that is kept. Unsatisfiable springs, such as rigid ones between pins that move apart,
# pull the more the heavier their particles are. With less, these would fly on as if they were free.
LEAST_SHARE = wp.constant(1.0e-3)
# These forces and tensions are looked at in the first substep of a frame, in every so many while a collider or handle
# moves, and behind each that was not smooth, as under a stroke.
WEIGHED = wp.constant(4)


@wp.func
def share_of_inverse_mass(aside: float, way: wp.vec3, fall: wp.vec3, spacing: float) -> float:
    """The share of an inverse mass to keep, if line families move a particle by `aside` [m].

    way, fall: the moves of the particle by its velocity and by all other forces [m].

    Mass that is added for stability does not change what is at rest (Andrews, Teichmann and Kry 2017, Geometric
    Stiffness for Real-time Constrained Multibody Dynamics). `aside` falls with h^2, and small ones add none.
    """
    most = MOST_ASIDE * spacing + MOST_WAYS * wp.length(way) + MOST_WEIGHTS * wp.length(fall)
    return wp.min(1.0, quotient(most, wp.max(aside, 1.0e-30)))


@wp.func
def split_sum(x: wp.vec3, d: wp.vec3) -> wp.vec3:
    """The part of x + d [m] that float32 loses (Fast2Sum, Dekker 1971); carried to the next substep."""
    total = x + d
    return d - (total - x)


@wp.struct
class Step:
    """One substep and iteration: h_e [s], 1/h_e, 1/h_e^2, and the state of the loop that projections depend on."""

    effective: float
    inverse: float
    inverse_square: float
    eased: float  # share of a velocity that linear drag leaves in a substep without wind
    second: bool  # a smooth substep lies behind this one
    first: bool  # first iteration: multipliers start from zero
    repeats: bool  # more iterations than one
    store: bool  # multipliers are read afterwards
    weighs: bool  # the effect of lines on particles is measured, see WEIGHED


@wp.func
def carried(change: wp.vec3) -> wp.vec3:
    """The third of the last displacement or change of velocity that order 2 carries on.

    It is a division, because a product would be fused with a sum in one place and not in the other. Their difference
    would push at every substep. It takes the inverse, since CUDA's own division takes a slow way for 0.
    """
    return wp.vec3(divide(change[0], 3.0, _THIRD), divide(change[1], 3.0, _THIRD), divide(change[2], 3.0, _THIRD))


@wp.func
def eased_by(rate: float, effective: float) -> float:
    """Share of a velocity that an implicit drag step of length `effective` [s] and `rate` [1/s] leaves."""
    return quotient(1.0, 1.0 + effective * rate)


@wp.func
def make_step(h: float, second: bool, order: int, drag: float) -> Step:
    """The part of a Step that lasts for the substep, under linear `drag` [1/s]; `second`: a smooth substep lies behind
    it."""
    step = Step()
    step.effective = effective_step(h, second and order == 2)
    step.inverse = 1.0 / step.effective
    step.inverse_square = step.inverse * step.inverse
    step.eased = eased_by(drag, step.effective)
    step.second = second
    return step
