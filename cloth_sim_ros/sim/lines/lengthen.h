// SPDX-License-Identifier: Apache-2.0
// Rest lengths of eight springs at a time, in the vector registers of a CPU core; needs simd.h before it.
for (int k = begin; k < end; k += LANES) {
    int own[LANES], at[4][LANES];  // slots; the particles i, j, p, q of membrane.py
    Lanes base, along;
    for (int lane = 0; lane < LANES; ++lane) {
        own[lane] = k + lane;
        at[0][lane] = nodes.data[k + lane];
        at[1][lane] = others.data[k + lane] < 0 ? at[0][lane] : others.data[k + lane];
        at[2][lane] = across.data[k + lane][0];
        at[3][lane] = across.data[k + lane][1];
        base[lane] = bases.data[k + lane][0];
        along[lane] = bases.data[k + lane][1];
    }
    Lanes place[4][4], rest_of_place[4][4], share[4];
    for (int c = 0; c < 4; ++c) {
        gather(x, at[c], place[c]);
        gather(lo, at[c], rest_of_place[c]);
    }
    load((uint64_t)shares.data, own, share);
    auto apart = [&](int a, int b) {
        Lanes rows[4], columns[4];
        for (int r = 0; r < 4; ++r) {
            rows[r] = (place[b][r] - place[a][r]) + (rest_of_place[b][r] - rest_of_place[a][r]);
        }
        transpose(rows, columns);
        return __builtin_elementwise_sqrt(dot(columns, columns));
    };
    const Lanes rest = *(const Kept*)(rests.data + k);
    Lanes length = base + along * apart(0, 1) + share[0] * apart(0, 2) + share[1] * apart(1, 2)
        + share[2] * apart(0, 3) + share[3] * apart(1, 3);
    length = rest + part * (length - rest);
    length = __builtin_elementwise_min(__builtin_elementwise_max(length, least * rest), most * rest);
    *(Kept*)(lengths.data + k) = rest < 0.0f ? rest : length;
}
return true;
