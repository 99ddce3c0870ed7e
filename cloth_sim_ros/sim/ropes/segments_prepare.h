// SPDX-License-Identifier: Apache-2.0
// Fill the planes of segments; the last four overlap those before.
const Row* rows = (const Row*)d;
for (int i = 0; i <= n; ++i) plane(WEIGHT)[i] = rows[i][3];
const Row *places = (const Row*)x, *lost = (const Row*)position_lo;
const double square = (double)effective * effective;
bool lengths = true;
for (int begin = 0; begin < n; begin += 4) {
    const int k = begin < n - 4 ? begin : n - 4;
    Row edges[4], changes[4];
    for (int s = 0; s < 4; ++s) {
        changes[s] = rows[k + s + 1] - rows[k + s];
        edges[s] = (places[k + s + 1] - places[k + s]) + changes[s];
    }
    Four e[3], direction[3];
    turn(edges, e);
    const Four length = __builtin_elementwise_sqrt(dot(e, e)), inverse = 1.0 / larger(length, Four(shortest));
    for (int axis = 0; axis < 3; ++axis) at(N + axis, k) = direction[axis] = e[axis] * inverse;
    const Four rest = __builtin_convertvector(*(const Row*)(rests.data + segments + k), Four);
    const Four t = square * __builtin_convertvector(*(const Row*)(tensions.data + segments + k), Four);
    const Four yields = (double)(compliance * inverse_square) * rest;
    Four gap = length - rest - yields * t;
    if (gamma > 0.0f) {
        Four change[3];
        for (int s = 0; s < 4; ++s) changes[s] -= lost[k + s + 1] - lost[k + s];
        turn(changes, change);
        Four slip = elongation(e, change, length);
        if (carries) {
            const auto* last = (const wp::vec3*)last_displacements.data + particles + k;
            for (int s = 0; s < 4; ++s) {
                for (int axis = 0; axis < 3; ++axis) change[axis][s] = (last[s + 1][axis] - last[s][axis]) / 3.0f;
            }
            slip -= dot(direction, change);
        }
        gap += (double)gamma * slip;
    }
    const double eased = 1.0 / (1.0 + gamma);
    const Four near = at(WEIGHT, k), far = at(WEIGHT, k + 1);
    const Four along = 1.0 / larger(yields * eased, larger(1.0e-9 * larger(near, far), Four(least)));
    const Four across = larger(t, Four(0.0)) / larger(length, 1.0e-3 * rest);
    const auto held = near + far == 0.0;  // nothing moves between two pinned particles
    at(G, k) = at(ACROSS, k) = held ? Four(0.0) : across;
    at(KAPPA, k) = held ? Four(0.0) : along - across;
    at(PUSH, k) = held ? Four(0.0) : along * gap * eased;
    at(HELD, k) = t;
    at(REACH, k) = larger(length, rest);
    at(TURN, k) = 0.0;
    lengths = lengths && __builtin_reduce_and(length >= (double)shortest);
}
return lengths;
