// SPDX-License-Identifier: Apache-2.0
// Move the particles by a share of their moves, and change the tensions and moments by as much. These come from the
// solve in double precision. The positions that float32 rounds would give other ones.
auto change_to = [&](float& from, double to) { from = share < 1.0f ? from + share * ((float)to - from) : (float)to; };
for (int k = first + t; k < count - 1; k += threads) {
    change_to(tensions.data[segments + k], row(k)[PULLED] * inverse_square);
    if (!bends || k > count - 3) continue;
    const double *at = row(k), *one = row(k) + MOVE, *two = row(k + 1) + MOVE, *three = row(k + 2) + MOVE;
    double turned[3], along = 0.0;
    for (int c = 0; c < 3; ++c) {
        turned[c] = at[BEHIND] * (three[c] - two[c]) - at[BEFORE] * (two[c] - one[c]);
        along += at[BEND + c] * turned[c];
    }
    const double more = at[SHARE] < 1.0 ? (1.0 - at[SHARE]) * along : 0.0;
    for (int c = 0; c < 3; ++c) {
        const double change = at[STIFF] * (at[SHARE] * turned[c] + more * at[BEND + c]);
        change_to(moments.data[segments + k][c], (at[MOMENT + c] + change) * inverse_square);
    }
}
struct Place { float v[4]; };
for (int i = first + t; i < count; i += threads) {
    for (int c = 0; c < 3; ++c) ((Place*)d)[i].v[c] += share * (float)row(i)[MOVE + c];
}
