// SPDX-License-Identifier: Apache-2.0
// Between rows of four numbers in memory and vectors of eight lanes, a number each, in the registers of a CPU core.
typedef float Lanes __attribute__((ext_vector_type(8)));
typedef float Kept __attribute__((ext_vector_type(8), aligned(4)));
typedef float Row __attribute__((ext_vector_type(4), aligned(4)));
// Rows 0 and 4, 1 and 5, .. of x y z w to a vector for each of x, y, z, w; its own inverse.
auto transpose = [](const Lanes* from, Lanes* to) {
    const Lanes ab = __builtin_shufflevector(from[0], from[1], 0, 8, 1, 9, 4, 12, 5, 13);
    const Lanes AB = __builtin_shufflevector(from[0], from[1], 2, 10, 3, 11, 6, 14, 7, 15);
    const Lanes ce = __builtin_shufflevector(from[2], from[3], 0, 8, 1, 9, 4, 12, 5, 13);
    const Lanes CE = __builtin_shufflevector(from[2], from[3], 2, 10, 3, 11, 6, 14, 7, 15);
    to[0] = __builtin_shufflevector(ab, ce, 0, 1, 8, 9, 4, 5, 12, 13);
    to[1] = __builtin_shufflevector(ab, ce, 2, 3, 10, 11, 6, 7, 14, 15);
    to[2] = __builtin_shufflevector(AB, CE, 0, 1, 8, 9, 4, 5, 12, 13);
    to[3] = __builtin_shufflevector(AB, CE, 2, 3, 10, 11, 6, 7, 14, 15);
};
auto gather = [](uint64_t address, const int* at, Lanes* rows) {
    const Row* row = (const Row*)address;
    for (int k = 0; k < 4; ++k) {
        rows[k] = __builtin_shufflevector(row[at[k]], row[at[k + 4]], 0, 1, 2, 3, 4, 5, 6, 7);
    }
};
auto load = [&](uint64_t address, const int* at, Lanes* to) {
    Lanes rows[4];
    gather(address, at, rows);
    transpose(rows, to);
};
auto dot = [](const Lanes* a, const Lanes* b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; };
