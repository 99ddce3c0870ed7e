# SPDX-License-Identifier: Apache-2.0
"""A direct solve of a chain by one thread of a CPU walks it from both its ends at once, in double precision.

A walk along a chain waits for one inverse after the other. Two of them, each in one half of a vector register, take the
time of one. Double precision costs a CPU nothing more. It needs neither the frames nor the scaled inverses by which
chain.py keeps the digits of float32.

The quantities are those of chain.py, in the world. An edge from i to j along n that pulls with H has the stiffness
g + kappa n n^T: g across it, g + kappa = 1 / alpha along it. Let particle i answer a force f with the displacement
q + Y f, and j alone, of inverse mass w, with p + w f. With W = Y + w and Q = (1 + g W)^-1

    P = g Q + kappa Q n n^T Q / (1 + kappa n.Q W n),
    f_0 = H + P (p - q - W H) + gap / alpha Q n / (1 + kappa n.Q W n)

are how the force in the edge follows both displacements, and that force; with a force F behind j it is f_0 + T F, where

    T = w P,    Y_j = w (1 - T),    q_j = p - w f_0.

Along a rigid edge T is 1 but for 1e-9 at least, of which double precision keeps seven digits. The way back hands on
forces, a product a segment, and displacements are what differences of forces do to each particle.
"""

import warp as wp

NUMBERS = 2 * 37  # a particle: planes of the larger layout, each up to twice as long as there are particles
FEWEST = 5  # segments: they, and the joints between them, are told of four at a time

# Where planes begin, each as long as the chain. Of every segment: n, g, how far it reaches, g unless it turns and its
# largest turn so far, kappa, gap / alpha, how much H is along n, and its force. Of every particle: w, how far it lies
# from where it would be without the chain, and how it is to move. Of every step of the walks, for both side by side: T
# and f_0.
PLANES = f"""
enum {{
    N, G = N + 3, REACH, ACROSS, TURN, KAPPA, PUSH, HELD, WEIGHT, MISSING, MOVED = MISSING + 3, FORCE = MOVED + 3,
    WALKS = FORCE + 3
}};
typedef double Four __attribute__((ext_vector_type(4), aligned(8)));
typedef double Two __attribute__((ext_vector_type(2), aligned(8)));
typedef float Row __attribute__((ext_vector_type(4), aligned(4)));
double* numbers = ladder.data + (size_t){NUMBERS} * particles;
const int size = n + 4;
auto plane = [&](int which) {{ return numbers + (size_t)which * size; }};
auto at = [&](int which, int i) -> Four& {{ return *(Four*)(plane(which) + i); }};
"""

# Four at a time: rows to their columns, products, and how much longer an edge became (physics/distance.py).
LANES = """
auto turn = [](const Row* from, Four* to) {
    const Row ab = __builtin_shufflevector(from[0], from[1], 0, 4, 1, 5);
    const Row cd = __builtin_shufflevector(from[2], from[3], 0, 4, 1, 5);
    const Row AB = __builtin_shufflevector(from[0], from[1], 2, 6, 3, 7);
    const Row CD = __builtin_shufflevector(from[2], from[3], 2, 6, 3, 7);
    to[0] = __builtin_convertvector(__builtin_shufflevector(ab, cd, 0, 1, 4, 5), Four);
    to[1] = __builtin_convertvector(__builtin_shufflevector(ab, cd, 2, 3, 6, 7), Four);
    to[2] = __builtin_convertvector(__builtin_shufflevector(AB, CD, 0, 1, 4, 5), Four);
};
auto larger = [](Four a, Four b) { return a > b ? a : b; };
auto dot = [](const Four* a, const Four* b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; };
auto elongation = [&](const Four* e, const Four* change, Four length) {
    Four before[3], sum[3];
    for (int axis = 0; axis < 3; ++axis) before[axis] = e[axis] - change[axis], sum[axis] = e[axis] + before[axis];
    return dot(sum, change) / (length + __builtin_elementwise_sqrt(dot(before, before)));
};
"""

# Of the two walks one goes from the start on, the other from the end back, until one edge is left between them. Where
# their steps are not as many, the second stays where it is in the last. Symmetric matrices are six numbers: 00, 11, 22,
# 01, 02 and 12.
_WALK = """
const int back = (n - 1) / 2, ahead = n - 1 - back;
const Two way = {1.0, -1.0};
const Two zero = {}, one = 1.0;
Two* kept = (Two*)plane(WALKS);
auto both = [&](int which, int i, int j) { return Two{plane(which)[i], plane(which)[j]}; };
auto put = [&](int which, int i, Two from, int side, double sign) { plane(which)[i] = sign * from[side]; };
auto first_of = [](Two a, Two b) { return Two{a[0], b[1]}; };
auto swapped = [](Two a) { return a.yx; };
auto product = [](const Two* m, const Two* v, Two* to) {
    to[0] = m[0] * v[0] + m[3] * v[1] + m[4] * v[2];
    to[1] = m[3] * v[0] + m[1] * v[1] + m[5] * v[2];
    to[2] = m[4] * v[0] + m[5] * v[1] + m[2] * v[2];
};
struct Edge { Two force[3], passed[6]; };  // f_0 and P
// The edges i and j, between particles that yield by W together and would move apart by `apart` but for the pull H.
auto pass = [&](int i, int j, const Two* W, const Two* apart) {
    Edge edge;
    Two M[6], c[6], n[3], opened[3], v[3], a[3];
    for (int axis = 0; axis < 3; ++axis) n[axis] = both(N + axis, i, j);
    const Two g = both(G, i, j), kappa = both(KAPPA, i, j), t = way * both(HELD, i, j);
    for (int k = 0; k < 6; ++k) M[k] = W[k] * g + (k < 3 ? one : zero);
    c[0] = M[1] * M[2] - M[5] * M[5];
    c[1] = M[0] * M[2] - M[4] * M[4];
    c[2] = M[0] * M[1] - M[3] * M[3];
    c[3] = M[4] * M[5] - M[3] * M[2];
    c[4] = M[3] * M[5] - M[4] * M[1];
    c[5] = M[3] * M[4] - M[0] * M[5];
    const Two determinant = M[0] * c[0] + M[3] * c[3] + M[4] * c[4], inverse = 1.0 / determinant;
    product(c, n, v);
    product(W, n, opened);
    const Two bent = opened[0] * v[0] + opened[1] * v[1] + opened[2] * v[2];
    const Two eased = 1.0 / (determinant + kappa * bent);
    const Two spring = inverse * g, bar = (kappa * inverse) * eased, push = (both(PUSH, i, j) * way) * eased;
    edge.passed[0] = spring * c[0] + bar * (v[0] * v[0]);
    edge.passed[1] = spring * c[1] + bar * (v[1] * v[1]);
    edge.passed[2] = spring * c[2] + bar * (v[2] * v[2]);
    edge.passed[3] = spring * c[3] + bar * (v[0] * v[1]);
    edge.passed[4] = spring * c[4] + bar * (v[0] * v[2]);
    edge.passed[5] = spring * c[5] + bar * (v[1] * v[2]);
    for (int axis = 0; axis < 3; ++axis) a[axis] = apart[axis] - t * opened[axis];
    product(edge.passed, a, edge.force);
    for (int axis = 0; axis < 3; ++axis) edge.force[axis] = edge.force[axis] + (t * n[axis] + push * v[axis]);
    return edge;
};
Two Y[6], q[3], W[6], apart[3], p[3], force[3];
for (int k = 0; k < 6; ++k) Y[k] = k < 3 ? both(WEIGHT, 0, n) : zero;
for (int axis = 0; axis < 3; ++axis) q[axis] = lacking ? both(MISSING + axis, 0, n) : zero;
for (int s = 0; s < ahead; ++s) {
    const int i = s + 1, j = n - 1 - s;
    const Two w = both(WEIGHT, i, j), square = w * w;
    for (int axis = 0; axis < 3; ++axis) p[axis] = lacking ? both(MISSING + axis, i, j) : zero;
    for (int k = 0; k < 6; ++k) W[k] = k < 3 ? Y[k] + w : Y[k];
    for (int axis = 0; axis < 3; ++axis) apart[axis] = p[axis] - q[axis];
    const Edge edge = pass(s, j, W, apart);
    for (int k = 0; k < 6; ++k) {
        const Two yields = (k < 3 ? w : zero) - square * edge.passed[k];
        kept[9 * s + k] = w * edge.passed[k];
        Y[k] = s < back ? yields : first_of(yields, Y[k]);
    }
    for (int axis = 0; axis < 3; ++axis) {
        const Two moves = p[axis] - w * edge.force[axis];
        kept[9 * s + 6 + axis] = edge.force[axis];
        q[axis] = s < back ? moves : first_of(moves, q[axis]);
    }
}
for (int k = 0; k < 6; ++k) W[k] = Y[k] + swapped(Y[k]);
for (int axis = 0; axis < 3; ++axis) apart[axis] = swapped(q[axis]) - q[axis];
const Edge middle = pass(ahead, ahead, W, apart);
for (int axis = 0; axis < 3; ++axis) {
    force[axis] = middle.force[axis];
    put(FORCE + axis, 0, zero, 0, 1.0);
    put(FORCE + axis, ahead + 1, force[axis], 0, 1.0);
    put(FORCE + axis, n + 1, zero, 0, 1.0);
}
for (int s = ahead - 1; s >= 0; --s) {
    Two behind[3];
    product(kept + 9 * s, force, behind);
    for (int axis = 0; axis < 3; ++axis) {
        behind[axis] = behind[axis] + kept[9 * s + 6 + axis];
        force[axis] = s < back ? behind[axis] : first_of(behind[axis], force[axis]);
        put(FORCE + axis, s + 1, force[axis], 0, 1.0);
        put(FORCE + axis, n - s, force[axis], 1, -1.0);
    }
}
"""


@wp.func_native(f"\n#if !defined(__CUDA_ARCH__)\n{PLANES}{_WALK}\n#endif\n")
def walk(particles: int, n: int, lacking: bool, ladder: wp.array(dtype=wp.float64)):
    """The forces in all n segments of a chain from what its planes say; on a GPU nothing.

    `lacking`: particles lie apart from where they would be without the chain.
    """
    ...
