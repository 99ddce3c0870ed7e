# SPDX-License-Identifier: Apache-2.0
"""Launches whose threads are all on the device at once, so that they can wait for one another in the middle.

One such launch replaces ten, as a barrier takes a GPU less than half as long as a launch. One block per multiprocessor
always fits, unless another kernel that waits for it runs at the same time. A CPU has one thread and no waiting.
"""

from collections.abc import Callable

import warp as wp

from cloth_sim_ros.sim.kernels.compiled import compiled

_BLOCK = 1024  # threads of a block; the compiler sees to it that their registers fit


@wp.struct
class CooperativeGroup:
    """Threads of `blocks` blocks of `block` threads that wait for one another. A launch may have several groups.

    They share their work in `teams` of `width` threads, whole warps. sharing: number of threads that share work of four
    parts, 1 on a CPU. arrived: (C,) blocks of each of C groups at its barrier.
    """

    blocks: int
    block: int
    width: int
    teams: int
    sharing: int
    arrived: wp.array(dtype=int)


@wp.func
def number_of(tid: int, group: CooperativeGroup) -> int:
    """Number of a thread in its group. Successive warps are in different blocks, so that all blocks have work."""
    block = tid / group.block
    warp = (tid - block * group.block) / 32
    return (warp * group.blocks + block % group.blocks) * 32 + tid % 32


# The first block of a group adds what turns the highest bit over once all others have come. So nobody resets the count.
@wp.func_native("""
#if defined(__CUDA_ARCH__)
__syncthreads();
if (threadIdx.x == 0) {
    unsigned* arrived = (unsigned*)group.arrived.data + blockIdx.x / group.blocks;
    const unsigned last = 0x80000000u, more = blockIdx.x % group.blocks == 0 ? last - (group.blocks - 1) : 1u;
    unsigned before, now;
    asm volatile("atom.add.acq_rel.gpu.global.u32 %0, [%1], %2;" : "=r"(before) : "l"(arrived), "r"(more) : "memory");
    do {
        asm volatile("ld.acquire.gpu.global.u32 %0, [%1];" : "=r"(now) : "l"(arrived) : "memory");
    } while (((before ^ now) & last) == 0);
}
__syncthreads();
#endif
""")
def sync_all(group: CooperativeGroup):
    """A barrier of all threads of a group, which see afterwards what any of them has stored before."""
    ...


cooperative: Callable[[Callable], wp.Kernel] = compiled(launch_bounds=_BLOCK)


def cooperative_group_of(worlds: int, device: wp.Device) -> CooperativeGroup:
    """Make one group of as many threads as fit on a device at once, for this many worlds."""
    if device.is_cpu:
        return _crew(1, 1, 1, 1, device)
    width = max(32, device.sm_count * _BLOCK // worlds // 32 * 32)
    return _crew(device.sm_count, _BLOCK, width, 1, device)


def cooperative_groups_of(bodies: int, blocks: int, block: int, device: wp.Device) -> CooperativeGroup:
    """Make as many groups of `blocks` blocks as fit the device, at most one per body.

    teams: the number of groups; each computes one body at a time.
    """
    groups = 1 if device.is_cpu else min(bodies, device.sm_count // blocks)
    return _crew(blocks, block, blocks * block, groups, device)


def _crew(blocks: int, block: int, width: int, groups: int, device: wp.Device) -> CooperativeGroup:
    group = CooperativeGroup()
    group.blocks, group.block, group.width = blocks, block, width
    group.teams = groups * blocks * block // width
    group.sharing = 1 if device.is_cpu else 4
    group.arrived = wp.zeros(groups, dtype=int, device=device)
    return group


def recorded(kernel: wp.Kernel, *inputs: object, group: CooperativeGroup, device: wp.Device) -> wp.Launch:
    """A launch of a cooperative kernel, whose last argument is the one group."""
    dim = group.blocks * group.block
    return wp.launch(kernel, dim=dim, inputs=[*inputs, group], device=device, block_dim=_BLOCK, record_cmd=True)
