// SPDX-License-Identifier: Apache-2.0
// Planes of numbers, in the room of elimination.py, which is done by then. Of every joint: its stiffness, the inverse
// lengths before and behind it, and by how much its moment is to change. Of every particle: inverse mass, row, pull and
// move. Of every step, from both ends side by side: what couples a row to the two before it, and D^-1 of its pull.
// Before the first and behind the last there are two places where nothing is. Where rows are one too few for
// eliminations of as many steps and two between them, one more is there, which moves nothing. Where rest is bent
// (beam_rotation.py), pulls and moves have three columns more, by which the rest shape turns. There are also the rest
// turn of every joint and by how much bending has moved every particle before.
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
// How vectors by particles turn four joints from j on, and what of their turn vectors rest is not.
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
