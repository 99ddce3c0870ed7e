// SPDX-License-Identifier: Apache-2.0
// Compute the pulls after the solve, and return the events as bits. Segments get stiffer across, for another attempt.
int events = 0;
for (int k = first + t; k < count - 1; k += threads) {
    double* at = row(k);
    const double *near = row(k) + MOVE, *far = row(k + 1) + MOVE;
    double opened = 0.0, square = 0.0;
    for (int c = 0; c < 3; ++c) {
        opened += at[NORMAL + c] * (far[c] - near[c]);
        square += (far[c] - near[c]) * (far[c] - near[c]);
    }
    const double reach = at[REACH], turn = (square - opened * opened) / (reach * reach);
    at[PULLED] = at[PULL] + at[ALONG] * opened;
    if (turn > (double)largest_turn && turn > 2.0 * at[TURN]) events |= TOO_FAR;
    if (opened * opened > (double)overstretched * overstretched * reach * reach) events |= OVERSTRETCHED;
    if (0.5 * turn * reach > (double)settled) events |= UNSETTLED;
    if (turn > at[TURN]) at[TURN] = turn;
    const double across = (0.25 * at[TURN] < 1.0 ? 0.25 * at[TURN] : 1.0) * at[ALONG];
    if (across > at[ACROSS]) at[ACROSS] = across;
}
return events;
