// SPDX-License-Identifier: Apache-2.0
// Eight numbers of a plane from the one of particle i on.
typedef float Lanes __attribute__((ext_vector_type(LANES), aligned(4)));
float* numbers = (float*)planes;
auto at = [&](int plane, int i) -> Lanes& { return *(Lanes*)(numbers + (size_t)plane * size + i); };
