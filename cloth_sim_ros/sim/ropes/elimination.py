# SPDX-License-Identifier: Apache-2.0
"""Two-sided elimination: one CPU thread solves a chain from both its ends at once, in double precision.

Elimination along a chain is a sequence of dependent inverses. Two of them, each in one half of a vector register, take
the time of one. Double precision costs a CPU nothing more. It needs neither the frames nor the scaled inverses with
which chain.py keeps the digits of float32.

The quantities are those of chain.py, in world axes. An edge from i to j along n that pulls with H has the stiffness
g + kappa n n^T: g across it, g + kappa = 1 / alpha along it. Let particle i answer a force f with the displacement
q + Y f, and j alone, of inverse mass w, with p + w f. With W = Y + w and Q = (1 + g W)^-1

    P = g Q + kappa Q n n^T Q / (1 + kappa n.Q W n),
    f_0 = H + P (p - q - W H) + gap / alpha Q n / (1 + kappa n.Q W n)

are the derivative of the force in the edge by both displacements, and that force. A force F after j makes it f_0 + T F,
with

    T = w P,    Y_j = w (1 - T),    q_j = p - w f_0.

Along a rigid edge, T differs from 1 by at least 1e-9, of which double precision keeps seven digits. The way back
propagates forces, one product a segment. Differences of forces then give the displacement of each particle.
"""

import warp as wp

from cloth_sim_ros.sim.kernels.native import on_cpu, source
from cloth_sim_ros.sim.ropes.arrays import NUMBERS

FEWEST = 5  # smallest number of segments: these, and the joints between them, are processed four at a time

PLANES = source(__file__, "chain_planes", NUMBERS=NUMBERS)


@wp.func_native(on_cpu(PLANES + source(__file__, "chain_elimination")))
def eliminate(particles: int, n: int, lacking: bool, ladder: wp.array(dtype=wp.float64)):
    """Compute the forces in all n segments of a chain from its planes; do nothing on a GPU.

    lacking: True if particles are away from their places without the chain.
    """
    ...
