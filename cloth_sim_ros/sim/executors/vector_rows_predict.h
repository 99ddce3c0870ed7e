// SPDX-License-Identifier: Apache-2.0
// The displacement of LANES particles at a time; behind vector_rows_planes.h.
const float* all_weights = (const float*)weights;
auto dot = [](const Lanes* a, const Lanes* b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; };
for (int i = 0; i < count; i += LANES) {
    Lanes x[3], low[3], v[3], force[3];
    for (int axis = 0; axis < 3; ++axis) {
        x[axis] = at(X + axis, i);
        low[axis] = at(LOW + axis, i);
        v[axis] = at(V + axis, i);
        force[axis] = 0.0f;
    }
    for (int q = 0; q < incident_count; ++q) {
        const int j = i + incident_springs.data[first + q][0];
        const float rest = rests.data[first + q][0], lost = rests.data[first + q][1];
        Lanes e[3];
        for (int axis = 0; axis < 3; ++axis) {
            e[axis] = (at(X + axis, j) - x[axis]) + (at(LOW + axis, j) - low[axis]);
        }
        const Lanes weight = *(const Lanes*)(all_weights + (size_t)q * size + i);
        const Lanes square = dot(e, e);
        const Lanes inverse = 1.0f / __builtin_elementwise_sqrt(__builtin_elementwise_max(square, Lanes(1.0e-24f)));
        Lanes pull = (1.0f - rest * inverse) - lost;
        if (damping > 0.0f) {
            Lanes apart[3];
            for (int axis = 0; axis < 3; ++axis) apart[axis] = at(V + axis, j) - v[axis];
            pull += damping * dot(e, apart) * inverse * inverse;
        }
        const Lanes share = (constants[incident_springs.data[first + q][1]] * weight) * pull;
        for (int axis = 0; axis < 3; ++axis) force[axis] += share * e[axis];
    }
    const Lanes w = at(X + 3, i);
    for (int axis = 0; axis < 3; ++axis) {
        Lanes a = gravity[axis] - drag * v[axis];
        a += w * force[axis];
        a *= first_share;
        const Lanes d = 0.0f + h * (v[axis] + (h * eased) * a);  // one rounding before the low part is added
        at(D + axis, i) = w == 0.0f ? low[axis] : d + low[axis];
    }
    at(D + 3, i) = w * eased;
}
