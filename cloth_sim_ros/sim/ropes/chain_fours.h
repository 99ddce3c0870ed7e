// SPDX-License-Identifier: Apache-2.0
// Four at a time: transposition of rows, products, and the elongation of an edge (physics/distance.py).
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
