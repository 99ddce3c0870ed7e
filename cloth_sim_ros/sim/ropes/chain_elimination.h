// SPDX-License-Identifier: Apache-2.0
// Compute the forces in all segments. One elimination goes from the start on, the other from the end back, until one
// edge is left between them. If their numbers of steps differ, the second one pauses in the last step. Symmetric
// matrices are six numbers: 00, 11, 22, 01, 02 and 12.
const int back = (n - 1) / 2, ahead = n - 1 - back;
const Two way = {1.0, -1.0};
const Two zero = {}, one = 1.0;
Two* kept = (Two*)plane(STEPS);
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
// Pass the edges i and j. W: joint compliance of both particles of an edge. apart: their relative displacement without
// the pull H.
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
