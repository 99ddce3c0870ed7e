// SPDX-License-Identifier: Apache-2.0
// Fill the segments and joints from particle `first` on. Pressure softens a segment across, and less bending than at
// rest does so to a joint, but by no more than a share of what the masses add: the matrix stays positive.
struct Place { float v[4]; };
const Place *places = (const Place*)x, *moves = (const Place*)d, *lost = (const Place*)position_lo;
// A division takes as long as ten products, so those by the same number are done once.
const double square = (double)effective * effective, inverse_square = 1.0 / square, third = 1.0 / 3.0;
const double softest = 1.0 / (double)stiffest, eased = 1.0 / (1.0 + gamma), bend_eased = 1.0 / (1.0 + bend_gamma);
// Vector from particle i to the next [m], its change in this substep, and what order 2 carries on of the last change.
struct Edge { double now[3], change[3], carried[3]; };
const bool damped = gamma > 0.0f || bend_gamma > 0.0f;
auto edge_of = [&](int i) {
    Edge edge = {};
    for (int c = 0; c < 3; ++c) {
        const double moved = (double)moves[i + 1].v[c] - moves[i].v[c];
        edge.now[c] = ((double)places[i + 1].v[c] - places[i].v[c]) + moved;
        if (!damped) continue;
        edge.change[c] = moved - ((double)lost[i + 1].v[c] - lost[i].v[c]);
        if (!carries) continue;
        const auto* last = last_displacements.data + particles + i;
        edge.carried[c] = ((double)last[1][c] - last[0][c]) * third;
    }
    return edge;
};
// How much longer a vector of length `size` became, less a third of that in the last substep under order 2; 0 for a
// rotation.
auto growth_of = [&](const Edge& edge, double size) {
    double square = 0.0, last_square = 0.0, product = 0.0, last_product = 0.0;
    for (int c = 0; c < 3; ++c) {
        const double was = edge.now[c] - edge.change[c], moved = 3.0 * edge.carried[c], before = was - moved;
        square += was * was;
        last_square += before * before;
        product += (edge.now[c] + was) * edge.change[c];
        last_product += (was + before) * moved;
    }
    const double sum = size + sqrt(square), last_sum = sqrt(square) + sqrt(last_square);
    return (sum > 0.0 ? product / sum : 0.0) - (last_sum > 0.0 ? third * last_product / last_sum : 0.0);
};
// A turn vector of before, carried along in the material: turned as little as takes the sum of tangents `was` to `now`,
// then by an angle of tangent 2 s about that. Sums are as long as before but for a change of the bend.
auto carried_to = [](const double* now, const double* was, const double* turn, double s, double* to) {
    double square = 0.0, both = 0.0, ahead = 0.0, behind = 0.0;
    for (int c = 0; c < 3; ++c) {
        square += now[c] * now[c];
        both += now[c] * was[c];
        ahead += (now[c] + was[c]) * turn[c];
        behind += was[c] * turn[c];
    }
    if (square < 1.0e-4) square = 1.0e-4;  // a joint that folds back on itself
    const double cosine = 1.0 + both / square, less = ahead / ((cosine > 0.01 ? cosine : 0.01) * square);
    double swung[3], across[3];
    for (int c = 0; c < 3; ++c) swung[c] = turn[c] - less * (now[c] + was[c]) + 2.0 * behind / square * now[c];
    const double length = sqrt(square), share = 2.0 * s / (1.0 + s * s);
    for (int c = 0; c < 3; ++c) {
        const int a = (c + 1) % 3, b = (c + 2) % 3;
        across[c] = (now[a] * swung[b] - now[b] * swung[a]) / length;
    }
    for (int c = 0; c < 3; ++c) {
        const int a = (c + 1) % 3, b = (c + 2) % 3;
        to[c] = swung[c] + share * (across[c] + s / length * (now[a] * across[b] - now[b] * across[a]));
    }
};
auto length_of = [](const double* v) { return sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]); };
auto fill_segment = [&](int k, Edge edge) {
    double* to = row(k);
    double length = length_of(edge.now);
    if (length < (double)shortest) {  // any direction does, if those of neighbours differ
        for (int c = 0; c < 3; ++c) edge.now[c] = c == k % 3 ? (double)shortest : 0.0;
        length = (double)shortest;
    }
    const double inverse = 1.0 / length;
    double rest = rests.data[segments + k], grown = 0.0;
    if (k == fed_segment) {
        rest = fed_length;
        grown = (double)fed * length / fed_length;
    }
    const double held = square * tensions.data[segments + k], yields = (double)compliance * rest * inverse_square;
    double gap = length - rest - yields * held;
    if (gamma > 0.0f) gap += gamma * (growth_of(edge, length) - grown);
    const double near = moves[k].v[3], far = moves[k + 1].v[3];
    const double lightest = near > far ? near : far;
    double along = yields * eased;
    if (along < 1.0e-9 * lightest) along = 1.0e-9 * lightest;
    if (along < (double)least) along = (double)least;
    along = lightest > 0.0 ? 1.0 / along : 0.0;
    const double pull = held + along * eased * gap;
    for (int c = 0; c < 3; ++c) to[NORMAL + c] = edge.now[c] * inverse;
    to[PULL] = pull;
    to[ALONG] = along;
    // The pull by the elongation jerks where a segment turns far. The tension of the last step is smooth.
    const double across = lightest > 0.0 ? held * (length > 1.0e-3 * rest ? inverse : 1.0e3 / rest) : 0.0;
    const double least_across = lightest > 0.0 ? -1.0 / (16.0 * lightest) : 0.0;
    to[ACROSS] = across > least_across ? across : least_across;
    to[REACH] = length > rest ? length : rest;
    to[TURN] = 0.0;
};
auto fill_joint = [&](int j, const Edge& one, const Edge& two) {
    double* to = row(j);
    const auto joint = joints.data[segments + j];
    double before = joint[2], behind = joint[3], span = joint[1];
    if (j == fed_segment) {
        span += 0.5 * (fed_length - 1.0 / before);
        before = 1.0 / fed_length;
    }
    Edge turn;
    for (int c = 0; c < 3; ++c) {
        turn.now[c] = behind * two.now[c] - before * one.now[c];
        turn.change[c] = behind * two.change[c] - before * one.change[c];
        turn.carried[c] = behind * two.carried[c] - before * one.carried[c];
    }
    const double size = length_of(turn.now), inverse = size > 1.0e-9 ? 1.0 / size : 0.0;
    double lightest = 0.0;
    for (int i = j; i < j + 3; ++i) lightest = lightest > moves[i].v[3] ? lightest : moves[i].v[3];
    const double steepest = before > behind ? before : behind, yields = (double)bend_compliance * span * inverse_square;
    const double least_yields = lightest * steepest * steepest * softest;
    const double softer = yields > least_yields ? yields : least_yields;
    const double stiff = softer > 0.0 ? 1.0 / softer : 0.0, rest = joint[0] * inverse;
    // In the material, where it is known how that turns: the dashpots resist a bend that goes about the rope, too.
    const bool follows = bend_gamma > 0.0f && twisted.shape[0] > 0 && twisted.data[segments + j].row[1] > 0.0f;
    double resisted[3] = {};
    if (follows) {
        const double spin = 0.25 * ((double)twisted.data[segments + j].row[0] + twisted.data[segments + j + 1].row[0]);
        double now[3], was[3], before_that[3], bent[3], carried[3];
        for (int c = 0; c < 3; ++c) {
            now[c] = behind * two.now[c] + before * one.now[c];
            was[c] = now[c] - (behind * two.change[c] + before * one.change[c]);
            bent[c] = turn.now[c] - turn.change[c];
        }
        carried_to(now, was, bent, spin, carried);
        for (int c = 0; c < 3; ++c) resisted[c] = turn.now[c] - carried[c];
        if (carries) {
            for (int c = 0; c < 3; ++c) {
                before_that[c] = was[c] - 3.0 * (behind * two.carried[c] + before * one.carried[c]);
                bent[c] -= 3.0 * turn.carried[c];
            }
            double earlier[3];
            carried_to(now, before_that, bent, 2.0 * spin, earlier);
            for (int c = 0; c < 3; ++c) resisted[c] -= (carried[c] - earlier[c]) / 3.0;
        }
    } else if (bend_gamma > 0.0f) {
        const double growth = growth_of(turn, size);
        for (int c = 0; c < 3; ++c) resisted[c] = growth * turn.now[c] * inverse;
    }
    to[BEFORE] = before;
    to[BEHIND] = behind;
    to[STIFF] = stiff * (1.0 + bend_gamma);
    double held = 0.0;
    for (int c = 0; c < 3; ++c) held += square * moments.data[segments + j][c] * turn.now[c] * inverse;
    const double room = 64.0 * lightest * steepest * steepest * stiff, least = room > 0.0 ? -1.0 / room : 0.0;
    double across = joint[0] > 0.0f ? held * inverse * softer : 1.0;
    if (across < least) across = least;
    if (across > 1.0) across = 1.0;
    to[SHARE] = (across + (follows ? bend_gamma : 0.0f)) * bend_eased;
    for (int c = 0; c < 3; ++c) {
        to[BEND + c] = turn.now[c] * inverse;
        const double bend = bends_at_rest.shape[0] > 0 ? bends_at_rest.data[segments + j][c] : 0.0;
        to[MOMENT + c] = stiff * ((1.0 - rest) * turn.now[c] - bend + bend_gamma * resisted[c]);
    }
};
Edge ahead;
for (int k = first + t; k < count - 1; k += threads) {
    const Edge edge = threads == 1 && bends && k > first ? ahead : edge_of(k);
    fill_segment(k, edge);
    if (!bends || k == count - 2) continue;
    ahead = edge_of(k + 1);
    fill_joint(k, edge, ahead);
}
