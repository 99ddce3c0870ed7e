// SPDX-License-Identifier: Apache-2.0
// One Newton step of XPBD along the lines of a row by the 32 threads of a warp, each of which holds `Slots` particles.
// solve.py declares the arguments and states the equations. Each thread eliminates all but its first spring. Parallel
// cyclic reduction (Hockney 1965) in shuffles solves the remaining 32.
constexpr unsigned kAll = 0xffffffffu;
constexpr float kShortest = 1.0e-12f;
const int lane = threadIdx.x & 31;
auto up = [&](float value, int by) { return __shfl_up_sync(kAll, value, by); };
auto down = [&](float value, int by) { return __shfl_down_sync(kAll, value, by); };

int node[Slots];
float4 x[Slots + 1], d[Slots + 1];
float ux[Slots], uy[Slots], uz[Slots], D[Slots], R[Slots], c[Slots + 1], w[Slots];
#pragma unroll
for (int j = 0; j < Slots; ++j) {
    node[j] = nodes.data[(first + j) * 32 + lane];
    const int i = node[j] < 0 ? 0 : node[j];
    x[j] = ((const float4*)x_address)[i];
    d[j] = ((const float4*)d_address)[i];
    w[j] = node[j] < 0 ? 0.0f : d[j].w;
}
x[Slots] = make_float4(down(x[0].x, 1), down(x[0].y, 1), down(x[0].z, 1), 0.0f);
d[Slots] = make_float4(down(d[0].x, 1), down(d[0].y, 1), down(d[0].z, 1), 0.0f);
const float w_next = down(w[0], 1);
// Return the elongation of an edge by its motion (x, y, z), without cancellation.
auto longer = [](float ex, float ey, float ez, float length, float x, float y, float z) {
    const float bx = ex - x, by = ey - y, bz = ez - z, square = bx * bx + by * by + bz * bz;
    const float was_long = square * rsqrtf(square + 1.0e-30f);
    return __fdividef((ex + bx) * x + (ey + by) * y + (ez + bz) * z, length + was_long + 1.0e-30f);
};
float slip[Slots];  // slip of the substep before, less the part up to its solve
float defect[Slots], mean[Slots];  // as in lanes.h
const size_t behind_defects = defects.shape[0] / 2;
const bool goes_on = gamma > 0.0f && carried > 0.0f;
if (goes_on) {
    float4 v[Slots + 1];
    #pragma unroll
    for (int j = 0; j < Slots; ++j) {
        const wp::vec4& speed = velocities.data[particle + (node[j] < 0 ? 0 : node[j])];
        v[j] = make_float4(span * speed[0], span * speed[1], span * speed[2], 0.0f);
    }
    v[Slots] = make_float4(down(v[0].x, 1), down(v[0].y, 1), down(v[0].z, 1), 0.0f);
    #pragma unroll
    for (int j = 0; j < Slots; ++j) {
        const float wx = x[j + 1].x - x[j].x, wy = x[j + 1].y - x[j].y, wz = x[j + 1].z - x[j].z;
        const float square = wx * wx + wy * wy + wz * wz, length = square * rsqrtf(square + 1.0e-30f);
        slip[j] = longer(wx, wy, wz, length, v[j + 1].x - v[j].x, v[j + 1].y - v[j].y, v[j + 1].z - v[j].z);
    }
}
if (corrects > 0.0f) {
    float4 lo[Slots + 1];
    #pragma unroll
    for (int j = 0; j < Slots; ++j) lo[j] = ((const float4*)position_lo)[node[j] < 0 ? 0 : node[j]];
    lo[Slots] = make_float4(down(lo[0].x, 1), down(lo[0].y, 1), down(lo[0].z, 1), 0.0f);
    #pragma unroll
    for (int j = 0; j < Slots; ++j) {
        const size_t at = (size_t)(first + j) * 32 + lane;
        const float rest = rests.data[at];
        defect[j] = mean[j] = 0.0f;
        if (goes_on || !fresh) mean[j] = defects.data[behind_defects + at];
        if (!fresh) defect[j] = defects.data[at] - corrects * alpha * scales.data[at] * multipliers.data[at];
        if (!fresh || !goes_on || rest < 0.0f) continue;
        const float ex = (x[j + 1].x - x[j].x) + (lo[j + 1].x - lo[j].x);
        const float ey = (x[j + 1].y - x[j].y) + (lo[j + 1].y - lo[j].y);
        const float ez = (x[j + 1].z - x[j].z) + (lo[j + 1].z - lo[j].z);
        const float square = ex * ex + ey * ey + ez * ez, near = rsqrtf(square + 1.0e-30f), rough = square * near;
        const float length = fmaf(fmaf(-rough, rough, square), 0.5f * near, rough);
        defect[j] = defects.data[at] + corrects * (length - rest + gamma * slip[j]);
        defect[j] = fminf(fmaxf(defect[j], -kMostDefect * rest), kMostDefect * rest);
        mean[j] += corrects * (defect[j] - mean[j]);
    }
}
if (goes_on) {
    #pragma unroll
    for (int j = 0; j < Slots; ++j) slip[j] -= span * slips.data[(size_t)(first + j) * 32 + lane];
}
float4 m[Slots + 1];  // displacement in this substep, as dashpots see it
if (gamma > 0.0f) {
    #pragma unroll
    for (int j = 0; j < Slots; ++j) {
        const int i = node[j] < 0 ? 0 : node[j];
        const float4 base = ((const float4*)bases.data)[particle + i];
        m[j] = make_float4(d[j].x - base.x, d[j].y - base.y, d[j].z - base.z, 0.0f);
    }
    m[Slots] = make_float4(down(m[0].x, 1), down(m[0].y, 1), down(m[0].z, 1), 0.0f);
}
#pragma unroll
for (int j = 0; j < Slots; ++j) {
    const size_t at = (size_t)(first + j) * 32 + lane;
    const float rest = rests.data[at];
    const bool there = rest >= 0.0f;
    const float compliance = alpha * scales.data[at];
    float ex = (x[j + 1].x - x[j].x) + (d[j + 1].x - d[j].x);
    float ey = (x[j + 1].y - x[j].y) + (d[j + 1].y - d[j].y);
    float ez = (x[j + 1].z - x[j].z) + (d[j + 1].z - d[j].z);
    float square = ex * ex + ey * ey + ez * ez;
    if (there && square < kShortest * kShortest) {
        const wp::vec3 way = opening((int)at);
        ex = way[0];
        ey = way[1];
        ez = way[2];
        square = ex * ex + ey * ey + ez * ez;
    }
    const float near = rsqrtf(square + 1.0e-30f), rough = square * near;
    const float length = fmaf(fmaf(-rough, rough, square), 0.5f * near, rough);  // correctly rounded (Markstein 1990)
    const float inverse_length = there ? near : 0.0f;
    ux[j] = ex * inverse_length;
    uy[j] = ey * inverse_length;
    uz[j] = ez * inverse_length;
    float violation = length - rest;
    if (!fresh) violation += compliance * multipliers.data[at];
    if (gamma > 0.0f) {
        const float ax = m[j + 1].x - m[j].x, ay = m[j + 1].y - m[j].y, az = m[j + 1].z - m[j].z;
        const float own = longer(ex, ey, ez, length, ax, ay, az);
        violation += gamma * own;
        if (carried > 0.0f) violation += gamma * slip[j];
        if (corrects > 0.0f) violation += 2.0f * defect[j] - mean[j];
        if (keeps) slip[j] = own - violation / (1.0f + gamma);
    }
    const float both = w[j] + (j + 1 < Slots ? w[j + 1 < Slots ? j + 1 : 0] : w_next);
    D[j] = there ? (1.0f + gamma) * both + compliance + 1.0e-5f * both + 1.0e-30f : 1.0f;
    R[j] = there ? -violation : 0.0f;
}
const float px = up(ux[Slots - 1], 1), py = up(uy[Slots - 1], 1), pz = up(uz[Slots - 1], 1);
c[0] = lane > 0 ? -(1.0f + gamma) * w[0] * (px * ux[0] + py * uy[0] + pz * uz[0]) : 0.0f;
#pragma unroll
for (int j = 1; j < Slots; ++j) {
    c[j] = -(1.0f + gamma) * w[j] * (ux[j - 1] * ux[j] + uy[j - 1] * uy[j] + uz[j - 1] * uz[j]);
}
c[Slots] = down(c[0], 1);
if (lane == 31) c[Slots] = 0.0f;
// Springs 1 .. Slots - 1 in terms of the first of this thread and of the next: R - A first - B next.
float A[Slots], B[Slots], P[Slots];
#pragma unroll
for (int j = 1; j < Slots; ++j) {
    const float share = j > 1 ? c[j] * P[j - 1] : 0.0f;
    P[j] = __frcp_rn(D[j] - share * c[j]);
    if (j > 1) R[j] -= share * R[j - 1];
    A[j] = j > 1 ? -share * A[j - 1] : c[1];
    B[j] = j + 1 == Slots ? c[Slots] : 0.0f;
}
#pragma unroll
for (int j = Slots - 1; j > 0; --j) {
    const bool inner = j + 1 < Slots;
    R[j] = (R[j] - (inner ? c[j + 1] * R[inner ? j + 1 : 0] : 0.0f)) * P[j];
    A[j] = (A[j] - (inner ? c[j + 1] * A[inner ? j + 1 : 0] : 0.0f)) * P[j];
    B[j] = (B[j] - (inner ? c[j + 1] * B[inner ? j + 1 : 0] : 0.0f)) * P[j];
}
float lower, upper, r;
if (Slots == 1) {
    const float inverse = __frcp_rn(D[0]);
    lower = c[0] * inverse;
    upper = c[Slots] * inverse;
    r = R[0] * inverse;
} else {
    constexpr int one = Slots > 1 ? 1 : 0;
    float before_R = up(R[Slots - 1], 1), before_A = up(A[Slots - 1], 1), before_B = up(B[Slots - 1], 1);
    if (lane == 0) before_R = before_A = before_B = 0.0f;
    const float inverse = __frcp_rn(D[0] - c[1] * A[one] - c[0] * before_B);
    lower = -c[0] * before_A * inverse;
    upper = -c[1] * B[one] * inverse;
    r = (R[0] - c[1] * R[one] - c[0] * before_R) * inverse;
}
#pragma unroll
for (int k = 1; k < 32; k *= 2) {
    float before_l = up(lower, k), before_u = up(upper, k), before_r = up(r, k);
    float after_l = down(lower, k), after_u = down(upper, k), after_r = down(r, k);
    if (lane < k) before_l = before_u = before_r = 0.0f;
    if (lane + k > 31) after_l = after_u = after_r = 0.0f;
    const float inverse = __frcp_rn(1.0f - lower * before_u - upper * after_l);
    r = inverse * (r - lower * before_r - upper * after_r);
    lower = -inverse * lower * before_l;
    upper = -inverse * upper * after_u;
}
float next = down(r, 1);
if (lane == 31) next = 0.0f;
R[0] = r;
#pragma unroll
for (int j = 1; j < Slots; ++j) R[j] -= A[j] * r + B[j] * next;
if (stores) {
    #pragma unroll
    for (int j = 0; j < Slots; ++j) {
        float& stored = multipliers.data[(size_t)(first + j) * 32 + lane];
        stored = fresh ? R[j] : stored + R[j];
    }
}
if (corrects > 0.0f) {
    #pragma unroll
    for (int j = 0; j < Slots; ++j) {
        const size_t at = (size_t)(first + j) * 32 + lane;
        defects.data[at] = defect[j] + corrects * alpha * scales.data[at] * (fresh ? R[j] : multipliers.data[at]);
        defects.data[behind_defects + at] = mean[j];
    }
}
if (keeps) {
    #pragma unroll
    for (int j = 0; j < Slots; ++j) {
        const size_t at = (size_t)(first + j) * 32 + lane;
        slips.data[at] = (slip[j] - alpha * scales.data[at] * R[j] / (1.0f + gamma)) / span;
    }
}
const float l = R[Slots - 1];
float bx = up(l * ux[Slots - 1], 1), by = up(l * uy[Slots - 1], 1), bz = up(l * uz[Slots - 1], 1);
float pull = up(l, 1);
if (lane == 0) bx = by = bz = pull = 0.0f;
#pragma unroll
for (int j = 0; j < Slots; ++j) {
    const float fx = R[j] * ux[j], fy = R[j] * uy[j], fz = R[j] * uz[j];
    if (node[j] >= 0) {
        const float4 now = make_float4(d[j].x + w[j] * (bx - fx), d[j].y + w[j] * (by - fy), d[j].z + w[j] * (bz - fz), d[j].w);
        ((float4*)d_address)[node[j]] = now;
        if (weighs > 0.0f) {  // as in lanes.h
            const float nx = bx - fx, ny = by - fy, nz = bz - fz;
            float& most = tautness.data[particle + node[j]];
            most = fmaxf(most, -0.5f * weighs * (pull + R[j]));
            ((float4*)position_lo)[node[j]].w += weighs * sqrtf(nx * nx + ny * ny + nz * nz);
        }
    }
    bx = fx;
    by = fy;
    bz = fz;
    pull = R[j];
}
