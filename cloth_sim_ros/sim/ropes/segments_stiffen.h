// SPDX-License-Identifier: Apache-2.0
// Stiffen segments that turned, in the directions across them.
for (int k = 0; k < n; ++k) {
    const double along = plane(G)[k] + plane(KAPPA)[k], turn = 0.25 * plane(TURN)[k];
    plane(G)[k] = plane(ACROSS)[k] + (turn < 1.0 ? turn : 1.0) * along;
    plane(KAPPA)[k] = along - plane(G)[k];
}
