# SPDX-License-Identifier: Apache-2.0
"""What the segments of a chain are, and what its particles do, told of four at a time by one thread of a CPU.

That is what no segment waits for; the rest is elimination.py.
"""

import warp as wp

from cloth_sim_ros.sim.ropes.elimination import LANES, PLANES

# What a linear solve cannot tell of a motion: that a segment turns too far, changes its length too much, or had better
# be solved again.
TOO_FAR = wp.constant(1)
TEARS = wp.constant(2)
UNSETTLED = wp.constant(4)

_PLANES = PLANES + LANES

# The last four overlap those before.
_PREPARE = f"""
#if defined(__CUDA_ARCH__)
return false;
#else
{_PLANES}
const Row* rows = (const Row*)d;
for (int i = 0; i <= n; ++i) plane(WEIGHT)[i] = rows[i][3];
const Row *places = (const Row*)x, *lost = (const Row*)low;
const double square = (double)effective * effective;
bool lengths = true;
for (int begin = 0; begin < n; begin += 4) {{
    const int k = begin < n - 4 ? begin : n - 4;
    Row edges[4], changes[4];
    for (int s = 0; s < 4; ++s) {{
        changes[s] = rows[k + s + 1] - rows[k + s];
        edges[s] = (places[k + s + 1] - places[k + s]) + changes[s];
    }}
    Four e[3], direction[3];
    turn(edges, e);
    const Four length = __builtin_elementwise_sqrt(dot(e, e)), inverse = 1.0 / larger(length, Four(shortest));
    for (int axis = 0; axis < 3; ++axis) at(N + axis, k) = direction[axis] = e[axis] * inverse;
    const Four rest = __builtin_convertvector(*(const Row*)(rests.data + segments + k), Four);
    const Four t = square * __builtin_convertvector(*(const Row*)(tensions.data + segments + k), Four);
    const Four yields = (double)(compliance * inverse_square) * rest;
    Four gap = length - rest - yields * t;
    if (gamma > 0.0f) {{
        Four change[3];
        for (int s = 0; s < 4; ++s) changes[s] -= lost[k + s + 1] - lost[k + s];
        turn(changes, change);
        Four slip = elongation(e, change, length);
        if (carries) {{
            const auto* last = (const wp::vec3*)last_displacements.data + particles + k;
            for (int s = 0; s < 4; ++s) {{
                for (int axis = 0; axis < 3; ++axis) change[axis][s] = (last[s + 1][axis] - last[s][axis]) / 3.0f;
            }}
            slip -= dot(direction, change);
        }}
        gap += (double)gamma * slip;
    }}
    const double eased = 1.0 / (1.0 + gamma);
    const Four near = at(WEIGHT, k), far = at(WEIGHT, k + 1);
    const Four along = 1.0 / larger(yields * eased, larger(1.0e-9 * larger(near, far), Four(least)));
    const Four across = larger(t, Four(0.0)) / larger(length, 1.0e-3 * rest);
    const auto held = near + far == 0.0;  // nothing moves between two that are pinned
    at(G, k) = at(ACROSS, k) = held ? Four(0.0) : across;
    at(KAPPA, k) = held ? Four(0.0) : along - across;
    at(PUSH, k) = held ? Four(0.0) : along * gap * eased;
    at(HELD, k) = t;
    at(REACH, k) = larger(length, rest);
    at(TURN, k) = 0.0;
    lengths = lengths && __builtin_reduce_and(length >= (double)shortest);
}}
return lengths;
#endif
"""

_JUDGE = f"""
#if defined(__CUDA_ARCH__)
return 0;
#else
{_PLANES}
for (int begin = 0; begin <= n; begin += 4) {{
    const int k = begin < n - 3 ? begin : n - 3;
    for (int axis = 0; axis < 3; ++axis) {{
        const Four moved = at(WEIGHT, k) * (at(FORCE + axis, k + 1) - at(FORCE + axis, k));
        at(MOVED + axis, k) = lacking ? moved + at(MISSING + axis, k) : moved;
    }}
}}
int events = 0;
for (int begin = 0; begin < n; begin += 4) {{
    const int k = begin < n - 4 ? begin : n - 4;
    Four change[3], direction[3];
    for (int axis = 0; axis < 3; ++axis) {{
        change[axis] = at(MOVED + axis, k + 1) - at(MOVED + axis, k);
        direction[axis] = at(N + axis, k);
    }}
    const Four along = dot(direction, change), reach = at(REACH, k), before = at(TURN, k);
    const Four turn = (dot(change, change) - along * along) / (reach * reach);
    const auto far = (turn > (double)largest_turn) & (turn > 2.0 * before);
    if (__builtin_reduce_or(far)) events |= {TOO_FAR};
    if (__builtin_reduce_or(along * along > (double)torn * torn * reach * reach)) events |= {TEARS};
    if (__builtin_reduce_or(0.5 * turn * reach > (double)settled)) events |= {UNSETTLED};
    at(TURN, k) = turn > before ? turn : before;
}}
return events;
#endif
"""

_STIFFEN = f"""
#if !defined(__CUDA_ARCH__)
{_PLANES}
for (int k = 0; k < n; ++k) {{
    const double along = plane(G)[k] + plane(KAPPA)[k], turn = 0.25 * plane(TURN)[k];
    plane(G)[k] = plane(ACROSS)[k] + (turn < 1.0 ? turn : 1.0) * along;
    plane(KAPPA)[k] = along - plane(G)[k];
}}
#endif
"""

_MOVE = f"""
#if !defined(__CUDA_ARCH__)
{_PLANES}
for (int k = 0; k < n; ++k) {{
    const double *forces = plane(FORCE) + k + 1, *direction = plane(N) + k;
    double along = -plane(HELD)[k];
    for (int axis = 0; axis < 3; ++axis) along += direction[axis * size] * forces[axis * size];
    tensions.data[segments + k] += (float)(along * inverse_square);
}}
for (int i = 0; i <= n; ++i) {{
    const double* moved = plane(MOVED) + i;
    Row& row = ((Row*)d)[i];
    row += Row{{(float)moved[0], (float)moved[size], (float)moved[2 * size], 0.0f}};
}}
#endif
"""

_LACK = f"""
#if !defined(__CUDA_ARCH__)
{_PLANES}
for (int i = 0; i <= n; ++i) {{
    for (int axis = 0; axis < 3; ++axis) {{
        plane(MISSING + axis)[i] = (lacking ? plane(MISSING + axis)[i] : 0.0) - plane(MOVED + axis)[i];
    }}
}}
#endif
"""


@wp.func_native(_PREPARE)
def prepare_segments(
    particles: int,
    segments: int,
    n: int,
    x: wp.uint64,
    low: wp.uint64,
    d: wp.uint64,
    rests: wp.array(dtype=float),
    tensions: wp.array(dtype=float),
    last_displacements: wp.array(dtype=wp.vec3),
    ladder: wp.array(dtype=wp.float64),
    compliance: float,
    gamma: float,
    effective: float,
    inverse_square: float,
    carries: bool,
    least: float,
    shortest: float,
) -> bool:
    """Tell the planes of the n segments from `segments` on; whether all have a length to speak of.

    compliance: of material [1/N]; gamma: dashpot time / h; carries: whether a part of the last displacement goes on.
    """
    ...


@wp.func_native(_JUDGE)
def judge_segments(
    particles: int,
    n: int,
    lacking: bool,
    ladder: wp.array(dtype=wp.float64),
    largest_turn: float,
    settled: float,
    torn: float,
) -> int:
    """How particles are to move by those forces, and what a linear solve cannot tell of that: events."""
    ...


@wp.func_native(_STIFFEN)
def stiffen_segments(particles: int, n: int, ladder: wp.array(dtype=wp.float64)):
    """Segments that turned become stiffer across, see segments.py."""
    ...


@wp.func_native(_MOVE)
def move_particles(
    particles: int,
    segments: int,
    n: int,
    d: wp.uint64,
    tensions: wp.array(dtype=float),
    inverse_square: float,
    ladder: wp.array(dtype=wp.float64),
):
    """Particles are moved and tensions changed."""
    ...


@wp.func_native(_LACK)
def lack_more(particles: int, n: int, lacking: bool, ladder: wp.array(dtype=wp.float64)):
    """What particles lack after they were moved."""
    ...


@wp.func_native(f"""
#if !defined(__CUDA_ARCH__)
{_PLANES}
for (int axis = 0; axis < 3; ++axis) plane(MISSING + axis)[i] = plane(WEIGHT)[i] > 0.0 ? missing[axis] : 0.0;
#endif
""")
def lack(i: int, missing: wp.vec3, particles: int, n: int, ladder: wp.array(dtype=wp.float64)):
    """Tell how far particle i lies from where it would be without the chain [m]."""
    ...
