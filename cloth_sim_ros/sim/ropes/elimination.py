# SPDX-License-Identifier: Apache-2.0
"""Two-sided elimination: one thread of a CPU solves a chain from both its ends at once, in double precision.

Elimination along a chain waits for one inverse after the other. Two of them, each in one half of a vector register,
take the time of one. Double precision costs a CPU nothing more. It needs neither the frames nor the scaled inverses by
which chain.py keeps the digits of float32.

The quantities are those of chain.py, in the world. An edge from i to j along n that pulls with H has the stiffness
g + kappa n n^T: g across it, g + kappa = 1 / alpha along it. Let particle i answer a force f with the displacement
q + Y f, and j alone, of inverse mass w, with p + w f. With W = Y + w and Q = (1 + g W)^-1

    P = g Q + kappa Q n n^T Q / (1 + kappa n.Q W n),
    f_0 = H + P (p - q - W H) + gap / alpha Q n / (1 + kappa n.Q W n)

are how the force in the edge follows both displacements, and that force; with a force F behind j it is f_0 + T F, where

    T = w P,    Y_j = w (1 - T),    q_j = p - w f_0.

Along a rigid edge T is 1 but for 1e-9 at least, of which double precision keeps seven digits. The way back hands on
forces, a product a segment, and displacements are what differences of forces do to each particle.
"""

import warp as wp

from cloth_sim_ros.sim.kernels.native import on_cpu, source
from cloth_sim_ros.sim.ropes.arrays import NUMBERS

FEWEST = 5  # segments: they, and the joints between them, are told of four at a time

PLANES = source(__file__, "chain_planes", NUMBERS=NUMBERS)


@wp.func_native(on_cpu(PLANES + source(__file__, "chain_elimination")))
def eliminate(particles: int, n: int, lacking: bool, ladder: wp.array(dtype=wp.float64)):
    """The forces in all n segments of a chain from what its planes say; on a GPU nothing.

    `lacking`: particles lie apart from where they would be without the chain.
    """
    ...
