# SPDX-License-Identifier: Apache-2.0
"""An object goes on in another simulation only where that one has it with the same structure."""

import numpy as np
import pytest

from cloth_sim_ros.sim import Cloth, Rope, Scene, Settings, Simulation, Winch

SHEET = Cloth(resolution=(5, 4), pins="top")


def simulated(device, **objects):
    return Simulation(Scene(objects), Settings(method="xpbd", substeps=8), device)


@pytest.mark.parametrize(
    ("mine", "theirs", "told"),
    [
        (SHEET, Cloth(resolution=(6, 4), pins="top"), "it is"),
        (SHEET, Cloth(resolution=(4, 5), pins="top"), "it is"),
        (SHEET, Rope(segments=19), "it is"),
        (Rope(segments=8), Rope(segments=9), "it is"),
        (Rope(segments=8), Rope(segments=8, winch=Winch(length=0.5)), "it is"),
    ],
    ids=["more particles", "as many elsewhere", "rope", "segments", "winch"],
)
@pytest.mark.parametrize("way", ["there", "back"])
def test_another_structure_is_refused_and_nothing_changes(device, mine, theirs, told, way):
    mine, theirs = (mine, theirs) if way == "there" else (theirs, mine)
    sim, alone, other = (simulated(device, it=each) for each in (mine, mine, theirs))
    for each in (sim, alone, other):
        each.step(3)
    with pytest.raises(ValueError, match=f"{told}.*in the other simulation; allowed is"):
        sim.take_over("it", other)
    for each in (sim, alone):
        each.step(3)
    assert np.array_equal(sim.positions("it"), alone.positions("it"))


@pytest.mark.parametrize("name", ["it", "that"])
def test_what_one_of_them_lacks_is_named(device, name):
    sim, other = simulated(device, it=SHEET), simulated(device, that=SHEET)
    with pytest.raises(ValueError, match=f"'?{name}'?.*allowed"):
        sim.take_over(name, other)


@pytest.mark.parametrize("twist", [(None, 10.0), (10.0, None)], ids=["gains", "loses"])
def test_a_rope_may_begin_or_cease_to_resist_twist(device, twist):
    one, two = (simulated(device, it=Rope(segments=8, bend_compliance=10.0, twist_compliance=each)) for each in twist)
    one.step(20)
    two.take_over("it", one)
    assert np.array_equal(two.positions("it"), one.positions("it"))
    for each in (one, two):
        each.step(10)
    assert np.abs(two.positions("it") - one.positions("it")).max() < 1e-3, "in a plane nothing twists"


def test_only_a_simulation_is_taken_from(device):
    with pytest.raises(ValueError, match="take_over of it is from None; allowed is a Simulation"):
        simulated(device, it=SHEET).take_over("it", None)
