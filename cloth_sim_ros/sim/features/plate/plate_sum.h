// SPDX-License-Identifier: Apache-2.0
// sum_j w_ij (a_j - a_i + b_j - b_i).
const float* weight = weights.data + base;
const int* neighbour = neighbours.data + base;
#if defined(__CUDA_ARCH__)
typedef float4 Row;
const float4 ai = ((const float4*)a)[i], bi = ((const float4*)b)[i];
float x = 0.0f, y = 0.0f, z = 0.0f;
for (int q = 0; q < width; ++q) {
    const int j = neighbour[q * across + i * along];
    const float w = weight[q * across + i * along];
    const float4 aj = ((const float4*)a)[j], bj = ((const float4*)b)[j];
    x += w * ((aj.x - ai.x) + (bj.x - bi.x));
    y += w * ((aj.y - ai.y) + (bj.y - bi.y));
    z += w * ((aj.z - ai.z) + (bj.z - bi.z));
}
return wp::vec3(x, y, z);
#else
typedef float Row __attribute__((ext_vector_type(4), aligned(4)));
const Row* from = (const Row*)a;
const Row* and_from = (const Row*)b;
const Row ai = from[i], bi = and_from[i];
neighbour += i * along;
weight += i * along;
Row sums[4] = {0.0f, 0.0f, 0.0f, 0.0f};  // several, as each addition waits for the one before
int q = 0;
for (; q + 4 <= width; q += 4) {
    for (int k = 0; k < 4; ++k) {
        const int j = neighbour[(q + k) * across];
        sums[k] += weight[(q + k) * across] * ((from[j] - ai) + (and_from[j] - bi));
    }
}
for (; q < width; ++q) {
    const int j = neighbour[q * across];
    sums[0] += weight[q * across] * ((from[j] - ai) + (and_from[j] - bi));
}
const Row sum = (sums[0] + sums[1]) + (sums[2] + sums[3]);
return wp::vec3(sum[0], sum[1], sum[2]);
#endif
