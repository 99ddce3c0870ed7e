// SPDX-License-Identifier: Apache-2.0
// Velocities and positions after a displacement, likewise.
for (int i = 0; i < count; i += LANES) {
    const auto pinned = at(X + 3, i) == 0.0f;
    for (int axis = 0; axis < 3; ++axis) {
        const Lanes x = at(X + axis, i), low = at(LOW + axis, i), total = at(D + axis, i);
        const Lanes sum = x + total;
        at(V + axis, i) = pinned ? Lanes(0.0f) : (total - low) / h;
        at(LOW + axis, i) = pinned ? low : total - (sum - x);
        at(X + axis, i) = pinned ? x : sum;
    }
}
