# SPDX-License-Identifier: Apache-2.0
"""What a start far from rest needs before it is simulated."""

import numpy as np

from cloth_sim_ros.sim.topology import Topology

_NUDGE = 1e-5  # of the mean rest length of the springs
_TURNS = np.array([[1.93, -0.71, 0.37], [0.53, 2.11, -0.83], [-0.61, 0.47, 1.79]])  # even in no direction


def off_symmetry(topology: Topology, positions: np.ndarray) -> np.ndarray:
    """Positions (N, 3) [m], what is not pinned moved by at most a hundred-thousandth of a spring's length.

    A start may be a mirror image of itself, as a grid that is stretched or put inside out about its middle. It stays
    one to the bit, and may come to rest where nothing but the symmetry holds it. A cell in its middle is inside out
    then, its springs strained by half. The way is a smooth function of the place, so that what is in one place stays
    so.
    """
    spacing = np.concatenate([elements.rest for elements in topology.springs.values()]).mean()
    way = np.sin(positions / spacing @ _TURNS.T + [0.3, 1.1, 2.3])
    return np.where(topology.pinned[:, None], positions, positions + _NUDGE * spacing * way)
