"""One launch a frame: a block (on the CPU, one thread) keeps a body of a world and runs all its substeps.

On a GPU positions and displacements stay in the block's shared memory for the whole frame, so a body may have at most
`capacity(device)` particles; on the CPU there is no limit. Blocks never wait for one another.
"""

import warp as wp

from cloth_sim_ros.sim.model import Features
from cloth_sim_ros.sim.schedules.native import BYTES_A_PARTICLE
from cloth_sim_ros.sim.schedules.resident_kernel import CELL_THREADS, bounds_for, make_frame
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
        staged = 0 if device.is_cpu else staged_cells(features, worlds[0], shared, block, shared_memory(device))
        kernel = make_frame(features, shared, block, shared_memory(device), staged)
        bodies = worlds[0].model.bodies.shape[0]
        self._launch = wp.launch(
            kernel,
            dim=len(worlds) * bodies * block,
            inputs=[gathered(worlds, device)],
            device=device,
            block_dim=block,
            record_cmd=True,
        )

    def advance(self, substeps: int, iterations: int) -> None:
        """Launch one frame; both numbers are read from the device's Frame, where they are already."""
        self._launch.launch()


def threads_for(features: Features, largest: int, bodies: int, device: wp.Device) -> int:
    """The threads of a block for a body of `largest` particles, one of so many at a time.

    A thread takes a segment of a rope, a particle of an explicit method, a spring of a colour, or a cell of a pass; of
    cells, which need many registers, two where there are many. Where every block has a multiprocessor to itself, cells
    leave threads over, which halve the time of what is done for every particle; more of them only wait at barriers.
    """
    if device.is_cpu:
        return 1
    work, most = -(-largest // 2), 1024
    if features.chain:
        work, most = largest - 1, THREADS
    elif features.method == "verlet":
        work = largest
    elif "cell" in features.constraints:
        alone = bodies <= device.sm_count
        work, most = max(128, -(-largest // (2 if alone else 4))), CELL_THREADS
    return min(most, -(-work // 32) * 32)


def staged_cells(features: Features, arrays: Arrays, particles: int, block: int, shared: int) -> int:
    """The records of cells that a block holds beside so many particles in `shared` bytes; 0 where they do not fit."""
    bodies = arrays.model.bodies.numpy()
    most = int((bodies["cells_end"] - bodies["cells"]).max())
    size = 16 * (3 * particles + most)
    return most if size <= shared // bounds_for(features, block)[1] else 0
