// SPDX-License-Identifier: Apache-2.0
// Layout of the scratch of a rope's Newton step, `NUMBERS` float64 for each particle, and for three more behind them.
// Symmetric matrices are six numbers: 00, 11, 22, 01, 02 and 12.
enum {
    // The segment behind a particle: unit vector, pull along it, stiffness along and across it, length, largest squared
    // turn so far, and its pull after the solve.
    NORMAL = 0, PULL = 3, ALONG, ACROSS, REACH, TURN, PULLED,
    // The joint that begins at a particle: inverse lengths of both segments, stiffness, its share across the turn vector
    // of a joint that is bent at rest, the unit turn vector, and the moment.
    BEFORE = PULLED + 1, BEHIND, STIFF, SHARE, BEND, MOMENT = BEND + 3,
    // A row of the matrix: its diagonal block, the blocks that couple it to the row before and to the one before that,
    // and its right side.
    DIAGONAL = MOMENT + 3, FIRST = DIAGONAL + 6, SECOND = FIRST + 6, RIGHT = SECOND + 6,
    // The row after elimination: its two blocks in L, the factors of its block in D, its right side, and the move.
    LOWER = RIGHT + 3, LOWEST = LOWER + 9, FACTORS = LOWEST + 9, DONE = FACTORS + 6, MOVE = DONE + 3,
    // An odd number, so that threads of a GPU that take a particle each use different banks of shared memory.
    NUMBERS = MOVE + 4,
};
double* area = scratch.data + (size_t)NUMBERS * (particles + 3 * body);
auto row = [&](int i) { return area + (size_t)NUMBERS * i; };
