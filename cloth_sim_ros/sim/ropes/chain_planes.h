// SPDX-License-Identifier: Apache-2.0
// Start of each plane, each as long as the chain. A segment has n, g, its reach, g without turns, its largest squared
// turn so far, kappa, gap / alpha, the size of H along n, and its force. A particle has w, the vector to its place
// without the chain, and its displacement. A step from either end, side by side, has T and f_0. See elimination.py.
enum {
    N, G = N + 3, REACH, ACROSS, TURN, KAPPA, PUSH, HELD, WEIGHT, MISSING, MOVED = MISSING + 3, FORCE = MOVED + 3,
    STEPS = FORCE + 3
};
typedef double Four __attribute__((ext_vector_type(4), aligned(8)));
typedef double Two __attribute__((ext_vector_type(2), aligned(8)));
typedef float Row __attribute__((ext_vector_type(4), aligned(4)));
double* numbers = ladder.data + (size_t)NUMBERS * particles;
const int size = n + 4;
auto plane = [&](int which) { return numbers + (size_t)which * size; };
auto at = [&](int which, int i) -> Four& { return *(Four*)(plane(which) + i); };
