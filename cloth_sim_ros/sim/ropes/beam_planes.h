// SPDX-License-Identifier: Apache-2.0
// Planes of numbers, in the memory of elimination.py, which is done by then. A joint has its stiffness, the inverse
// lengths before and after it, and the change of its moment. A particle has its inverse mass, row, pull and
// displacement. A step, from both ends side by side, has the couplings of a row to the two before it, and D^-1 times
// its pull. Each plane has two empty entries before the first and after the last. The elimination needs equally many
// steps from either end and two rows between. If one row is missing for that, an extra row is added that moves nothing.
// If rest is bent (beam_rotation.py), pulls and moves have three more columns, by which the rest shape turns. Then there
// are also the rest vector of each joint, and the earlier displacement of each particle by bending.
enum { STIFF, BEFORE, BEHIND, CHANGE, WEIGHT = 6, DIAGONAL, BELOW, BEYOND, PULL, COLUMNS = BENT ? 6 : 3,
    MOVED = PULL + COLUMNS, STEPS = MOVED + COLUMNS, REST = STEPS + 2 + COLUMNS + 1,
    KNOWN = REST + 3 };
typedef double Four __attribute__((ext_vector_type(4), aligned(8)));
typedef double Two __attribute__((ext_vector_type(2), aligned(8)));
typedef float Row __attribute__((ext_vector_type(4), aligned(4)));
double* numbers = ladder.data + (size_t)NUMBERS * particles;
const int size = count + 6, rows = count + count % 2, turns = count - 2;
auto plane = [&](int which) { return numbers + (size_t)which * size + 2; };
auto at = [&](int which, int i) -> Four& { return *(Four*)(plane(which) + i); };
const Row* places = (const Row*)x;
Row* displaced = (Row*)d;
auto column = [](const Row* from, int k) {
    return __builtin_convertvector(Row{from[0][k], from[1][k], from[2][k], from[3][k]}, Four);
};
auto larger = [](Four a, Four b) { return a > b ? a : b; };
// Changes of the turn vectors of four joints from j on by vectors of particles, and their turn minus rest vectors.
auto turned = [&](int which, int j) {
    const double* move = plane(which) + j;
    const Four first = *(Four*)(move + 1) - *(Four*)move, last = *(Four*)(move + 2) - *(Four*)(move + 1);
    return last * at(BEHIND, j) - first * at(BEFORE, j);
};
auto residual = [&](int j, Four* turn) {
    Row e[5];
    for (int s = 0; s < 5; ++s) e[s] = (places[j + s + 1] - places[j + s]) + (displaced[j + s + 1] - displaced[j + s]);
    for (int axis = 0; axis < 3; ++axis) {
        turn[axis] = column(e + 1, axis) * at(BEHIND, j) - column(e, axis) * at(BEFORE, j);
        if (BENT) turn[axis] -= at(REST + axis, j);
    }
};
