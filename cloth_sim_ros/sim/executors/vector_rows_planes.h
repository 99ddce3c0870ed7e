// SPDX-License-Identifier: Apache-2.0
// Some numbers of a plane from the one of particle i on: as many as two registers of AVX-512 hold, of which there are 32.
// Elsewhere one of AVX, as with more of them numbers leave the registers again. It decides no bit.
#if defined(__AVX512F__)
constexpr int LANES = MOST;
#else
constexpr int LANES = LEAST;
#endif
typedef float Lanes __attribute__((ext_vector_type(LANES), aligned(4)));
float* numbers = (float*)planes;
auto at = [&](int plane, int i) -> Lanes& { return *(Lanes*)(numbers + (size_t)plane * size + i); };
