# SPDX-License-Identifier: Apache-2.0
"""Lines of springs: arrays of a batch, and how many elements each has."""

import warp as wp

from cloth_sim_ros.sim.arrays.model import Counts, Features
from cloth_sim_ros.sim.kernels.native import LANES


def scratch_of(slots: int) -> int:
    """Floats that a CPU needs to solve rows of so many slots."""
    return 7 * LANES * slots + 16


# Array -> what it has a row of; cleared where a body is put elsewhere.
FORGOTTEN = {"line_multipliers": "line"}


@wp.struct
class LineState:
    """Lines of springs; see State for the letters."""

    line_multipliers: wp.array(dtype=float)  # (S,) h_e^2 x force [kg m] of the springs in the slots of lines
    line_slips: wp.array(dtype=float)  # (S,) rate at which they got longer behind their solve [m/s], order 2 alone
    tautness: wp.array(dtype=float)  # (N,) the largest tension of a line through a particle [N]
    line_scratch: wp.array(dtype=float)  # what a line is eliminated in, on a CPU


def sizes(features: Features, n: Counts) -> dict[str, int]:
    """Array -> its elements in one world; 0 where the features do not need it."""
    return {
        "line_multipliers": n.slots,
        "line_slips": n.slots if features.order == 2 else 0,
        "tautness": n.particles if n.slots else 0,
        "line_scratch": scratch_of(n.longest_row) if n.on_cpu else 0,
    }
