# SPDX-License-Identifier: Apache-2.0
"""What is thrown at sheets, and how the study tells that it passed."""

import sys

import numpy as np
import pytest

from cloth_sim_ros.sim import Cloth, Scene, Simulation
from cloth_sim_ros.study import __main__, throws


def test_a_point_that_a_sheet_lies_above_is_told_from_one_that_it_lies_below():
    sim = Simulation(
        Scene({throws.BODY: Cloth(resolution=(9, 7), pins="none", position=(0.0, 0.0, 1.0))}), device="cpu"
    )
    x = sim.positions(throws.BODY)
    for under, over in (((0.031, 0.017, 0.9), (0.031, 0.017, 1.1)), ((-0.2, 0.3, 0.0), (-0.2, 0.3, 2.0))):
        assert throws.is_above(sim, throws.BODY, under) and not throws.is_above(sim, throws.BODY, over)
    assert not throws.is_above(sim, throws.BODY, (0.8, 0.0, 0.9)), "nothing is above what lies beside it"
    # Folded over by its half, it has two layers over what was below.
    x[:, 2] += np.where(x[:, 0] < 0.0, 0.02, 0.0)
    x[:, 0] = np.abs(x[:, 0])
    sim.set_positions(throws.BODY, x)
    assert not throws.is_above(sim, throws.BODY, (0.2, 0.017, 0.9)) and throws.is_above(
        sim, throws.BODY, (0.2, 0.017, 1.01)
    )


def test_throws_are_drawn_from_everything_and_alike_for_a_seed():
    first, again = ([throws.drawn(random) for _ in range(200)] for random in map(np.random.default_rng, (7, 7)))
    assert first == again
    assert {each.thing for each in first} == set(throws.THINGS)
    assert {each.speed for each in first} == {1.0, 5.0, 10.0, 20.0} and {each.hung for each in first} == {True, False}
    turns = np.linalg.norm([each.turn for each in first], axis=1)
    assert np.abs(turns - 1.0).max() < 1e-12


def test_a_finger_starts_below_the_sheet():
    make, reach = throws.THINGS["finger"]
    finger = make(position=(0.0, 0.0, 0.0), orientation=(0.0, 0.0, 0.0, 1.0))
    assert 0.9 * reach < np.linalg.norm(finger.vertices, axis=1).max() <= reach


@pytest.mark.long
def test_the_command_throws_and_finds_nothing_passed(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["study", "stability", "--throws", "6", "--seed", "1", "--device", "cpu"])
    assert __main__.main() == 0
    assert capsys.readouterr().out == "seed 1: of 6 throws 0 pass, 0 get deeper than the thickness\n"


def test_what_passes_is_told(monkeypatch, capsys):
    """What has passed does not count as deep too."""
    monkeypatch.setattr(throws, "throw", lambda each, random, device: throws.Outcome(each.speed > 5.0, 0.004))
    monkeypatch.setattr(sys, "argv", ["study", "stability", "--throws", "40", "--seed", "3", "--device", "cpu"])
    drawn = [throws.drawn(np.random.default_rng((3, number))) for number in range(40)]
    passed = sum(each.speed > 5.0 for each in drawn)
    deep = sum(each.speed <= 5.0 and each.thickness < 0.004 for each in drawn)
    assert passed and deep and __main__.main() == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1] == f"seed 3: of 40 throws {passed} pass, {deep} get deeper than the thickness"
    assert len(lines) == 1 + passed + deep
