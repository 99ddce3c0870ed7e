# SPDX-License-Identifier: Apache-2.0
"""What the segments of a chain are, and what its particles do, told of four at a time by one thread of a CPU.

That is what no segment waits for; the rest is elimination.py.
"""

import warp as wp

from cloth_sim_ros.sim.kernels.native import on_cpu, source
from cloth_sim_ros.sim.ropes.elimination import PLANES

# What a linear solve cannot tell of a motion: that a segment turns too far, changes its length too much, or had better
# be solved again.
TOO_FAR = wp.constant(1)
OVERSTRETCHED = wp.constant(2)
UNSETTLED = wp.constant(4)


def _code(file: str, otherwise: str = "", **constants: int) -> str:
    """C++ of a CPU, behind what the planes of a chain are."""
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
    """Tell the planes of the n segments from `segments` on; whether all have a length to speak of.

    compliance: of material [1/N]; gamma: dashpot time / h; carries: whether a part of the last displacement goes on.
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
    """How particles are to move by those forces, and what a linear solve cannot tell of that: events."""
    ...


@wp.func_native(_code("segments_stiffen"))
def stiffen_segments(particles: int, n: int, ladder: wp.array(dtype=wp.float64)):
    """Segments that turned become stiffer across, see segments.py."""
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
    """Particles are moved and tensions changed."""
    ...


@wp.func_native(_code("segments_lack"))
def lack_more(particles: int, n: int, lacking: bool, ladder: wp.array(dtype=wp.float64)):
    """What particles lack after they were moved."""
    ...


@wp.func_native(
    on_cpu(PLANES + "for (int k = 0; k < 3; ++k) plane(MISSING + k)[i] = plane(WEIGHT)[i] > 0.0 ? missing[k] : 0.0;\n")
)
def lack(i: int, missing: wp.vec3, particles: int, n: int, ladder: wp.array(dtype=wp.float64)):
    """Tell how far particle i lies from where it would be without the chain [m]."""
    ...
