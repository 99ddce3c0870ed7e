// SPDX-License-Identifier: Apache-2.0
// NUMBERS of each particle between rows of four and planes, INTO these or out of them.
float* __restrict numbers = (float*)planes + (size_t)plane * size;
float* __restrict particles = (float*)address;
for (int i = 0; i < count; ++i) {
    for (int k = 0; k < NUMBERS; ++k) {
        float &particle = particles[4 * i + k], &number = numbers[(size_t)k * size + i];
        if (INTO) number = particle; else particle = number;
    }
}
