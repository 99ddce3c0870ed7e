# SPDX-License-Identifier: Apache-2.0
"""Lines of springs: arrays of a batch, and their sizes."""

import warp as wp

from cloth_sim_ros.sim.arrays.model import Counts, Features
from cloth_sim_ros.sim.kernels.native import LANES

# Array -> the element of each of its rows. These arrays are cleared if a body is placed elsewhere.
FORGOTTEN = {"line_multipliers": "line"}


@wp.struct
class LineState:
    """State of lines of springs; see State for the letters."""

    line_multipliers: wp.array(dtype=float)  # (S,) h_e^2 x force [kg m] of the springs in the slots of lines
    line_slips: wp.array(
        dtype=float
    )  # (S,) rate of elongation of springs right after their solve [m/s], order 2 or sewn
    line_defects: wp.array(dtype=float)  # (2 S,) q, then p, of defect correction [m], see solve.py; order 2
    bases: wp.array(dtype=wp.vec4)  # (N,) displacement that dashpots see as none [m], see physics/integrate.py
    tautness: wp.array(dtype=float)  # (N,) largest tension of a line through a particle [N]
    line_lengths: wp.array(dtype=float)  # (S,) rest lengths of a membrane's springs [m]
    line_scratch: wp.array(dtype=float)  # scratch of the elimination of a line, on a CPU


def sizes(features: Features, n: Counts) -> dict[str, int]:
    return {
        "line_multipliers": n.slots,
        "line_slips": n.slots if features.order == 2 or features.sewn else 0,
        "line_defects": 2 * n.slots if features.order == 2 else 0,
        "bases": n.particles if n.slots else 0,
        "tautness": n.particles if n.slots else 0,
        "line_lengths": n.slots if features.membrane else 0,
        "line_scratch": 7 * LANES * n.longest_row + 16 if n.on_cpu else 0,
    }
