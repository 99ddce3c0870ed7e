"""One launch a frame: a block (on the CPU, one thread) keeps a body of a world and runs all its substeps.

On a GPU positions and displacements stay in the block's shared memory for the whole frame, so a body may have at most
`capacity(device)` particles; on the CPU there is no limit. Blocks never wait for one another.
"""

import warp as wp

from cloth_sim_ros.sim.model import Features
from cloth_sim_ros.sim.schedules.native import BYTES_A_PARTICLE
from cloth_sim_ros.sim.schedules.resident_kernel import make_frame
from cloth_sim_ros.sim.schedules.scan import THREADS, scan_size
from cloth_sim_ros.sim.state import Arrays, gathered

RESERVED = 2048  # bytes of a block's shared memory that Warp and the driver keep


def capacity(device: wp.Device, features: Features) -> int:
    """The most particles of a body that one block can hold."""
    if device.is_cpu:
        return 1 << 30
    spans = 16 * scan_size(THREADS) if features.chain else 0
    return (shared_memory(device) - spans) // BYTES_A_PARTICLE


def shared_memory(device: wp.Device) -> int:
    """Bytes of it that a block has to itself."""
    return 0 if device.is_cpu else device.max_shared_memory_per_block - RESERVED


class Resident:
    """The launch of one batch. `advance()` simulates one frame of every body in every world of it."""

    def __init__(self, features: Features, worlds: list[Arrays], device: wp.Device, largest: int, block: int):
        shared = 0 if device.is_cpu else -(-largest // 64) * 64
        kernel = make_frame(features, shared, block, shared_memory(device))
        bodies = worlds[0].model.bodies.shape[0]
        self._launch = wp.launch(
            kernel,
            dim=len(worlds) * bodies * block,
            inputs=[gathered(worlds, device)],
            device=device,
            block_dim=block,
            record_cmd=True,
        )

    def prepare(self, substeps: int, iterations: int) -> None:
        """Nothing: the launch is the same for all numbers."""

    def launches(self, substeps: int, iterations: int) -> list[wp.Launch]:
        """The launch of a frame."""
        return [self._launch]

    def advance(self, substeps: int, iterations: int, outer: int) -> None:
        """Launch one frame; the numbers are read from the device's Frame, where they are already."""
        self._launch.launch()


def threads_for(features: Features, largest: int, bodies: int, device: wp.Device) -> int:
    """The threads of a block for a body of `largest` particles, one of so many at a time.

    A thread takes a segment of a rope, a particle of an explicit method, or its slots of a row of lines. Where bodies
    share multiprocessors, half as many threads each wait less at barriers.
    """
    if device.is_cpu:
        return 1
    work, most = largest, 1024
    if features.chain:
        work, most = largest - 1, THREADS
    elif features.method == "xpbd":
        work = max(128, largest // features.line_slots // (1 if bodies <= device.sm_count else 2))
    return min(most, -(-work // 32) * 32)
