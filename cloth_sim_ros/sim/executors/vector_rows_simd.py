# SPDX-License-Identifier: Apache-2.0
"""Method verlet on a grid, many particles at a time in the vector registers of a CPU.

Every number of a particle has a plane of its own, in which particles lie one behind the other, row by row. The other
end of a spring is equally far away for all, so that nothing is gathered. At the border, where a spring is missing, one
of weight 0 goes to whatever lies there. Compilers do not find this by themselves.

The arithmetic is that of stages.py, term by term in the same order; which products and sums are rounded as one is the
compiler's choice.
"""

import warp as wp

from cloth_sim_ros.sim.native import LANES, on_cpu, source

# Where the planes of a number begin: position [m] and inverse mass [1/kg], low part [m], velocity [m/s], displacement
# [m] and effective inverse mass.
X, LOW, V, D = 0, 4, 7, 10
PLANES = 14
MOST = 32  # particles at a time, see vector_rows_planes.h
_KNOWN = {"LEAST": LANES, "MOST": MOST, "X": X, "LOW": LOW, "V": V, "D": D}


@wp.func_native(on_cpu(source(__file__, "vector_rows_planes", "vector_rows_predict", **_KNOWN)))
def predict_lanes(
    planes: wp.uint64,
    size: int,
    count: int,
    incident_springs: wp.array(dtype=wp.vec2i),
    rests: wp.array(dtype=wp.vec2),
    weights: wp.uint64,
    first: int,
    incident_count: int,
    constants: wp.vec3,
    damping: float,
    gravity: wp.vec3,
    drag: float,
    eased: float,
    first_share: float,
    h: float,
):
    """Every particle's displacement in a substep `h` by its springs (see rows.Planes), gravity and drag, see
    stages.make_predict.

    planes, weights: addresses of what belongs to the first particle; size: places of a plane.
    """
    ...


@wp.func_native(on_cpu(source(__file__, "vector_rows_planes", "vector_rows_finish", **_KNOWN)))
def finish_lanes(planes: wp.uint64, size: int, count: int, h: float):
    """Every particle's velocity and position after its displacement, see stages.make_finish."""
    ...


def _make_move(numbers: int, into: bool):
    """A Warp function: so many numbers of `count` particles go from rows of four into the planes from `plane` on, or
    back."""

    @wp.func_native(on_cpu(source(__file__, "vector_rows_move", NUMBERS=numbers, INTO=int(into))))
    def move(planes: wp.uint64, size: int, plane: int, count: int, address: wp.uint64): ...

    return move


read3, read4 = (_make_move(numbers, True) for numbers in (3, 4))
write3, write4 = (_make_move(numbers, False) for numbers in (3, 4))
