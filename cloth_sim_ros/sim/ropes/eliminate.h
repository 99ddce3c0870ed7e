// SPDX-License-Identifier: Apache-2.0
// Solve the system of the rows by L D L^T in blocks, from both ends at once, until two rows are left in the middle. On a
// CPU both sides go in the halves of a vector register. On a GPU two threads take one each.
area += (size_t)NUMBERS * first;
const int rows = (count - first) + (count - first) % 2, steps = rows / 2 - 1;
#if defined(__CUDA_ARCH__)
typedef double Num;
const bool sided = t < 2;
// Kernels of a GPU have no fused operations but these.
auto less = [](double from, double a, double b) { return fma(-a, b, from); };
auto wait = [] { __syncthreads(); };
auto load = [&](int s, int which) { return row(t == 0 ? s : rows - 1 - s)[which]; };
auto store = [&](int s, int which, double v) { row(t == 0 ? s : rows - 1 - s)[which] = v; };
// The coupling of a row to one before it on its side; of the side from the end, the other row has it.
auto coupled = [&](int s, int behind, int which) { return row(t == 0 ? s : rows - 1 - s + behind)[which]; };
#else
typedef double Num __attribute__((ext_vector_type(2)));
const bool sided = true;
auto less = [](auto from, auto a, auto b) { return from - a * b; };
auto wait = [] {};
auto load = [&](int s, int which) { return Num{row(s)[which], row(rows - 1 - s)[which]}; };
auto store = [&](int s, int which, Num v) { row(s)[which] = v[0]; row(rows - 1 - s)[which] = v[1]; };
auto coupled = [&](int s, int behind, int which) { return Num{row(s)[which], row(rows - 1 - s + behind)[which]}; };
#endif
// Matrices of nine numbers by rows, from symmetric ones of six.
auto place_of = [](int a, int b) { return a == b ? a : a + b + 2; };
auto full = [&](const auto* s, auto* to) {
    for (int k = 0; k < 9; ++k) to[k] = s[place_of(k / 3, k % 3)];
};
auto subtract_transposed = [&](const auto* m, const auto* n, auto* from) {  // from -= m n^T
    for (int k = 0; k < 9; ++k)
        for (int i = 0; i < 3; ++i) from[k] = less(from[k], m[k / 3 * 3 + i], n[k % 3 * 3 + i]);
};
auto subtract_symmetric = [&](const auto* m, const auto* n, auto* from) {  // the same if the product is symmetric
    for (int c = 0; c < 6; ++c) {
        const int a = 3 * (c < 3 ? c : (c == 5 ? 1 : 0)), b = 3 * (c < 3 ? c : (c == 3 ? 1 : 2));
        for (int i = 0; i < 3; ++i) from[c] = less(from[c], m[a + i], n[b + i]);
    }
};
auto subtract_product = [&](const auto* m, const auto* v, auto* from) {
    for (int a = 0; a < 9; ++a) from[a / 3] = less(from[a / 3], m[a], v[a % 3]);
};
auto subtract_turned = [&](const auto* m, const auto* v, auto* from) {  // by the transpose of m
    for (int a = 0; a < 9; ++a) from[a / 3] = less(from[a / 3], m[a % 3 * 3 + a / 3], v[a % 3]);
};
// The factors L D L^T of a symmetric block, with 1 / D on the diagonal. An explicit inverse would lose what masses add
// to stiff segments.
auto factor = [&](const auto* m, auto* to) {
    to[0] = 1.0 / m[0];
    to[3] = m[3] * to[0];
    to[4] = m[4] * to[0];
    const auto beside = less(m[5], to[4], m[3]);
    to[1] = 1.0 / less(m[1], to[3], m[3]);
    to[5] = beside * to[1];
    to[2] = 1.0 / less(less(m[2], to[4], m[4]), to[5], beside);
};
auto solve = [&](const auto* v, const auto* f, auto* to) {  // v times the inverse of that block
    to[0] = v[0];
    to[1] = less(v[1], f[3], to[0]);
    to[2] = less(less(v[2], f[4], to[0]), f[5], to[1]);
    to[2] = to[2] * f[2];
    to[1] = less(to[1] * f[1], f[5], to[2]);
    to[0] = less(less(to[0] * f[0], f[3], to[1]), f[4], to[2]);
};
auto solve_rows = [&](const auto* m, const auto* f, auto* to) {
    for (int a = 0; a < 9; a += 3) solve(m + a, f, to + a);
};
if (sided) {
    Num lower[9] = {}, factors[6] = {}, before[6] = {}, right[3] = {}, earlier[3] = {};
    for (int s = 0; s < steps; ++s) {
        Num diagonal[6], second[6], whole[9], first_block[9], lowest[9], now[3];
        for (int k = 0; k < 6; ++k) diagonal[k] = load(s, DIAGONAL + k);
        for (int k = 0; k < 9; ++k) first_block[k] = coupled(s, 1, FIRST + place_of(k / 3, k % 3));
        for (int k = 0; k < 3; ++k) now[k] = load(s, RIGHT + k);
        if (bends) {
            for (int k = 0; k < 6; ++k) second[k] = coupled(s, 2, SECOND + k);
            full(second, whole);
            subtract_transposed(whole, lower, first_block);
            solve_rows(whole, before, lowest);
            subtract_symmetric(lowest, whole, diagonal);
            subtract_product(lowest, earlier, now);
            for (int k = 0; k < 9; ++k) store(s, LOWEST + k, lowest[k]);
        }
        solve_rows(first_block, factors, lower);
        subtract_symmetric(lower, first_block, diagonal);
        subtract_product(lower, right, now);
        for (int k = 0; k < 6; ++k) before[k] = factors[k];
        for (int k = 0; k < 3; ++k) earlier[k] = right[k], right[k] = now[k];
        factor(diagonal, factors);
        for (int k = 0; k < 9; ++k) store(s, LOWER + k, lower[k]);
        for (int k = 0; k < 6; ++k) store(s, FACTORS + k, factors[k]);
        for (int k = 0; k < 3; ++k) store(s, DONE + k, now[k]);
    }
}
wait();
if (t == 0) {
    const int a = steps, b = steps + 1;
    // Take from row i, of which the block of the next row is known, what the rows before it on its side ask.
    auto reduce = [&](int i, int way, double* diagonal, double* right, double* lower, double* second_block) {
        const int one = i - way, two = i - 2 * way, own = way > 0 ? i : one, far = way > 0 ? i : two;
        double first_block[9] = {}, lowest[9] = {};
        for (int k = 0; k < 9; ++k) lower[k] = 0.0;
        const bool has = one >= 0 && one < rows, has_two = bends && two >= 0 && two < rows;
        if (has) full(row(own) + FIRST, first_block);
        if (has_two) {
            double whole[9];
            full(row(far) + SECOND, whole);
            subtract_transposed(whole, row(one) + LOWER, first_block);
            solve_rows(whole, row(two) + FACTORS, lowest);
            subtract_symmetric(lowest, whole, diagonal);
            subtract_product(lowest, row(two) + DONE, right);
        }
        if (has) {
            solve_rows(first_block, row(one) + FACTORS, lower);
            subtract_symmetric(lower, first_block, diagonal);
            subtract_product(lower, row(one) + DONE, right);
        }
        for (int k = 0; k < 9; ++k) row(i)[LOWER + k] = lower[k], row(i)[LOWEST + k] = lowest[k];
        // The row beyond the middle is coupled to the last one before it, too.
        for (int k = 0; k < 9; ++k) second_block[k] = 0.0;
        if (has && bends) full(row(way > 0 ? b : b + 1) + SECOND, second_block);
    };
    double at_a[6], at_b[6], right_a[3], right_b[3], lower_a[9], lower_b[9], from_a[9], from_b[9], cross[9], beside[9];
    for (int k = 0; k < 6; ++k) at_a[k] = row(a)[DIAGONAL + k], at_b[k] = row(b)[DIAGONAL + k];
    for (int k = 0; k < 3; ++k) right_a[k] = row(a)[RIGHT + k], right_b[k] = row(b)[RIGHT + k];
    reduce(a, 1, at_a, right_a, lower_a, from_a);
    reduce(b, -1, at_b, right_b, lower_b, from_b);
    full(row(b) + FIRST, beside);
    subtract_transposed(from_a, lower_a, beside);
    subtract_transposed(lower_b, from_b, beside);
    if (steps > 0 && bends) {
        solve_rows(from_a, row(a - 1) + FACTORS, cross);
        subtract_symmetric(cross, from_a, at_b);
        subtract_product(cross, row(a - 1) + DONE, right_b);
        for (int k = 0; k < 9; ++k) row(b)[DIAGONAL + k] = cross[k];
        solve_rows(from_b, row(b + 1) + FACTORS, cross);
        subtract_symmetric(cross, from_b, at_a);
        subtract_product(cross, row(b + 1) + DONE, right_a);
        for (int k = 0; k < 9; ++k) row(a)[DIAGONAL + k] = cross[k];
    }
    double factors[6], lower[9], last[6], move_b[3];
    factor(at_a, factors);
    solve_rows(beside, factors, lower);
    subtract_symmetric(lower, beside, at_b);
    subtract_product(lower, right_a, right_b);
    factor(at_b, last);
    solve(right_b, last, move_b);
    solve(right_a, factors, row(a) + MOVE);
    subtract_turned(lower, move_b, row(a) + MOVE);
    for (int k = 0; k < 3; ++k) row(b)[MOVE + k] = move_b[k];
}
wait();
if (sided) {
    Num ahead[3], last[3], move[3], done[3], lower[9], factors[6];
    for (int k = 0; k < 3; ++k) ahead[k] = load(steps, MOVE + k);
#if defined(__CUDA_ARCH__)
    for (int k = 0; k < 3; ++k) last[k] = row(t == 0 ? steps + 1 : steps)[MOVE + k];
    auto crossed = [&](int k) { return row(t == 0 ? steps + 1 : steps)[DIAGONAL + k]; };
#else
    for (int k = 0; k < 3; ++k) last[k] = ahead[k].yx;
    auto crossed = [&](int k) { return Num{row(steps + 1)[DIAGONAL + k], row(steps)[DIAGONAL + k]}; };
#endif
    for (int s = steps - 1; s >= 0; --s) {
        for (int k = 0; k < 6; ++k) factors[k] = load(s, FACTORS + k);
        for (int k = 0; k < 3; ++k) done[k] = load(s, DONE + k);
        solve(done, factors, move);
        for (int k = 0; k < 9; ++k) lower[k] = load(s + 1, LOWER + k);
        subtract_turned(lower, ahead, move);
        if (bends) {
            for (int k = 0; k < 9; ++k) lower[k] = s + 2 > steps ? crossed(k) : load(s + 2, LOWEST + k);
            subtract_turned(lower, last, move);
        }
        for (int k = 0; k < 3; ++k) {
            last[k] = ahead[k];
            ahead[k] = move[k];
            store(s, MOVE + k, move[k]);
        }
    }
}
