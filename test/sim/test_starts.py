# SPDX-License-Identifier: Apache-2.0
"""Starts far from rest: a symmetric one must not come to rest where nothing but its symmetry holds it."""

import numpy as np

from cloth_sim_ros.sim import Cloth, Scene, Settings, Simulation

HELD = (90, 99)


def sheet():
    cloth = Cloth(
        resolution=(10, 10), size=(0.9, 0.9), stretch_compliance=0.0, shear_compliance=0.0, damping=2e-3, pins=HELD
    )
    return Simulation(Scene({"it": cloth}), Settings(method="xpbd", substeps=5, order=2, global_damping=2.0), "cpu")


def but_for_the_held(x, others):
    others = np.array(np.broadcast_to(others, x.shape))
    others[list(HELD)] = x[list(HELD)]
    return others


def test_a_symmetric_start_is_moved_a_little_off_its_symmetry():
    sim = sheet()
    x = sim.rest_positions("it")
    stretched = but_for_the_held(x, 10.0 * x)
    sim.set_positions("it", stretched)
    assert 0.0 < np.abs(sim.positions("it") - stretched)[50].max() < 2e-6


def test_what_is_in_one_place_or_pinned_stays_there_and_a_calm_start_is_taken_to_the_bit():
    sim = sheet()
    x = sim.rest_positions("it").copy()
    x[50] += [0.0, 0.0, 0.01]
    sim.set_positions("it", x)
    assert np.array_equal(sim.positions("it"), x)
    sim.set_positions("it", but_for_the_held(x, [0.1, 0.2, 0.3]))
    found = sim.positions("it")
    assert np.ptp(found[:90], axis=0).max() == 0.0 and np.array_equal(found[list(HELD)], x[list(HELD)])
