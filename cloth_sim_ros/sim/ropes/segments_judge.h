// SPDX-License-Identifier: Apache-2.0
// Compute displacements of particles, and events.
for (int begin = 0; begin <= n; begin += 4) {
    const int k = begin < n - 3 ? begin : n - 3;
    for (int axis = 0; axis < 3; ++axis) {
        const Four moved = at(WEIGHT, k) * (at(FORCE + axis, k + 1) - at(FORCE + axis, k));
        at(MOVED + axis, k) = lacking ? moved + at(MISSING + axis, k) : moved;
    }
}
int events = 0;
for (int begin = 0; begin < n; begin += 4) {
    const int k = begin < n - 4 ? begin : n - 4;
    Four change[3], direction[3];
    for (int axis = 0; axis < 3; ++axis) {
        change[axis] = at(MOVED + axis, k + 1) - at(MOVED + axis, k);
        direction[axis] = at(N + axis, k);
    }
    const Four along = dot(direction, change), reach = at(REACH, k), before = at(TURN, k);
    const Four turn = (dot(change, change) - along * along) / (reach * reach);
    const auto far = (turn > (double)largest_turn) & (turn > 2.0 * before);
    if (__builtin_reduce_or(far)) events |= TOO_FAR;
    if (__builtin_reduce_or(along * along > (double)overstretched * overstretched * reach * reach)) events |= OVERSTRETCHED;
    if (__builtin_reduce_or(0.5 * turn * reach > (double)settled)) events |= UNSETTLED;
    at(TURN, k) = turn > before ? turn : before;
}
return events;
