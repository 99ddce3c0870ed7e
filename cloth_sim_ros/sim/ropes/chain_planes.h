// SPDX-License-Identifier: Apache-2.0
// Where planes begin, each as long as the chain. Of every segment: n, g, how far it reaches, g unless it turns and its
// largest turn so far, kappa, gap / alpha, how much H is along n, and its force. Of every particle: w, how far it lies
// from where it would be without the chain, and how it is to move. Of every step from either end, side by side: T and
// f_0. See elimination.py.
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
