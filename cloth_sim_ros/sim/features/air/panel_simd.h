// SPDX-License-Identifier: Apache-2.0
// Forces of the air on eight triangles at a time; needs simd.h before it.
for (int first = begin; first < end; first += LANES) {
    Lanes corners[3][4], speeds[3][4];
    for (int c = 0; c < 3; ++c) {
        int at[LANES];
        for (int lane = 0; lane < LANES; ++lane) {
            const int k = first + lane < end ? first + lane : end - 1;
            at[lane] = panels.data[k][c];
        }
        load(x, at, corners[c]);
        load(v, at, speeds[c]);
    }
    Lanes ab[3], ac[3], relative[3], force[4];
    Lanes speed = 0.0f;
    for (int axis = 0; axis < 3; ++axis) {
        ab[axis] = corners[1][axis] - corners[0][axis];
        ac[axis] = corners[2][axis] - corners[0][axis];
        relative[axis] = wind[axis] - (speeds[0][axis] + speeds[1][axis] + speeds[2][axis]) / 3.0f;
        speed += relative[axis] * relative[axis];
    }
    speed = __builtin_elementwise_sqrt(speed);
    const Lanes doubled[3] = {
        ab[1] * ac[2] - ab[2] * ac[1], ab[2] * ac[0] - ab[0] * ac[2], ab[0] * ac[1] - ab[1] * ac[0]
    };
    const Lanes size = __builtin_elementwise_sqrt(
        doubled[0] * doubled[0] + doubled[1] * doubled[1] + doubled[2] * doubled[2]
    );
    const Lanes inverse = size > 0.0f ? 1.0f / size : Lanes(0.0f);
    Lanes across = 0.0f;
    for (int axis = 0; axis < 3; ++axis) across += relative[axis] * doubled[axis] * inverse;
    const Lanes sine = speed > 0.0f ? across / speed : Lanes(0.0f);
    const Lanes rate = (0.25f / 3.0f * density) * size * (across < 0.0f ? -across : across);
    const Lanes along = rate * (drag - 2.0f * lift) * sine * sine, normal = rate * (2.0f * lift) * across * inverse;
    for (int axis = 0; axis < 3; ++axis) force[axis] = along * relative[axis] + normal * doubled[axis];
    force[3] = rate * (drag > 2.0f * lift ? drag : 2.0f * lift);
    Lanes rows[4];
    transpose(force, rows);
    Row* to = (Row*)(forces.data + first);
    for (int lane = 0; lane < LANES && first + lane < end; ++lane) {
        to[lane] = lane < 4 ? rows[lane].lo : rows[lane - 4].hi;
    }
}
return true;
