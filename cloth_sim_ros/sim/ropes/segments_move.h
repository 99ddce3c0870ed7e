// SPDX-License-Identifier: Apache-2.0
// Move particles and update tensions.
for (int k = 0; k < n; ++k) {
    const double *forces = plane(FORCE) + k + 1, *direction = plane(N) + k;
    double along = -plane(HELD)[k];
    for (int axis = 0; axis < 3; ++axis) along += direction[axis * size] * forces[axis * size];
    tensions.data[segments + k] += (float)(along * inverse_square);
}
for (int i = 0; i <= n; ++i) {
    const double* moved = plane(MOVED) + i;
    Row& row = ((Row*)d)[i];
    row += Row{(float)moved[0], (float)moved[size], (float)moved[2 * size], 0.0f};
}
