// SPDX-License-Identifier: Apache-2.0
// One Newton step of XPBD along up to eight lines of springs side by side, in the vector registers of a CPU core.
// solve.py declares the arguments and states the equations.
typedef int Flags __attribute__((ext_vector_type(8)));
constexpr float kShortest = 1.0e-12f;

// Data of each spring that forward elimination keeps for the way back.
struct Spring {
    Lanes u[3], inverse, coupling, rest, weight;
};
Spring* springs = (Spring*)(((uint64_t)scratch.data + 63) & ~(uint64_t)63);
const int* at = nodes.data + (size_t)8 * first;
const float* rest = rests.data + (size_t)8 * first;
const float* scale = scales.data + (size_t)8 * first;
float* kept = multipliers.data + (size_t)8 * first;
float* kept_defect = defects.data + (size_t)8 * first;
float* kept_mean = kept_defect + defects.shape[0] / 2;
float* slip_rate = slips.data + (size_t)8 * first;

Lanes x[4], d[4], motion[4];
auto moved_of = [&](const int* at, const Lanes* d, Lanes* to) {  // displacement in this substep, as dashpots see it
    Lanes rows[4];
    gather((uint64_t)(bases.data + particle), at, rows);
    for (int k = 0; k < 4; ++k) to[k] = d[k] - rows[k];
};
auto longer = [&](const Lanes* edge, Lanes length, const Lanes* by) {  // elongation by the motion, no cancellation
    Lanes was[3], sum[3];
    for (int axis = 0; axis < 3; ++axis) {
        was[axis] = edge[axis] - by[axis];
        sum[axis] = edge[axis] + was[axis];
    }
    return dot(sum, by) / (length + __builtin_elementwise_sqrt(dot(was, was)) + 1.0e-30f);
};
const Row* v = (const Row*)(velocities.data + particle);
Lanes speed[4];
gather(x_address, at, x);
gather(d_address, at, d);
if (gamma > 0.0f) moved_of(at, d, motion);
Lanes lo[4];
if (corrects > 0.0f && fresh) gather(position_lo, at, lo);
if (carried > 0.0f) gather((uint64_t)v, at, speed);
Lanes columns[4];
transpose(d, columns);
Lanes weight = columns[3];
Spring none = {};
const Spring* before = &none;
for (int k = 0; k + 1 < slots; ++k) {
    Spring& spring = springs[k];
    const int* next = at + 8 * (k + 1);
    Lanes next_x[4], next_d[4], e[4];
    gather(x_address, next, next_x);
    gather(d_address, next, next_d);
    Lanes before_x[4];
    for (int r = 0; r < 4; ++r) {
        before_x[r] = next_x[r] - x[r];
        const Lanes edge = before_x[r] + (next_d[r] - d[r]);
        e[r] = __builtin_shufflevector(edge, next_d[r], 0, 1, 2, 11, 4, 5, 6, 15);  // the edge and the inverse mass
        x[r] = next_x[r];
    }
    transpose(e, columns);
    const Lanes next_weight = columns[3];
    const Lanes free_length = *(const Kept*)(rest + 8 * k);
    const Flags is_there = free_length >= 0.0f;
    Lanes square = dot(columns, columns);
    if (__builtin_reduce_min(is_there ? square : Lanes(1.0f)) < kShortest * kShortest) {
        for (int lane = 0; lane < 8; ++lane) {
            if (square[lane] >= kShortest * kShortest) continue;
            const wp::vec3 way = opening((first + k) * 8 + lane);
            for (int axis = 0; axis < 3; ++axis) columns[axis][lane] = way[axis];
        }
        square = dot(columns, columns);
    }
    const Lanes length = __builtin_elementwise_sqrt(square + 1.0e-30f), inverse_length = 1.0f / length;
    const Lanes there = is_there ? Lanes(1.0f) : Lanes(0.0f);
    for (int axis = 0; axis < 3; ++axis) spring.u[axis] = columns[axis] * inverse_length * there;
    const Lanes compliance = alpha * *(const Kept*)(scale + 8 * k);
    Lanes violation = length - free_length;
    if (!fresh) violation += compliance * *(const Kept*)(kept + 8 * k);
    Lanes slipped = 0.0f;  // slip of the substep before
    if (gamma > 0.0f) {
        Lanes next_motion[4], apart[4];
        moved_of(next, next_d, next_motion);
        for (int r = 0; r < 4; ++r) {
            apart[r] = next_motion[r] - motion[r];
            motion[r] = next_motion[r];
        }
        Lanes de[4];
        transpose(apart, de);
        const Lanes slip = longer(columns, length, de);
        violation += gamma * slip;
        if (carried > 0.0f) {
            Lanes next_speed[4];
            gather((uint64_t)v, next, next_speed);
            for (int r = 0; r < 4; ++r) {
                apart[r] = span * (next_speed[r] - speed[r]);
                speed[r] = next_speed[r];
            }
            Lanes edge[4];
            transpose(before_x, edge);
            transpose(apart, de);
            const Lanes was_long = __builtin_elementwise_sqrt(dot(edge, edge));
            slipped = longer(edge, was_long, de);
            violation += gamma * (slipped - span * *(const Kept*)(slip_rate + 8 * k));
        }
        if (keeps) *(Kept*)(slip_rate + 8 * k) = slip - violation / (1.0f + gamma);
    }
    if (corrects > 0.0f) {
        Kept& defect = *(Kept*)(kept_defect + 8 * k);
        Kept& mean = *(Kept*)(kept_mean + 8 * k);
        if (fresh && carried == 0.0f) {
            defect = mean = 0.0f;
        } else if (fresh) {
            Lanes next_lo[4], was[4];
            gather(position_lo, next, next_lo);
            for (int r = 0; r < 4; ++r) {
                before_x[r] += next_lo[r] - lo[r];
                lo[r] = next_lo[r];
            }
            transpose(before_x, was);
            defect += corrects * (__builtin_elementwise_sqrt(dot(was, was)) - free_length + gamma * slipped);
            const Lanes most = kMostDefect * free_length;
            defect = __builtin_elementwise_min(__builtin_elementwise_max(defect, -most), most);
            mean += corrects * (defect - mean);
            violation += 2.0f * defect - mean;
        } else {
            violation += 2.0f * (defect - corrects * compliance * *(const Kept*)(kept + 8 * k)) - mean;
        }
    }
    const Lanes both = weight + next_weight;
    const Lanes diagonal = (1.0f + gamma) * both + compliance + 1.0e-5f * both + 1.0e-30f;
    spring.coupling = -(1.0f + gamma) * weight * dot(spring.u, before->u);
    const Lanes share = spring.coupling * before->inverse;
    spring.inverse = there / (diagonal - spring.coupling * share);
    spring.rest = -violation * there - share * before->rest;
    spring.weight = next_weight;
    weight = next_weight;
    for (int r = 0; r < 4; ++r) d[r] = next_d[r];
    before = &spring;
}
// Back substitution, which moves each particle by the difference of the impulses around it.
Lanes behind[3] = {0.0f, 0.0f, 0.0f}, coupled = 0.0f;
Row* displacements = (Row*)d_address;
auto push = [&](const int* at, const Lanes* by) {
    Lanes rows[4];
    transpose(by, rows);
    for (int lane = 0; lane < lines; ++lane) {
        const Lanes& row = rows[lane & 3];
        const Row change = lane < 4 ? __builtin_shufflevector(row, row, 0, 1, 2, 3)
                                    : __builtin_shufflevector(row, row, 4, 5, 6, 7);
        displacements[at[lane]] += change;
    }
};
// Add the size of this family's force on a particle [N] to position_lo.w, and raise `tautness` to its tension there.
auto feel = [&](const int* at, const Lanes* impulse, Lanes pulls) {
    const Lanes force = weighs * __builtin_elementwise_sqrt(dot(impulse, impulse));
    const Lanes tension = 0.5f * weighs * (pulls > 0.0f ? pulls : Lanes(0.0f));
    for (int lane = 0; lane < lines; ++lane) {
        ((Row*)position_lo)[at[lane]][3] += force[lane];
        float& most = tautness.data[particle + at[lane]];
        most = most > tension[lane] ? most : tension[lane];
    }
};
Lanes pull_behind = 0.0f;
for (int k = slots - 2; k >= 0; --k) {
    const Spring& spring = springs[k];
    const Lanes lambda = spring.inverse * (spring.rest - coupled);
    if (stores) {
        Kept& stored = *(Kept*)(kept + 8 * k);
        stored = fresh ? lambda : stored + lambda;
    }
    if (corrects > 0.0f) *(Kept*)(kept_defect + 8 * k) += corrects * alpha * *(const Kept*)(scale + 8 * k) * lambda;
    if (keeps) {
        Kept& rate = *(Kept*)(slip_rate + 8 * k);
        rate = (rate - alpha * *(const Kept*)(scale + 8 * k) * lambda / (1.0f + gamma)) / span;
    }
    Lanes by[4], net[3];
    for (int axis = 0; axis < 3; ++axis) {
        const Lanes impulse = lambda * spring.u[axis];
        net[axis] = impulse - behind[axis];
        by[axis] = spring.weight * net[axis];
        behind[axis] = impulse;
    }
    if (weighs > 0.0f) feel(at + 8 * (k + 1), net, pull_behind - lambda);
    pull_behind = -lambda;
    by[3] = 0.0f;
    push(at + 8 * (k + 1), by);
    coupled = spring.coupling * lambda;
}
gather(d_address, at, d);
transpose(d, columns);
Lanes by[4];
for (int axis = 0; axis < 3; ++axis) by[axis] = -columns[3] * behind[axis];
by[3] = 0.0f;
push(at, by);
if (weighs > 0.0f) feel(at, behind, pull_behind);
