# SPDX-License-Identifier: Apache-2.0
"""The table of real scenes at the defaults."""

import pytest

from cloth_sim_ros.sim import Settings, Simulation
from cloth_sim_ros.study import halves
from cloth_sim_ros.study.case import BODY
from cloth_sim_ros.study.scenes import SCENES


def test_each_half_second_has_the_substeps_and_the_error_of_a_run_by_hand():
    rows = (("hands", 8, 1), ("hands", 8, 1024))
    title, *_, row = halves.table(SCENES, "cpu", 2, rows).splitlines()
    assert title.endswith("milliseconds a frame, medians of 2 rounds, and quartiles")
    name, *cells = row.strip("| ").split(" | ")
    assert name == "hands 8 x 8" and len(cells) == 4 and "worlds" not in row
    sim = Simulation(SCENES["hands"](8), Settings(), "cpu")
    for ms, told in (cells[:2], cells[2:]):
        sim.step(30)
        choice = sim.choices[BODY]
        assert told == f"{choice.substeps}, {choice.error:.1e}" and 0.0 < float(ms.split()[0])
    assert cells[1] != cells[3]


@pytest.mark.parametrize(("name", "resolution", "worlds"), [row for row in halves.ROWS if row[2] == 1])
def test_all_rows_are_scenes(name, resolution, worlds):
    assert BODY in SCENES[name](resolution).objects
