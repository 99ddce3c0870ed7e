// SPDX-License-Identifier: Apache-2.0
// Sum the inertia and then the lag of beam_rotation.py.
Four inertia[9] = {}, lag[9] = {};
auto add = [](const Four* a, const Four* b, Four* to) {
    for (int k = 0; k < 9; ++k) to[k] += a[k / 3] * b[k % 3];
};
for (int i = 0; i < count; i += 4) {
    const Four w = at(WEIGHT, i), mass = w > 0.0 ? 1.0 / w : Four(0.0);
    Four u[3], y[3], heavy[3];
    for (int axis = 0; axis < 3; ++axis) {
        u[axis] = at(KNOWN + axis, i) + at(MOVED + axis, i);
        y[axis] = at(MOVED + 3 + axis, i);
        heavy[axis] = mass * y[axis];
    }
    add(heavy, y, inertia);
    add(heavy, u, lag);
}
for (int j = 0; j < turns; j += 4) {
    const Four stiff = at(STIFF, j);
    Four z[3], strong[3], moment[3];
    for (int axis = 0; axis < 3; ++axis) {
        z[axis] = turned(MOVED + 3 + axis, j) - at(REST + axis, j);
        strong[axis] = stiff * z[axis];
        moment[axis] = at(CHANGE + axis, j) + stiff * turned(MOVED + axis, j);
    }
    add(strong, z, inertia);
    add(z, moment, lag);
}
wp::mat_t<6, 3, float> sums;
for (int k = 0; k < 9; ++k) {
    sums.data[k / 3][k % 3] = (float)(inertia[k][0] + inertia[k][1] + inertia[k][2] + inertia[k][3]);
    sums.data[3 + k / 3][k % 3] = (float)(lag[k][0] + lag[k][1] + lag[k][2] + lag[k][3]);
}
return sums;
