// SPDX-License-Identifier: Apache-2.0
// Update the missing displacement of particles after they were moved.
for (int i = 0; i <= n; ++i) {
    for (int axis = 0; axis < 3; ++axis) {
        plane(MISSING + axis)[i] = (lacking ? plane(MISSING + axis)[i] : 0.0) - plane(MOVED + axis)[i];
    }
}
