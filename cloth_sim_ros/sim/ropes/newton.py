# SPDX-License-Identifier: Apache-2.0
"""A Newton step of a whole rope: stretch, bending and what touches it, in one linear system (see solve.py).

A step minimizes, over the displacements u of all particles, the energy of BDF2 or implicit Euler in units of mass,

    sum m/2 |u - u~|^2 + sum C^2 / (2 alpha) + sum EI/(2 span) (|kappa| - rest)^2 + contacts.

u~ is the displacement by all other forces, C the elongation of a segment, alpha its compliance over h_e^2. kappa =
w1 e1 - w0 e0 is the turn vector of a joint between segments e0 and e1 of inverse lengths w0 and w1, the difference of
their unit tangents (Bergou et al. 2008, Discrete Elastic Rods). Its energy has the factor h_e^2, too.

The second derivative is kept positive: pressure softens a segment across, and less bending than at rest a joint, by no
more than the masses allow. A stiff segment keeps its tension from step to step, as in an
augmented Lagrangian. So a compliance of 0 has a finite matrix. Dashpots act on the growth of lengths and of |kappa|,
which a rotation leaves. Where twist tells how the material turns, they act on the change of kappa in the material.

The matrix has 3x3 blocks, each row coupled to the two before it. It is factored as L D L^T in double precision, from
both ends at once: in the two halves of a vector register of a CPU, or by two threads of a GPU.
"""

import warp as wp

from cloth_sim_ros.sim.features.twist.arrays import Twisted
from cloth_sim_ros.sim.kernels.native import source
from cloth_sim_ros.sim.ropes.arrays import NUMBERS, Between, Sewn

# Events that a linear solve cannot see: a segment turns too far, changes its length too much, or needs another step.
TOO_FAR = wp.constant(1)
OVERSTRETCHED = wp.constant(2)
UNSETTLED = wp.constant(4)


def _code(file: str) -> str:
    events = {"TOO_FAR": TOO_FAR, "OVERSTRETCHED": OVERSTRETCHED, "UNSETTLED": UNSETTLED}
    return source(__file__, "rows", file, **events) + f"static_assert(NUMBERS == {NUMBERS});\n"


@wp.func_native(_code("prepare"))
def prepare(
    t: int,
    threads: int,
    body: int,
    particles: int,
    segments: int,
    first: int,
    count: int,
    bends: bool,
    x: wp.uint64,
    position_lo: wp.uint64,
    d: wp.uint64,
    rests: wp.array(dtype=float),
    joints: wp.array(dtype=wp.vec4),
    tensions: wp.array(dtype=float),
    moments: wp.array(dtype=wp.vec3),
    bends_at_rest: wp.array(dtype=wp.vec3),
    twisted: wp.array(dtype=Twisted),
    last_displacements: wp.array(dtype=wp.vec3),
    scratch: wp.array(dtype=wp.float64),
    compliance: float,
    bend_compliance: float,
    gamma: float,
    bend_gamma: float,
    effective: float,
    carries: bool,
    least: float,
    shortest: float,
    stiffest: float,
    fed_segment: int,
    fed_length: float,
    fed: float,
):
    """Fill the segments and joints of a rope of `count` particles, from particle `first` on.

    compliance: 1/EA [1/N]. bend_compliance: 1/EI. gamma, bend_gamma: times of the dashpots over h_e. carries: True if
    order 2 carries a part of the last displacement on. least: smallest compliance of a segment in the matrix [1/kg];
    stiffest: largest ratio of a joint's stiffness to its lightest mass there.
    bends_at_rest: turns of joints at rest, of a rope with twist. twisted: how its segments turned about themselves.
    fed_segment: the one that a winch feeds, or -1; fed_length: its rest length, of which `fed` is new [m].
    """
    ...


@wp.func_native(_code("assemble"))
def assemble(
    t: int,
    threads: int,
    body: int,
    particles: int,
    first: int,
    count: int,
    bends: bool,
    d: wp.uint64,
    targets: wp.array(dtype=wp.vec3),
    starts: wp.array(dtype=wp.vec3),
    pushes: wp.array(dtype=wp.vec3),
    holds: wp.array(dtype=wp.mat33),
    segments: int,
    between: wp.array(dtype=Between),
    sewn: wp.array(dtype=Sewn),
    scratch: wp.array(dtype=wp.float64),
):
    """Fill the rows of the matrix; see RopeState for the arrays."""
    ...


@wp.func_native(_code("eliminate"))
def eliminate(
    t: int, body: int, particles: int, first: int, count: int, bends: bool, scratch: wp.array(dtype=wp.float64)
):
    """Compute the moves of all particles; threads wait for one another before and behind the middle."""
    ...


@wp.func_native(_code("judge"))
def judge(
    t: int,
    threads: int,
    body: int,
    particles: int,
    first: int,
    count: int,
    scratch: wp.array(dtype=wp.float64),
    largest_turn: float,
    settled: float,
    overstretched: float,
) -> int:
    """Compute the pulls after the solve, stiffen segments that turned too far, and return the events as bits."""
    ...


@wp.func_native(_code("move"))
def move(
    t: int,
    threads: int,
    body: int,
    particles: int,
    segments: int,
    first: int,
    count: int,
    bends: bool,
    d: wp.uint64,
    tensions: wp.array(dtype=float),
    moments: wp.array(dtype=wp.vec3),
    scratch: wp.array(dtype=wp.float64),
    inverse_square: float,
    share: float,
):
    """Move the particles by a `share` of their moves, and store the tensions and moments."""
    ...
