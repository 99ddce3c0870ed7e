# SPDX-License-Identifier: Apache-2.0
"""The cable to be laid around pegs: what counts as laid, and a plan that lays it."""

import numpy as np
import pytest
from paths import along, run

from cloth_sim_ros.learn import RouteCable, mppi
from cloth_sim_ros.learn.route import HAND, HORIZON, LENGTH, PEGS, RADIUS, SEGMENTS, STEP, passes, route

DRAWN = 40  # steps


def around_the_pegs(beside, end):
    """`beside` the pegs on their sides, to `end` [m] along the row of pegs; then the hand stays."""
    corners = [(0.3, 0.45), (0.3, -beside), (0.5, -beside), (0.5, beside), (0.7, beside), (end, 0)]
    plan = np.zeros((HORIZON - 1, 3))
    plan[:DRAWN] = along([HAND, *((x, y, RADIUS) for x, y in corners)], DRAWN, STEP)
    return plan


def test_the_route_passes_all_pegs_and_each_other_way_does_not():
    there = route()
    assert there.shape == (SEGMENTS + 1, 3) and np.linalg.norm(np.diff(there, axis=0), axis=1).sum() <= LENGTH + 1e-9
    others = []
    for x, _ in PEGS.values():  # around this one on the other side
        other = there.copy()
        other[np.abs(there[:, 0] - x) < 0.08, 1] *= -1.0
        others.append(other)
    short, back = there.copy(), there.copy()
    short[:, 0] *= 0.6
    back[-3:, 0] = 0.5  # and back past the last
    assert list(passes(np.array([there, *others, short, back, there * [1, -1, 1]]))) == [True] + 6 * [False]


@pytest.mark.long
def test_a_hand_that_goes_around_all_pegs_lays_the_cable(device):
    """Friction holds some of the stiffest back. One that draws it straight to the same end lays none."""
    env = RouteCable(8, device)
    info = run(env, around_the_pegs(0.06, 0.9))[4]
    assert info["success"].sum() >= 6
    straight = np.zeros((HORIZON - 1, 3))
    straight[:DRAWN] = along([HAND, (0.8, 0.4, RADIUS), (0.9, 0, RADIUS)], DRAWN, STEP)
    other = run(env, straight)[4]
    assert not other["success"].any()


@pytest.mark.long
def test_a_plan_over_worlds_lays_at_least_95_of_100(device):
    """Its guess leaves the cable slack."""
    guess = around_the_pegs(0.06, 0.79)
    plan, _ = mppi(RouteCable(48, device), HORIZON - 1, rounds=16, knots=16, spread=0.1, guess=guess)
    env = RouteCable(100, device)
    before, after = (run(env, each)[4]["success"] for each in (guess, plan))
    assert before.sum() < 60 and after.sum() >= 95, (before.sum(), after.sum())
