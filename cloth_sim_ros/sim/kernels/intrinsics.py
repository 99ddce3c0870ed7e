# SPDX-License-Identifier: Apache-2.0
"""Intrinsics that Warp lacks: wide loads, barriers, fast roots, and the memory of a body during a substep.

A body in a block keeps both in shared memory on a GPU; elsewhere they are plain device arrays. The
stages see an address and an index and cannot tell: the compiler infers the address space, and the loads are 16 bytes
wide.
"""

import warp as wp

from cloth_sim_ros.sim.kernels.native import on_cpu

BYTES_A_PARTICLE = 32  # one float4 of position, one of displacement and inverse mass


@wp.func_native("""
#if defined(__CUDA_ARCH__)
float4 f = ((const float4*)address)[i];
return wp::vec4(f.x, f.y, f.z, f.w);
#else
return ((const wp::vec4*)address)[i];
#endif
""")
def load4(address: wp.uint64, i: int) -> wp.vec4: ...


@wp.func_native(
    on_cpu("return (uint64_t)((const wp::vec4*)address + rows);", "return (uint64_t)((const float4*)address + rows);")
)
def beside(address: wp.uint64, rows: int) -> wp.uint64:
    """The address so many vec4 on; a constant number of them costs no instruction where it is read from."""
    ...


@wp.func_native("return *(const uint64_t*)address;")
def load_address(address: wp.uint64) -> wp.uint64:
    """The address that lies at an address."""
    ...


@wp.func_native("return ((const float*)address)[i];")
def load_number(address: wp.uint64, i: int) -> float: ...


@wp.func_native("return ((const int*)address)[i];")
def load_int(address: wp.uint64, i: int) -> int: ...


@wp.func_native(on_cpu("return __builtin_ctzll(bits);", "return __ffsll((long long)bits) - 1;"))
def lowest_bit(bits: wp.uint64) -> int:
    """The number of the lowest bit that is set; one is."""
    ...


@wp.func_native(on_cpu("((wp::vec4*)address)[i] = v;", "((float4*)address)[i] = make_float4(v[0], v[1], v[2], v[3]);"))
def store4(address: wp.uint64, i: int, v: wp.vec4): ...


@wp.func_native("""
#if defined(__CUDA_ARCH__)
int2 pair = ((const int2*)values.data)[i];
return wp::vec_t<2, wp::int32>(pair.x, pair.y);
#else
return values.data[i];
#endif
""")
def load_pair(values: wp.array(dtype=wp.vec2i), i: int) -> wp.vec2i: ...


# On a GPU the reciprocals come from the special function unit, refined once to about one unit in the last place. That
# is a third of the instructions of IEEE division and square root. Those would fill half of the projection of a spring.
@wp.func_native("""
#if defined(__CUDA_ARCH__)
float y;
asm("rsqrt.approx.ftz.f32 %0, %1;" : "=f"(y) : "f"(value));  // rsqrtf would first look for subnormal numbers
return fmaf(0.5f * y, fmaf(-value * y, y, 1.0f), y);
#else
return 1.0f / sqrtf(value);
#endif
""")
def inverse_root(value: float) -> float: ...


@wp.func_native(on_cpu("return a / b;", "return __fdividef(a, b);"))
def quotient(a: float, b: float) -> float: ...


# Correctly rounded like IEEE division, from a reciprocal that is at hand (Markstein 1990).
@wp.func_native("""
float q = a * inverse;
return fmaf(fmaf(-b, q, a), inverse, q);
""")
def divide(a: float, b: float, inverse: float) -> float: ...


@wp.func_native("""
#if defined(__CUDA_ARCH__)
return 0;
#elif defined(__x86_64__)
const unsigned mode = __builtin_ia32_stmxcsr();
__builtin_ia32_ldmxcsr(mode | 0x8040u);
return (int)mode;
#elif defined(__aarch64__)
uint64_t mode;
__asm__ volatile("mrs %0, fpcr" : "=r"(mode));
__asm__ volatile("msr fpcr, %0" : : "r"(mode | (1u << 24)));
return (int)mode;
#else
return 0;
#endif
""")
def flush_denormals() -> int:
    """Let this thread of a CPU take numbers below 1e-38 as 0, and return its mode before.

    A core takes a hundred times longer for an operation on them. They fill the resting axes of a body that moves in a
    plane, as a flat or a hanging sheet does.
    """
    ...


@wp.func_native("""
#if defined(__CUDA_ARCH__)
#elif defined(__x86_64__)
__builtin_ia32_ldmxcsr((unsigned)mode);
#elif defined(__aarch64__)
__asm__ volatile("msr fpcr, %0" : : "r"((uint64_t)(unsigned)mode));
#endif
""")
def restore_mode(mode: int):
    """Set the mode of this thread of a CPU, as `flush_denormals` returned it."""
    ...


@wp.func_native(on_cpu("", "__syncthreads();"))
def sync(): ...


@wp.func_native(on_cpu("", "__syncwarp();"))
def sync_warp():
    """A barrier of the 32 threads of a warp, which see afterwards what any of them has stored before."""
    ...


@wp.func_native("""
#if defined(__CUDA_ARCH__)
const unsigned four = 0xfu << (threadIdx.x % 32 & ~3u);
for (int way = 2; way > 0; way /= 2) {
    for (int k = 0; k < 3; ++k) v[k] += __shfl_xor_sync(four, v[k], way);
}
#endif
return v;
""")
def sum_of_four(v: wp.vec3) -> wp.vec3:
    """The sum over four threads that follow one another, the first a multiple of four; on a CPU v."""
    ...


# In units of 2^-44: whole numbers have the same sum in any order. More than one either way is cut off.
@wp.func_native("""
for (int k = 0; k < 3; ++k) {
    const double most = v[k] < -1.0f ? -1.0 : (v[k] > 1.0f ? 1.0 : v[k]);
    const int64_t units = (int64_t)(most * 17592186044416.0);
#if defined(__CUDA_ARCH__)
    atomicAdd((unsigned long long*)(sums.data + first + k), (unsigned long long)units);
#else
    sums.data[first + k] += units;
#endif
}
""")
def add_exactly(sums: wp.array(dtype=wp.int64), first: int, v: wp.vec3):
    """Add a vector of numbers up to 1 to three sums that do not depend on the order."""
    ...


@wp.func_native("""
wp::vec3 sum;
for (int k = 0; k < 3; ++k) sum[k] = (float)((double)sums.data[first + k] * 5.6843418860808015e-14);
return sum;
""")
def exact_sum(sums: wp.array(dtype=wp.int64), first: int) -> wp.vec3:
    """The sum that `add_exactly` accumulated."""
    ...


@wp.func_native("""
#if defined(__CUDA_ARCH__)
for (int way = 16; way > 0; way /= 2) {
    for (int k = 0; k < 3; ++k) v[k] = fminf(v[k], __shfl_xor_sync(0xffffffffu, v[k], way));
}
#endif
return v;
""")
def least_of_warp(v: wp.vec3) -> wp.vec3:
    """The least of each number over the 32 threads of a warp, the same in each; on a CPU v."""
    ...


@wp.func_native(on_cpu("return value ? 1 : 0;", "return __ballot_sync(0xffffffffu, value);"))
def ballot(value: bool) -> wp.uint64:
    """The values of the 32 threads of a warp as bits; on a CPU one bit."""
    ...


# One atomic for all threads of a warp that come together: 32 to one place take 32 times as long.
@wp.func_native("""
int* count = values.data + i;
#if defined(__CUDA_ARCH__)
const unsigned lane = threadIdx.x % 32;
const unsigned alike = __match_any_sync(__activemask(), (unsigned long long)count);
const unsigned leader = __ffs(alike) - 1;
int first = 0;
if (lane == leader) first = atomicAdd(count, __popc(alike));
return __shfl_sync(alike, first, leader) + __popc(alike & ((1u << lane) - 1));
#else
return (*count)++;
#endif
""")
def next_place(values: wp.array(dtype=int), i: int) -> int:
    """The count values[i] of a list, which grows by one: where the next item goes."""
    ...


@wp.func_native(on_cpu("return value;", "return __syncthreads_or(value);"))
def sync_any(value: int) -> int:
    """A barrier of a block; returns to all threads if the value of any was not 0."""
    ...


@wp.func_native("return (uint64_t)(values.data + offset);")
def array_address(values: wp.array(dtype=wp.vec4), offset: int) -> wp.uint64: ...


@wp.func
def load_row(values: wp.array(dtype=wp.vec4), i: int) -> wp.vec4:
    """values[i], of which Warp would load each number by itself."""
    return load4(array_address(values, 0), i)


@wp.func
def store_row(values: wp.array(dtype=wp.vec4), i: int, v: wp.vec4):
    """values[i] = v, by one store instead of four, of which each would touch all of it."""
    store4(array_address(values, 0), i, v)


@wp.func
def pack(v: wp.vec3, w: float) -> wp.vec4:
    return wp.vec4(v[0], v[1], v[2], w)


@wp.func
def xyz(v: wp.vec4) -> wp.vec3:
    """The first three of the four numbers that are loaded at a time."""
    return wp.vec3(v[0], v[1], v[2])


# Through a shuffle, or the compiler would compute the address anew, from a slow register, wherever it is used.
# Warp parses the declaration of a nested function only where no line of it is less indented.
_TILE_ADDRESS = """
#if defined(__CUDA_ARCH__)
unsigned address = __shfl_sync(0xffffffffu, (unsigned)__cvta_generic_to_shared(tile.data.ptr), 0);
return (uint64_t)__cvta_shared_to_generic(address);
#else
return (uint64_t)tile.data.ptr;
#endif
"""


def make_tile_address(capacity: int):
    """A Warp function: a shared tile of `capacity` vec4 -> the address of its first. For CUDA kernels alone."""

    @wp.func_native(_TILE_ADDRESS)
    def tile_address(tile: wp.tile[wp.vec4, capacity]) -> wp.uint64: ...

    return tile_address
