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
const Row ai = ((const Row*)a)[i], bi = ((const Row*)b)[i];
Row sum = 0.0f;
for (int q = 0; q < width; ++q) {
    const int j = neighbour[q * across + i * along];
    sum += weight[q * across + i * along] * ((((const Row*)a)[j] - ai) + (((const Row*)b)[j] - bi));
}
return wp::vec3(sum[0], sum[1], sum[2]);
#endif
