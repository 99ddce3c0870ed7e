# SPDX-License-Identifier: Apache-2.0
"""What executors that cut bodies into pieces share: the two buffers between which a launch takes its particles, and the
memory that a piece has."""

import warp as wp

from cloth_sim_ros.sim.executors.block import shared_memory
from cloth_sim_ros.sim.intrinsics import array_address
from cloth_sim_ros.sim.state import State

_ARENA = 1 << 18  # bytes of a CPU's stand-in for shared memory


def piece_memory(device: wp.Device) -> int:
    """Bytes in which a piece of a body has to find room."""
    return _ARENA if device.is_cpu else shared_memory(device)


@wp.struct
class Buffer:
    """One of the two buffers of what pieces exchange, as addresses."""

    positions: wp.uint64
    low: wp.uint64
    velocities: wp.uint64


def make_buffer_of(pieces):
    """A Warp function: the first or the second buffer of world w. The first is the state itself. The second lies in a
    struct of type `pieces` for all worlds behind one another."""

    @wp.func
    def buffer_of(s: State, cut: pieces, second: int, w: int) -> Buffer:
        found = Buffer()
        if second == 0:
            found.positions = array_address(s.positions, 0)
            found.low = array_address(s.low, 0)
            found.velocities = array_address(s.velocities, 0)
        else:
            first = w * s.positions.shape[0]
            found.positions = array_address(cut.positions, first)
            found.low = array_address(cut.low, first)
            found.velocities = array_address(cut.velocities, first)
        return found

    return buffer_of
