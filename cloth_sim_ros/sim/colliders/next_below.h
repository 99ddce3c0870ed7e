// SPDX-License-Identifier: Apache-2.0
// The first triangle that may be nearer than a distance, by its plane and its ball; a CPU looks at LANES = 8 at a time.
#if defined(__CUDA_ARCH__)
for (; k < last; ++k) {
    const float* at = (const float*)bounds + k / LANES * (8 * LANES) + k % LANES;
    if (at[0] * p[0] + at[LANES] * p[1] + at[2 * LANES] * p[2] - at[3 * LANES] >= distance) continue;
    const float x = p[0] - at[4 * LANES], y = p[1] - at[5 * LANES], z = p[2] - at[6 * LANES];
    const float most = distance + at[7 * LANES];
    if (x * x + y * y + z * z < most * most) break;
}
return k;
#else
typedef float Lanes __attribute__((ext_vector_type(LANES), aligned(4)));
typedef bool Mask __attribute__((ext_vector_type(LANES)));
unsigned from = 255u << k % LANES;
for (int block = k / LANES * LANES; block < last; block += LANES) {
    const Lanes* at = (const Lanes*)((const float*)bounds + 8 * block);
    const Lanes bound = at[0] * p[0] + at[1] * p[1] + at[2] * p[2] - at[3];
    const Lanes x = p[0] - at[4], y = p[1] - at[5], z = p[2] - at[6], most = distance + at[7];
    const Mask mask = __builtin_convertvector((bound < distance) & (x * x + y * y + z * z < most * most), Mask);
    const unsigned below = from & __builtin_bit_cast(unsigned char, mask);
    if (below) return block + __builtin_ctz(below);
    from = 255u;
}
return last;
#endif
