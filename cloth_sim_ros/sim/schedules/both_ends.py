"""The direct solve of a chain by one thread of a CPU: from both its ends at once, in double precision.

A walk along a chain waits for one inverse after the other. Two of them, each in one half of a vector register, take the
time of one; and in double precision, which costs a CPU nothing more, there is no need of the frames and of the scaled
inverses by which chain.py keeps the digits of float32. What no segment waits for is told of four at a time.

The quantities are those of chain.py, in the world. An edge from i to j along n that pulls with t has the stiffness
g + kappa n n^T: g across it, g + kappa = 1 / alpha along it. Let particle i answer a force f with the displacement
q + Y f, and j alone, of inverse mass w, with p + w f. With W = Y + w, Q = (1 + g W)^-1 and a = p - q - t W n,

    lambda = (kappa n.Q a + gap / alpha) / (1 + kappa n.Q W n),    f_0 = t n + Q (g a + lambda n)

is the force in the edge, and with a force F behind j it is f_0 + T F, where

    T = w Q (g + kappa n n^T Q / (1 + kappa n.Q W n)),    Y_j = w (1 - T),    q_j = p - w f_0.

Along a rigid edge T is 1 but for 1e-9 at least, of which double precision keeps seven digits. The way back hands on
forces, a product a segment, and displacements are what differences of forces do to each particle.
"""

import warp as wp

from cloth_sim_ros.sim.model import Body, Model
from cloth_sim_ros.sim.physics.distance import SHORTEST
from cloth_sim_ros.sim.physics.integrate import Step
from cloth_sim_ros.sim.schedules.segments import ATTEMPTS, LARGEST_TURN, NEWTON_STEPS, SETTLED_SPEED, STIFFEST, TORN
from cloth_sim_ros.sim.state import Material, State

FEWEST = 8  # segments: where there are fewer, a walk from one end takes no longer
# Planes of numbers, each as long as the chain: of every segment n, g, kappa, gap / alpha, t, length, what g is unless it
# turns, its largest turn so far and the force in it; of every particle how far it lies from where it would be without
# the chain, and how it is to move; and of every step of the walks, for both side by side, T and f_0.
NUMBERS = 2 * 28  # a particle: a plane is up to twice as long as there are particles

# What a linear solve cannot tell of a motion: that a segment turns too far, changes its length too much, or would rather
# be solved again.
TOO_FAR = wp.constant(1)
TEARS = wp.constant(2)
UNSETTLED = wp.constant(4)

_PLANES = f"""
enum {{ N = 0, G = 3, KAPPA, PUSH, T, REACH, ACROSS, TURN, MISSING, FORCE = 13, MOVED = 16, WALKS = 19 }};
enum {{ TOO_FAR = {TOO_FAR}, TEARS = {TEARS}, UNSETTLED = {UNSETTLED} }};
typedef double Four __attribute__((ext_vector_type(4), aligned(8)));
typedef float Row __attribute__((ext_vector_type(4), aligned(4)));
double* numbers = ladder.data + (size_t){NUMBERS} * particles;
const int size = n + 4;
auto plane = [&](int which) {{ return numbers + (size_t)which * size; }};
auto at = [&](int which, int i) -> Four& {{ return *(Four*)(plane(which) + i); }};
auto dot = [](const auto* a, const auto* b) {{ return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }};
const Row* rows = (const Row*)d;
"""

# Four segments at a time; the last four overlap those before.
_PREPARE = f"""
#if defined(__CUDA_ARCH__)
return false;
#else
{_PLANES}
const Row *places = (const Row*)x, *lost = (const Row*)low;
auto turn = [](const Row* from, Four* to) {{
    const Row ab = __builtin_shufflevector(from[0], from[1], 0, 4, 1, 5);
    const Row cd = __builtin_shufflevector(from[2], from[3], 0, 4, 1, 5);
    const Row AB = __builtin_shufflevector(from[0], from[1], 2, 6, 3, 7);
    const Row CD = __builtin_shufflevector(from[2], from[3], 2, 6, 3, 7);
    to[0] = __builtin_convertvector(__builtin_shufflevector(ab, cd, 0, 1, 4, 5), Four);
    to[1] = __builtin_convertvector(__builtin_shufflevector(ab, cd, 2, 3, 6, 7), Four);
    to[2] = __builtin_convertvector(__builtin_shufflevector(AB, CD, 0, 1, 4, 5), Four);
}};
auto larger = [](Four a, Four b) {{ return a > b ? a : b; }};
const double square = (double)effective * effective;
bool lengths = true;
for (int begin = 0; begin < n; begin += 4) {{
    const int k = begin < n - 4 ? begin : n - 4;
    Row edges[4], changes[4], near, far;
    for (int s = 0; s < 4; ++s) {{
        changes[s] = rows[k + s + 1] - rows[k + s];
        edges[s] = (places[k + s + 1] - places[k + s]) + changes[s];
        near[s] = rows[k + s][3];
        far[s] = rows[k + s + 1][3];
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
        Four change[3], before[3], sum[3];
        for (int s = 0; s < 4; ++s) changes[s] -= lost[k + s + 1] - lost[k + s];
        turn(changes, change);
        for (int axis = 0; axis < 3; ++axis) before[axis] = e[axis] - change[axis], sum[axis] = e[axis] + before[axis];
        Four slip = dot(sum, change) / (length + __builtin_elementwise_sqrt(dot(before, before)));
        if (carries) {{
            const auto* last = (const wp::vec3*)last_displacements.data + particles + k;
            for (int s = 0; s < 4; ++s) {{
                for (int axis = 0; axis < 3; ++axis) change[axis][s] = (last[s + 1][axis] - last[s][axis]) / parts;
            }}
            slip -= dot(direction, change);
        }}
        gap += (double)gamma * slip;
    }}
    const double eased = 1.0 / (1.0 + gamma);
    const Four w[2] = {{__builtin_convertvector(near, Four), __builtin_convertvector(far, Four)}};
    const Four along = 1.0 / larger(yields * eased, larger(1.0e-9 * larger(w[0], w[1]), Four(least)));
    const Four across = larger(t, Four(0.0)) / larger(length, 1.0e-3 * rest);
    const auto held = w[0] + w[1] == 0.0;  // nothing moves between two that are pinned
    at(G, k) = at(ACROSS, k) = held ? Four(0.0) : across;
    at(KAPPA, k) = held ? Four(0.0) : along - across;
    at(PUSH, k) = held ? Four(0.0) : along * gap * eased;
    at(T, k) = t;
    at(REACH, k) = larger(length, rest);
    at(TURN, k) = 0.0;
    lengths = lengths && __builtin_reduce_and(length >= (double)shortest);
}}
return lengths;
#endif
"""

# Of the two walks one goes from the start on, the other from the end back, until one edge is left between them. Where
# their steps are not as many, the second stays where it is in the last.
_WALK = f"""
#if !defined(__CUDA_ARCH__)
{_PLANES}
typedef double Two __attribute__((ext_vector_type(2), aligned(8)));
const int back = (n - 1) / 2, ahead = n - 1 - back;
const Two way = {{1.0, -1.0}};
Two* kept = (Two*)plane(WALKS);
auto both = [&](int which, int i, int j) {{ return Two{{plane(which)[i], plane(which)[j]}}; }};
auto weights = [&](int i, int j) {{ return Two{{rows[i][3], rows[j][3]}}; }};
auto missing = [&](int i, int j, int axis) {{
    const Two found = both(MISSING + axis, i, j);
    return weights(i, j) > 0.0 ? found : Two(0.0);
}};
// Symmetric matrices are six numbers: 00, 11, 22, 01, 02 and 12.
auto product = [](const Two* m, const Two* v, Two* to) {{
    to[0] = m[0] * v[0] + m[3] * v[1] + m[4] * v[2];
    to[1] = m[3] * v[0] + m[1] * v[1] + m[5] * v[2];
    to[2] = m[4] * v[0] + m[5] * v[1] + m[2] * v[2];
}};
struct Edge {{ Two force[3], passed[6]; }};  // f_0 and T / w
// The edges i and j, between particles that yield by W together and would move apart by `apart` but for the pull t.
auto pass = [&](int i, int j, const Two* W, const Two* apart) {{
    Edge edge;
    Two n[3], M[6], c[6], along[3], v[3], a[3];
    for (int axis = 0; axis < 3; ++axis) n[axis] = both(N + axis, i, j);
    const Two g = both(G, i, j), kappa = both(KAPPA, i, j), t = way * both(T, i, j);
    for (int k = 0; k < 6; ++k) M[k] = g * W[k] + (k < 3 ? 1.0 : 0.0);
    c[0] = M[1] * M[2] - M[5] * M[5];
    c[1] = M[0] * M[2] - M[4] * M[4];
    c[2] = M[0] * M[1] - M[3] * M[3];
    c[3] = M[4] * M[5] - M[3] * M[2];
    c[4] = M[3] * M[5] - M[4] * M[1];
    c[5] = M[3] * M[4] - M[0] * M[5];
    const Two determinant = M[0] * c[0] + M[3] * c[3] + M[4] * c[4], inverse = 1.0 / determinant;
    product(c, n, v);
    product(W, n, along);
    const Two eased = 1.0 / (determinant + kappa * dot(along, v));
    const Two spring = g * inverse, bar = (kappa * inverse) * eased, push = way * both(PUSH, i, j) * eased;
    edge.passed[0] = spring * c[0] + bar * (v[0] * v[0]);
    edge.passed[1] = spring * c[1] + bar * (v[1] * v[1]);
    edge.passed[2] = spring * c[2] + bar * (v[2] * v[2]);
    edge.passed[3] = spring * c[3] + bar * (v[0] * v[1]);
    edge.passed[4] = spring * c[4] + bar * (v[0] * v[2]);
    edge.passed[5] = spring * c[5] + bar * (v[1] * v[2]);
    for (int axis = 0; axis < 3; ++axis) a[axis] = apart[axis] - t * along[axis];
    product(edge.passed, a, edge.force);
    for (int axis = 0; axis < 3; ++axis) edge.force[axis] += t * n[axis] + push * v[axis];
    return edge;
}};
Two Y[6], q[3], W[6], apart[3], force[3];
for (int k = 0; k < 6; ++k) Y[k] = k < 3 ? weights(0, n) : Two(0.0);
for (int axis = 0; axis < 3; ++axis) q[axis] = lacking ? missing(0, n, axis) : Two(0.0);
for (int s = 0; s < ahead; ++s) {{
    const Two w = weights(s + 1, n - 1 - s), lone = {{Y[0][1], q[0][1]}};
    Two p[3];
    for (int axis = 0; axis < 3; ++axis) p[axis] = lacking ? missing(s + 1, n - 1 - s, axis) : Two(0.0);
    for (int k = 0; k < 6; ++k) W[k] = k < 3 ? Y[k] + w : Y[k];
    for (int axis = 0; axis < 3; ++axis) apart[axis] = p[axis] - q[axis];
    const Edge edge = pass(s, n - 1 - s, W, apart);
    for (int k = 0; k < 6; ++k) {{
        const Two yields = (k < 3 ? w : Two(0.0)) - w * w * edge.passed[k];
        kept[9 * s + k] = w * edge.passed[k];
        Y[k] = s < back ? yields : Two{{yields[0], Y[k][1]}};
    }}
    for (int axis = 0; axis < 3; ++axis) {{
        const Two moves = p[axis] - w * edge.force[axis];
        kept[9 * s + 6 + axis] = edge.force[axis];
        q[axis] = s < back ? moves : Two{{moves[0], q[axis][1]}};
    }}
}}
for (int k = 0; k < 6; ++k) W[k] = Y[k] + Y[k].yx;
for (int axis = 0; axis < 3; ++axis) apart[axis] = q[axis].yx - q[axis];
const Edge middle = pass(ahead, ahead, W, apart);
for (int axis = 0; axis < 3; ++axis) {{
    double* forces = plane(FORCE + axis);
    force[axis] = middle.force[axis];
    forces[0] = forces[n + 1] = 0.0;
    forces[ahead + 1] = force[axis][0];
}}
for (int s = ahead - 1; s >= 0; --s) {{
    Two behind[3];
    product(kept + 9 * s, force, behind);
    for (int axis = 0; axis < 3; ++axis) {{
        behind[axis] += kept[9 * s + 6 + axis];
        force[axis] = s < back ? behind[axis] : Two{{behind[axis][0], force[axis][1]}};
        plane(FORCE + axis)[s + 1] = force[axis][0];
        plane(FORCE + axis)[n - s] = -force[axis][1];
    }}
}}
#endif
"""

_JUDGE = f"""
#if defined(__CUDA_ARCH__)
return 0;
#else
{_PLANES}
for (int begin = 0; begin <= n; begin += 4) {{
    const int k = begin < n - 3 ? begin : n - 3;
    const Four w = {{rows[k][3], rows[k + 1][3], rows[k + 2][3], rows[k + 3][3]}};
    for (int axis = 0; axis < 3; ++axis) {{
        Four moved = w * (at(FORCE + axis, k + 1) - at(FORCE + axis, k));
        if (lacking) moved += w > 0.0 ? at(MISSING + axis, k) : Four(0.0);
        at(MOVED + axis, k) = moved;
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
    if (__builtin_reduce_or(far)) events |= TOO_FAR;
    if (__builtin_reduce_or(along * along > (double)torn * torn * reach * reach)) events |= TEARS;
    if (__builtin_reduce_or(0.5 * turn * reach > (double)settled)) events |= UNSETTLED;
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
    double along = -plane(T)[k];
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
        plane(MISSING + axis)[i] = lacking ? plane(MISSING + axis)[i] - plane(MOVED + axis)[i] : -plane(MOVED + axis)[i];
    }}
}}
#endif
"""


@wp.func_native(_PREPARE)
def _prepare(
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
    parts: float,
    least: float,
    shortest: float,
) -> bool:
    """Tell the planes of the n segments from `segments` on; whether all have a length to speak of.

    compliance: of material [1/N]; gamma: dashpot time / h; carries: whether a part of the last displacement goes on.
    """
    ...


@wp.func_native(_WALK)
def _walk(particles: int, n: int, d: wp.uint64, lacking: bool, ladder: wp.array(dtype=wp.float64)):
    """The forces in all segments; `lacking`: particles lie apart from where they would be without the chain."""
    ...


@wp.func_native(_JUDGE)
def _judge(
    particles: int,
    n: int,
    d: wp.uint64,
    lacking: bool,
    ladder: wp.array(dtype=wp.float64),
    largest_turn: float,
    settled: float,
    torn: float,
) -> int:
    """How particles are to move by those forces, and what a linear solve cannot tell of that: events."""
    ...


@wp.func_native(_STIFFEN)
def _stiffen(particles: int, n: int, d: wp.uint64, ladder: wp.array(dtype=wp.float64)):
    """Segments that turned become stiffer across, see segments.py."""
    ...


@wp.func_native(_MOVE)
def _move(
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
def _lack(particles: int, n: int, d: wp.uint64, lacking: bool, ladder: wp.array(dtype=wp.float64)):
    """What particles lack after they were moved."""
    ...


@wp.func_native(f"""
#if !defined(__CUDA_ARCH__)
{_PLANES}
for (int axis = 0; axis < 3; ++axis) plane(MISSING + axis)[i] = missing[axis];
#endif
""")
def lack(i: int, missing: wp.vec3, particles: int, n: int, d: wp.uint64, ladder: wp.array(dtype=wp.float64)):
    """Tell how far particle i lies from where it would be without the chain [m]."""
    ...


@wp.func
def prepare_both_ends(
    m: Model, s: State, body: Body, material: Material, step: Step, x: wp.uint64, low: wp.uint64, d: wp.uint64
) -> bool:
    """What the segments of a chain are as they lie; False where this is not a CPU, they are few or one has no length."""
    n = body.segments_end - body.segments
    if n < FEWEST or s.ladder.shape[0] == 0:
        return False
    return _prepare(
        body.particles,
        body.segments,
        n,
        x,
        low,
        d,
        m.segment_length,
        s.tensions,
        s.last_displacements,
        s.ladder,
        material.compliance[0],
        material.damping * step.inverse,
        step.effective,
        step.inverse_square,
        step.second and s.last_displacements.shape[0] > 0,
        step.parts,
        STIFFEST * body.yielding,
        SHORTEST,
    )


@wp.func
def solve_both_ends(
    m: Model, s: State, body: Body, material: Material, step: Step, x: wp.uint64, low: wp.uint64, d: wp.uint64
) -> bool:
    """Newton steps along a prepared chain until it is settled, see lines.py; whether it was torn."""
    n = body.segments_end - body.segments
    lacking = not step.first
    torn = bool(False)
    steps = int(0)
    again = bool(True)
    while again:
        if steps > 0:
            _lack(body.particles, n, d, lacking, s.ladder)
            lacking = True
            prepare_both_ends(m, s, body, material, step, x, low, d)
        events = int(TOO_FAR)
        attempt = int(0)
        while (events & TOO_FAR) != 0 and attempt < ATTEMPTS:
            if attempt > 0:
                _stiffen(body.particles, n, d, s.ladder)
            _walk(body.particles, n, d, lacking, s.ladder)
            settled = SETTLED_SPEED * step.effective
            events = _judge(body.particles, n, d, lacking, s.ladder, LARGEST_TURN, settled, TORN)
            torn = torn or (events & (TOO_FAR | TEARS)) != 0
            attempt += 1
        _move(body.particles, body.segments, n, d, s.tensions, step.inverse_square, s.ladder)
        steps += 1
        again = (events & UNSETTLED) != 0 and steps < NEWTON_STEPS
    return torn
