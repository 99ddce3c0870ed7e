// SPDX-License-Identifier: Apache-2.0
// The first plane whose distance is below one; a CPU looks at LANES = 8 at a time.
#if defined(__CUDA_ARCH__)
for (; k < last; ++k) {
    const float* at = (const float*)planes + k / LANES * (4 * LANES) + k % LANES;
    if (at[0] * p[0] + at[LANES] * p[1] + at[2 * LANES] * p[2] - at[3 * LANES] < distance) break;
}
return k;
#else
typedef float Lanes __attribute__((ext_vector_type(LANES), aligned(4)));
typedef bool Mask __attribute__((ext_vector_type(LANES)));
unsigned from = 255u << k % LANES;
for (int block = k / LANES * LANES; block < last; block += LANES) {
    const Lanes* at = (const Lanes*)((const float*)planes + 4 * block);
    const Lanes bound = at[0] * p[0] + at[1] * p[1] + at[2] * p[2] - at[3];
    const Mask mask = __builtin_convertvector(bound < distance, Mask);
    const unsigned below = from & __builtin_bit_cast(unsigned char, mask);
    if (below) return block + __builtin_ctz(below);
    from = 255u;
}
return last;
#endif
