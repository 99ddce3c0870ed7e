// SPDX-License-Identifier: Apache-2.0
// Return a tiny edge for a spring without length, in a direction of its own: R3 sequence in a cube (Roberts 2018).
auto opening = [](int number) {
    const float n = (float)(number % 65536);
    const float a = 0.81917251f * n, b = 0.67104361f * n, c = 0.54970048f * n;
    return wp::vec3(1.0e-12f * (a - floorf(a) - 0.5f), 1.0e-12f * (b - floorf(b) - 0.5f),
                    1.0e-12f * (c - floorf(c) - 0.5f));
};
