# SPDX-License-Identifier: Apache-2.0
"""Segments of a chain and displacements of its particles, computed four at a time by one CPU thread.

This is the parallel part; the sequential part is in elimination.py.
"""

import warp as wp

from cloth_sim_ros.sim.kernels.native import on_cpu, source
from cloth_sim_ros.sim.ropes.elimination import PLANES

# Events that a linear solve cannot see: a segment turns too far, changes its length too much, or needs another solve.
TOO_FAR = wp.constant(1)
OVERSTRETCHED = wp.constant(2)
UNSETTLED = wp.constant(4)


def _code(file: str, otherwise: str = "", **constants: int) -> str:
    """Return C++ for a CPU, after the definition of a chain's planes."""
    return on_cpu(PLANES + source(__file__, "chain_fours", file, **constants), otherwise)


@wp.func_native(_code("segments_prepare", "return false;"))
def prepare_segments(
    particles: int,
    segments: int,
    n: int,
    x: wp.uint64,
    position_lo: wp.uint64,
    d: wp.uint64,
    rests: wp.array(dtype=float),
    tensions: wp.array(dtype=float),
    last_displacements: wp.array(dtype=wp.vec3),
    ladder: wp.array(dtype=wp.float64),
    compliance: float,
    gamma: float,
    effective: float,
    inverse_square: float,
    carries: bool,
    least: float,
    shortest: float,
) -> bool:
    """Fill the planes of the n segments from `segments` on; return True if all have a usable length.

    compliance: of the material [1/N]. gamma: dashpot time / h. carries: True if order 2 carries a part of the last
    displacement on.
    """
    ...


@wp.func_native(_code("segments_judge", "return 0;", TOO_FAR=TOO_FAR, OVERSTRETCHED=OVERSTRETCHED, UNSETTLED=UNSETTLED))
def judge_segments(
    particles: int,
    n: int,
    lacking: bool,
    ladder: wp.array(dtype=wp.float64),
    largest_turn: float,
    settled: float,
    overstretched: float,
) -> int:
    """Compute the displacements of particles by those forces, and return the events as bits."""
    ...


@wp.func_native(_code("segments_stiffen"))
def stiffen_segments(particles: int, n: int, ladder: wp.array(dtype=wp.float64)):
    """Stiffen segments that turned, in the directions across them; see segments.py."""
    ...


@wp.func_native(_code("segments_move"))
def move_particles(
    particles: int,
    segments: int,
    n: int,
    d: wp.uint64,
    tensions: wp.array(dtype=float),
    inverse_square: float,
    ladder: wp.array(dtype=wp.float64),
):
    """Move particles and update tensions."""
    ...


@wp.func_native(_code("segments_lack"))
def lack_more(particles: int, n: int, lacking: bool, ladder: wp.array(dtype=wp.float64)):
    """Update the missing displacement of particles after they were moved."""
    ...


@wp.func_native(
    on_cpu(PLANES + "for (int k = 0; k < 3; ++k) plane(MISSING + k)[i] = plane(WEIGHT)[i] > 0.0 ? missing[k] : 0.0;\n")
)
def lack(i: int, missing: wp.vec3, particles: int, n: int, ladder: wp.array(dtype=wp.float64)):
    """Store the vector from particle i to its place without the chain [m]."""
    ...
