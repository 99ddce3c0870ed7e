# SPDX-License-Identifier: Apache-2.0
"""Method verlet on a grid, eight particles at a time in the vector registers of a CPU.

Every number of a particle has a plane of its own, in which particles lie one behind the other, row by row. The other
end of a spring is equally far away for all, so that nothing is gathered. At the border, where a spring is missing, one
of weight 0 goes to whatever lies there. Compilers do not find this by themselves.

The arithmetic is that of stages.py, term by term in the same order; which products and sums are rounded as one is the
compiler's choice.
"""

import warp as wp

from cloth_sim_ros.sim.simd import LANES

# Where the planes of a number begin: position [m] and inverse mass [1/kg], low part [m], velocity [m/s], displacement
# [m] and effective inverse mass.
X, LOW, V, D = 0, 4, 7, 10
PLANES = 14

_LANES = f"""
typedef float Lanes __attribute__((ext_vector_type({LANES}), aligned(4)));
float* numbers = (float*)planes;
auto at = [&](int plane, int i) -> Lanes& {{ return *(Lanes*)(numbers + (size_t)plane * size + i); }};
"""

_PREDICT = f"""
#if !defined(__CUDA_ARCH__)
{_LANES}
const float* all_weights = (const float*)weights;
auto dot = [](const Lanes* a, const Lanes* b) {{ return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }};
for (int i = 0; i < count; i += {LANES}) {{
    Lanes x[3], low[3], v[3], force[3];
    for (int axis = 0; axis < 3; ++axis) {{
        x[axis] = at({X} + axis, i);
        low[axis] = at({LOW} + axis, i);
        v[axis] = at({V} + axis, i);
        force[axis] = 0.0f;
    }}
    for (int q = 0; q < spoke_count; ++q) {{
        const int j = i + spokes.data[first + q][0];
        const float rest = rests.data[first + q][0], lost = rests.data[first + q][1];
        Lanes e[3];
        for (int axis = 0; axis < 3; ++axis) {{
            e[axis] = (at({X} + axis, j) - x[axis]) + (at({LOW} + axis, j) - low[axis]);
        }}
        const Lanes weight = *(const Lanes*)(all_weights + (size_t)q * size + i);
        const Lanes square = dot(e, e);
        const Lanes inverse = 1.0f / __builtin_elementwise_sqrt(__builtin_elementwise_max(square, Lanes(1.0e-24f)));
        Lanes pull = (1.0f - rest * inverse) - lost;
        if (damping > 0.0f) {{
            Lanes apart[3];
            for (int axis = 0; axis < 3; ++axis) apart[axis] = at({V} + axis, j) - v[axis];
            pull += damping * dot(e, apart) * inverse * inverse;
        }}
        const Lanes share = (constants[spokes.data[first + q][1]] * weight) * pull;
        for (int axis = 0; axis < 3; ++axis) force[axis] += share * e[axis];
    }}
    const Lanes w = at({X} + 3, i);
    for (int axis = 0; axis < 3; ++axis) {{
        Lanes a = gravity[axis] - drag * v[axis];
        a += w * force[axis];
        a *= first_share;
        const Lanes d = 0.0f + h * (v[axis] + (h * eased) * a);  // one rounding before the low part is added
        at({D} + axis, i) = w == 0.0f ? low[axis] : d + low[axis];
    }}
    at({D} + 3, i) = w * eased;
}}
#endif
"""

_FINISH = f"""
#if !defined(__CUDA_ARCH__)
{_LANES}
for (int i = 0; i < count; i += {LANES}) {{
    const auto pinned = at({X} + 3, i) == 0.0f;
    for (int axis = 0; axis < 3; ++axis) {{
        const Lanes x = at({X} + axis, i), low = at({LOW} + axis, i), total = at({D} + axis, i);
        const Lanes sum = x + total;
        at({V} + axis, i) = pinned ? Lanes(0.0f) : (total - low) / h;
        at({LOW} + axis, i) = pinned ? low : total - (sum - x);
        at({X} + axis, i) = pinned ? x : sum;
    }}
}}
#endif
"""

_MOVE = """
#if !defined(__CUDA_ARCH__)
float* __restrict numbers = (float*)planes + (size_t)plane * size;
float* __restrict particles = (float*)address;
for (int i = 0; i < count; ++i) {{
    for (int k = 0; k < {numbers}; ++k) {move};
}}
#endif
"""
_PARTICLE, _NUMBER = "particles[4 * i + k]", "numbers[(size_t)k * size + i]"


@wp.func_native(_PREDICT)
def predict_lanes(
    planes: wp.uint64,
    size: int,
    count: int,
    spokes: wp.array(dtype=wp.vec2i),
    rests: wp.array(dtype=wp.vec2),
    weights: wp.uint64,
    first: int,
    spoke_count: int,
    constants: wp.vec3,
    damping: float,
    gravity: wp.vec3,
    drag: float,
    eased: float,
    first_share: float,
    h: float,
):
    """Every particle's displacement in a substep `h` by its springs (see rows.Planes), gravity and drag, see
    stages.make_predict.

    planes, weights: addresses of what belongs to the first particle; size: places of a plane.
    """
    ...


@wp.func_native(_FINISH)
def finish_lanes(planes: wp.uint64, size: int, count: int, h: float):
    """Every particle's velocity and position after its displacement, see stages.make_finish."""
    ...


def _make_move(numbers: int, into: str, out_of: str):
    """A Warp function: so many numbers of `count` particles go from rows of four to the planes from `plane` on, or
    back."""

    @wp.func_native(_MOVE.format(numbers=numbers, move=f"{into} = {out_of}"))
    def move(planes: wp.uint64, size: int, plane: int, count: int, address: wp.uint64): ...

    return move


read3, read4 = (_make_move(numbers, _NUMBER, _PARTICLE) for numbers in (3, 4))
write3, write4 = (_make_move(numbers, _PARTICLE, _NUMBER) for numbers in (3, 4))
