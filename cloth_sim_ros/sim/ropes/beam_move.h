// SPDX-License-Identifier: Apache-2.0
// Move particles, turn the rest shape, and update moments.
auto rotate = [&](int which, int by, int i) {
    const Four v[3] = {at(by, i), at(by + 1, i), at(by + 2, i)};
    for (int axis = 0; axis < 3; ++axis) {
        const float* r = rotation.data[axis];
        at(which + axis, i) += v[0] * (double)r[0] + v[1] * (double)r[1] + v[2] * (double)r[2];
    }
};
for (int i = 0; BENT && i < count; i += 4) rotate(MOVED, MOVED + 3, i);
for (int j = 0; BENT && j < turns; j += 4) {
    for (int axis = 0; axis < 3; ++axis) at(CHANGE + axis, j) += at(STIFF, j) * at(REST + axis, j);
    rotate(REST, REST, j);
    for (int axis = 0; axis < 3; ++axis) at(CHANGE + axis, j) -= at(STIFF, j) * at(REST + axis, j);
}
for (int i = 0; i < count; ++i) {
    const double* move = plane(MOVED) + i;
    displaced[i] += Row{(float)move[0], (float)move[size], (float)move[2 * size], 0.0f};
    for (int axis = 0; BENT && axis < 3; ++axis) moves.data[particles + i][axis] += (float)move[axis * size];
}
for (int j = 0; j < turns; j += 4) {
    float* moment = (float*)(moments.data + segments + j);
    for (int axis = 0; axis < 3; ++axis) {
        const Four change = (at(CHANGE + axis, j) + at(STIFF, j) * turned(MOVED + axis, j)) * inverse_square;
        for (int s = 0; s < 4 && j + s < turns; ++s) {
            float* held = moment + 3 * s + axis;
            *held = (float)(change[s] + (BENT ? 0.0 : *held));
        }
    }
}
