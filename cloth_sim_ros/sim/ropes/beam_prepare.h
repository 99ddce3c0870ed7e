// SPDX-License-Identifier: Apache-2.0
// Fill the planes of joints and rows.
for (int which = STIFF; which < (BENT ? KNOWN + 3 : (int)MOVED); ++which) {
    if (which == STEPS) which = REST;
    double* place = plane(which);
    place[-2] = place[-1] = 0.0;
    for (int i = turns; i < count + 4; ++i) place[i] = 0.0;
}
for (int i = 0; i < count; ++i) plane(WEIGHT)[i] = displaced[i][3];
for (int i = 0; BENT && i < count; ++i) {
    for (int axis = 0; axis < 3; ++axis) plane(KNOWN + axis)[i] = moves.data[particles + i][axis];
}
const double square = (double)effective * effective;
for (int begin = 0; begin < turns; begin += 4) {
    const int j = begin < turns - 4 ? begin : turns - 4;
    const Row* joint = (const Row*)(joints.data + segments + j);
    const Four before = column(joint, 2), behind = column(joint, 3), middle = before + behind;
    const Four lightest = larger(at(WEIGHT, j), larger(at(WEIGHT, j + 1), at(WEIGHT, j + 2)));
    const Four yields = (double)compliance * column(joint, 1) / square;
    const Four stiff = 1.0 / larger(yields, lightest * middle * middle / (double)stiffest);
    Four turn[3];
    at(STIFF, j) = stiff;
    at(BEFORE, j) = before;
    at(BEHIND, j) = behind;
    if (BENT) {
        const Four rest = column(joint, 0);
        Row e[5];
        Four was[3], length = {};
        for (int s = 0; s < 5; ++s) e[s] = places[j + s + 1] - places[j + s];
        for (int axis = 0; axis < 3; ++axis) {
            was[axis] = column(e + 1, axis) * behind - column(e, axis) * before;
            length += was[axis] * was[axis];
        }
        const Four share = rest / larger(__builtin_elementwise_sqrt(length), Four(1.0e-9));
        for (int axis = 0; axis < 3; ++axis) at(REST + axis, j) = share * was[axis];
    }
    residual(j, turn);
    const float* moment = (const float*)(moments.data + segments + j);
    for (int axis = 0; axis < 3; ++axis) {
        const Four held = {moment[axis], moment[axis + 3], moment[axis + 6], moment[axis + 9]};
        at(CHANGE + axis, j) = stiff * turn[axis] - (BENT ? Four(0.0) : square * held);
    }
}
for (int begin = 0; begin < count; begin += 4) {
    const int i = begin < count - 4 ? begin : count - 4;
    // The joints that a particle begins, is the middle of, and ends.
    const Four first = at(BEFORE, i), middle = -(at(BEFORE, i - 1) + at(BEHIND, i - 1)), last = at(BEHIND, i - 2);
    const Four begun = at(STIFF, i) * first, near = at(STIFF, i - 1) * middle, far = at(STIFF, i - 2) * last;
    const Four w = at(WEIGHT, i);
    const auto one = (w > 0.0) & (at(WEIGHT, i - 1) > 0.0), two = (w > 0.0) & (at(WEIGHT, i - 2) > 0.0);
    at(DIAGONAL, i) = w > 0.0 ? 1.0 / w + (begun * first + near * middle + far * last) : Four(1.0);
    at(BELOW, i) = one ? near * at(BEFORE, i - 1) - far * (at(BEFORE, i - 2) + at(BEHIND, i - 2)) : Four(0.0);
    at(BEYOND, i) = two ? far * at(BEFORE, i - 2) : Four(0.0);
    for (int axis = 0; axis < 3; ++axis) {
        const double* change = plane(CHANGE + axis) + i;
        const Four pull = first * *(Four*)change + middle * *(Four*)(change - 1) + last * *(Four*)(change - 2);
        const Four inertia = BENT ? at(KNOWN + axis, i) / w : Four(0.0);
        at(PULL + axis, i) = w > 0.0 ? -pull - inertia : Four(0.0);
        if (BENT) {
            const double* rest = plane(REST + axis) + i;
            const Four turning = begun * *(Four*)rest + near * *(Four*)(rest - 1) + far * *(Four*)(rest - 2);
            at(PULL + 3 + axis, i) = w > 0.0 ? turning : Four(0.0);
        }
    }
}
if (rows > count) plane(DIAGONAL)[count] = 1.0;
