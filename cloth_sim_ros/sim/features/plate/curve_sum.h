// SPDX-License-Identifier: Apache-2.0
// Sum of (gradient + pull) x normal; an entry names a triangle, and the corner of it that the particle is, 3 for none.
const float* gradient = gradients.data;
#if defined(__CUDA_ARCH__)
float x = 0.0f, y = 0.0f, z = 0.0f;
for (int k = begin; k < end; ++k) {
    const wp::vec_t<2, wp::int32> entry = entries.data[k];
    const float along = gradient[k] + (entry[1] < 3 ? pulls.data[entry[0]][entry[1]] : 0.0f);
    const float4 n = ((const float4*)normals.data)[entry[0]];
    x += along * n.x;
    y += along * n.y;
    z += along * n.z;
}
return wp::vec3(x, y, z);
#else
typedef float Row __attribute__((ext_vector_type(4), aligned(4)));
Row sums[2] = {0.0f, 0.0f};  // two, as each addition waits for the one before
for (int k = begin; k < end; ++k) {
    const wp::vec_t<2, wp::int32> entry = entries.data[k];
    const float along = gradient[k] + (entry[1] < 3 ? pulls.data[entry[0]][entry[1]] : 0.0f);
    sums[k & 1] += along * ((const Row*)normals.data)[entry[0]];
}
const Row sum = sums[0] + sums[1];
return wp::vec3(sum[0], sum[1], sum[2]);
#endif
