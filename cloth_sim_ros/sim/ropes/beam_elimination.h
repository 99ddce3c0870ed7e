// SPDX-License-Identifier: Apache-2.0
// Compute the displacements of particles.
const int steps = rows / 2 - 1;
Two* kept = (Two*)plane(STEPS);
auto both = [&](int which, int i, int j) { return Two{plane(which)[i], plane(which)[j]}; };
struct Done { Two inverse, first, move[COLUMNS]; } one = {}, two = {};
for (int s = 0; s < steps; ++s) {
    const int i = s, j = rows - 1 - s;
    const Two beyond = both(BEYOND, i, j + 2), below = both(BELOW, i, j + 1) - beyond * one.first;
    const Two second = beyond * two.inverse;
    Done here;
    here.first = below * one.inverse;
    here.inverse = 1.0 / (both(DIAGONAL, i, j) - here.first * below - second * beyond);
    kept[(COLUMNS + 2) * s] = here.first;
    kept[(COLUMNS + 2) * s + 1] = second;
    for (int axis = 0; axis < COLUMNS; ++axis) {
        here.move[axis] = both(PULL + axis, i, j) - here.first * one.move[axis] - second * two.move[axis];
        kept[(COLUMNS + 2) * s + 2 + axis] = here.inverse * here.move[axis];
    }
    two = one;
    one = here;
}
// The two rows in the middle: from each end, one is the next row and the other the one after that.
const int i = steps, j = steps + 1;
const Two beyond = both(BEYOND, i, j + 2), below = both(BELOW, i, j + 1) - beyond * one.first;
const Two second = beyond * two.inverse, first = below * one.inverse;
const Two beyond_after = both(BEYOND, j, i + 2), second_after = beyond_after * one.inverse;
const Two next = first * below + second * beyond, after = second_after * beyond_after, across = beyond_after * first;
const Two diagonal = both(DIAGONAL, i, j) - next - after.yx;
const double beside = plane(BELOW)[j] - across[0] - across[1];
const double inverse = 1.0 / (diagonal[0] * diagonal[1] - beside * beside);
Two ahead[COLUMNS], last[COLUMNS];
for (int axis = 0; axis < COLUMNS; ++axis) {
    const Two near = first * one.move[axis] + second * two.move[axis], far = second_after * one.move[axis];
    const Two pull = both(PULL + axis, i, j) - near - far.yx;
    ahead[axis] = (diagonal.yx * pull - beside * pull.yx) * inverse;
    last[axis] = ahead[axis].yx;
    plane(MOVED + axis)[i] = ahead[axis][0];
    plane(MOVED + axis)[j] = ahead[axis][1];
}
Two to_next = first, to_after = second_after, to_next_after = second;
for (int s = steps - 1; s >= 0; --s) {
    for (int axis = 0; axis < COLUMNS; ++axis) {
        const Two move = kept[(COLUMNS + 2) * s + 2 + axis] - to_next * ahead[axis] - to_after * last[axis];
        last[axis] = ahead[axis];
        ahead[axis] = move;
        plane(MOVED + axis)[s] = move[0];
        plane(MOVED + axis)[rows - 1 - s] = move[1];
    }
    to_next = kept[(COLUMNS + 2) * s];
    to_after = to_next_after;
    to_next_after = kept[(COLUMNS + 2) * s + 1];
}
