# SPDX-License-Identifier: Apache-2.0
"""Launches whose threads are all on the device at once, so that they can wait for one another in the middle.

What would be ten launches is one: a barrier takes a GPU less than half as long as a launch. A block a multiprocessor
always fits, as long as nothing else runs beside it that waits for it. A CPU has one thread, which waits for nobody.
"""

from collections.abc import Callable

import warp as wp

from cloth_sim_ros.sim.compiled import compiled

_BLOCK = 1024  # threads of a block; the compiler sees to it that their registers fit


@wp.struct
class Crew:
    """The threads of a launch, in `blocks`. They share the worlds in `teams` of `width`, whole warps.

    sharing: how many share what has four parts, 1 on a CPU. arrived: (1,) blocks at the barrier.
    """

    blocks: int
    width: int
    teams: int
    sharing: int
    arrived: wp.array(dtype=int)


@wp.func
def number_of(tid: int, crew: Crew) -> int:
    """The number of a thread. Warps that follow one another are in different blocks, so that all have work."""
    warp, lane = tid / 32, tid % 32
    warps = wp.static(_BLOCK // 32)
    return (warp % warps * crew.blocks + warp / warps) * 32 + lane


# The first block adds what turns the highest bit over once all others have come. So the count never has to be reset.
@wp.func_native("""
#if defined(__CUDA_ARCH__)
__syncthreads();
if (threadIdx.x == 0) {
    __threadfence();
    volatile unsigned* arrived = (volatile unsigned*)crew.arrived.data;
    const unsigned last = 0x80000000u;
    const unsigned before = atomicAdd((unsigned*)arrived, blockIdx.x == 0 ? last - (gridDim.x - 1) : 1u);
    while (((before ^ *arrived) & last) == 0) {}
    __threadfence();
}
__syncthreads();
#endif
""")
def sync_all(crew: Crew):
    """A barrier of all threads of a launch, which see afterwards what any of them has stored before."""
    ...


cooperative: Callable[[Callable], wp.Kernel] = compiled(launch_bounds=_BLOCK)


def crew_of(worlds: int, device: wp.Device) -> Crew:
    """As many threads as are on a device at once, for this many worlds."""
    crew = Crew()
    crew.blocks = 1 if device.is_cpu else device.sm_count
    threads = _threads(device)
    crew.width = 1 if device.is_cpu else max(32, threads // worlds // 32 * 32)
    crew.teams = threads // crew.width
    crew.sharing = 1 if device.is_cpu else 4
    crew.arrived = wp.zeros(1, dtype=int, device=device)
    return crew


def recorded(kernel: wp.Kernel, *inputs: object, crew: Crew, device: wp.Device) -> wp.Launch:
    """A launch of a cooperative kernel, whose last argument is the crew."""
    dim = _threads(device)
    return wp.launch(kernel, dim=dim, inputs=[*inputs, crew], device=device, block_dim=_BLOCK, record_cmd=True)


def _threads(device: wp.Device) -> int:
    return 1 if device.is_cpu else device.sm_count * _BLOCK
