# SPDX-License-Identifier: Apache-2.0
"""The towel to be folded: what is rewarded, and a plan that folds it."""

import numpy as np
import pytest
from paths import run

from cloth_sim_ros.learn import FoldTowel, mppi
from cloth_sim_ros.learn.fold import HORIZON, SIDE, STEP


def half_circles():
    """Both hands over the middle of the towel onto the other edge."""
    angle = np.linspace(0.0, np.pi, HORIZON)
    moves = np.diff(0.5 * SIDE * np.column_stack([0.0 * angle, np.cos(angle), np.sin(angle)]), axis=0)
    assert np.abs(moves).max() < STEP
    return np.tile(moves / STEP, (1, 2))


def test_hands_that_go_in_half_circles_fold_it(device):
    """And hands that stay leave it as it lies: half of it is away from the fold by its distance from the mirror."""
    env = FoldTowel(16, device)
    assert run(env, half_circles())[4]["success"].all()
    lines = SIDE / 9 * np.arange(1, 10, 2)  # [m] from each line of particles to its mirror
    still = run(env, np.zeros((3, 6)))
    assert still[4]["distance"] == pytest.approx(lines.sum() / 10, rel=0.02)
    assert still[1] == pytest.approx(-still[4]["distance"] / SIDE)


@pytest.mark.long
def test_a_plan_over_worlds_folds_most_towels_where_its_guess_folds_none(device):
    """The guess are half circles that are too wide, as of a towel that is a quarter larger."""
    guess = np.clip(1.25 * half_circles(), -1.0, 1.0)
    plan, _ = mppi(FoldTowel(64, device), HORIZON - 1, rounds=12, spread=0.2, guess=guess)
    env = FoldTowel(100, device)
    before, after = (run(env, each)[4] for each in (guess, plan))
    assert not before["success"].any()
    assert after["success"].sum() >= 70, "84 to 100 with four seeds"
    assert after["distance"].mean() < 0.5 * before["distance"].mean()
