// SPDX-License-Identifier: Apache-2.0
// Fill the rows of the matrix and its right side; rows behind the last particle move nothing.
struct Place { float v[4]; };
const Place* moves = (const Place*)d;
// across I + along v v^T
auto fill = [](double across, double along, const double* v, double* to) {
    for (int c = 0; c < 6; ++c) {
        const int a = c < 3 ? c : (c == 5 ? 1 : 0), b = c < 3 ? c : (c == 3 ? 1 : 2);
        to[c] = along * v[a] * v[b] + (c < 3 ? across : 0.0);
    }
};
auto fill_edge = [&](int k, double* to) {  // the stiffness of segment k
    fill(row(k)[ACROSS], row(k)[ALONG] - row(k)[ACROSS], row(k) + NORMAL, to);
};
auto fill_joint = [&](int j, double* to) {  // the stiffness of joint j
    const double across = row(j)[STIFF] * row(j)[SHARE];
    fill(across, row(j)[SHARE] < 1.0 ? row(j)[STIFF] - across : 0.0, row(j) + BEND, to);
};
auto add = [](double weight, const double* m, double* to) {
    for (int c = 0; c < 6; ++c) to[c] += weight * m[c];
};
auto weight_of = [&](int j, int place) {
    const double before = row(j)[BEFORE], behind = row(j)[BEHIND];
    return place == 0 ? before : (place == 1 ? -(before + behind) : behind);
};
for (int i = first + t; i < count + 3; i += threads) {
    // The row is stored once at its end, as a GPU would wait for each number that is added to in memory.
    double to[6] = {}, one[6] = {}, two[6] = {}, right[3] = {};
    auto store = [&]() {
        double* place = row(i);
        for (int c = 0; c < 6; ++c) place[DIAGONAL + c] = to[c], place[FIRST + c] = one[c], place[SECOND + c] = two[c];
        for (int c = 0; c < 3; ++c) place[RIGHT + c] = right[c];
    };
    const double w = i < count ? moves[i].v[3] : 0.0;
    if (w == 0.0) {
        for (int c = 0; c < 3; ++c) to[c] = 1.0;
        store();
        continue;
    }
    const double mass = 1.0 / w;
    const bool after = i > first && moves[i - 1].v[3] > 0.0f, beyond = i > first + 1 && moves[i - 2].v[3] > 0.0f;
    const int g = particles + i;
    for (int c = 0; c < 3; ++c) {
        to[c] += mass;
        right[c] = mass * ((double)targets.data[g][c] - moves[i].v[c]);
    }
    if (pushes.shape[0] > 0) {
        const auto& hold = holds.data[g];
        const auto& start = starts.data[g];
        double moved[3];
        for (int c = 0; c < 3; ++c) moved[c] = (double)moves[i].v[c] - start[c];
        for (int c = 0; c < 3; ++c) {
            to[c] += mass * hold.data[c][c];
            right[c] += mass * pushes.data[g][c];
            for (int b = 0; b < 3; ++b) right[c] -= mass * hold.data[c][b] * moved[b];
        }
        to[3] += mass * hold.data[0][1];
        to[4] += mass * hold.data[0][2];
        to[5] += mass * hold.data[1][2];
    }
    double stiffness[6];
    if (i + 1 < count) {
        fill_edge(i, stiffness);
        add(1.0, stiffness, to);
        for (int c = 0; c < 3; ++c) right[c] += row(i)[PULL] * row(i)[NORMAL + c];
    }
    if (i > first) {
        fill_edge(i - 1, stiffness);
        add(1.0, stiffness, to);
        for (int c = 0; c < 3; ++c) right[c] -= row(i - 1)[PULL] * row(i - 1)[NORMAL + c];
        if (after) add(-1.0, stiffness, one);
    }
    // Colliders between particles; the point of segment k lies between i and i + 1, or i - 1 and i.
    for (int k = i - 1; between.shape[0] > 0 && k <= i; ++k) {
        if (k < first || k > count - 2) continue;
        const auto& point = between.data[segments + k].point;
        const auto& hold = between.data[segments + k].hold;
        const double own = point[i - k], beyond = point[1 - (i - k)];
        if (point[0] + point[1] == 0.0) continue;
        for (int c = 0; c < 3; ++c) {
            right[c] += own * between.data[segments + k].push[c];
            for (int b = 0; b < 3; ++b) {
                double moved = 0.0;
                for (int e = 0; e < 2; ++e) {
                    moved += point[e] * ((double)moves[k + e].v[b] - starts.data[particles + k + e][b]);
                }
                right[c] -= own * hold.data[c][b] * moved;
            }
        }
        for (int c = 0; c < 6; ++c) {
            const int a = c < 3 ? c : (c == 5 ? 1 : 0), b = c < 3 ? c : (c == 3 ? 1 : 2);
            const double rock = (double)point[2 + a] * point[2 + b];  // the point was found where the segment is now
            to[c] += own * own * hold.data[a][b] + rock;
            if (k < i && after) one[c] += own * beyond * hold.data[a][b] - rock;
        }
    }
    if (sewn.shape[0] > 0) {  // stitches; those of a segment couple its two particles
        const auto& here = sewn.data[g];
        auto take = [&](const auto& hold, int k) {
            for (int c = 0; c < 3; ++c) {
                for (int b = 0; b < 3; ++b) {
                    right[c] -= hold.data[c][b] * ((double)moves[k].v[b] - sewn.data[particles + k].start[b]);
                }
            }
        };
        for (int c = 0; c < 3; ++c) right[c] += here.pull[c];
        take(here.hold, i);
        if (i + 1 < count) take(here.beyond, i + 1);
        if (i > first) take(sewn.data[g - 1].beyond, i - 1);
        for (int c = 0; c < 6; ++c) {
            const int a = c < 3 ? c : (c == 5 ? 1 : 0), b = c < 3 ? c : (c == 3 ? 1 : 2);
            to[c] += here.hold.data[a][b];
            if (after) one[c] += sewn.data[g - 1].beyond.data[a][b];
        }
    }
    for (int place = 0; bends && place < 3; ++place) {
        const int j = i - place;
        if (j < first || j > count - 3) continue;
        const double own = weight_of(j, place);
        fill_joint(j, stiffness);
        add(own * own, stiffness, to);
        for (int c = 0; c < 3; ++c) right[c] -= own * row(j)[MOMENT + c];
        if (place > 0 && after) add(own * weight_of(j, place - 1), stiffness, one);
        if (place > 1 && beyond) add(own * weight_of(j, 0), stiffness, two);
    }
    store();
}
