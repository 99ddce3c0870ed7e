# SPDX-License-Identifier: Apache-2.0
"""Boxes that overlap: none is passed over."""

import numpy as np
import pytest
import warp as wp

from cloth_sim_ros.sim.features.self_contact.boxes import (
    CLUSTER,
    Boxes,
    boxes_of,
    clusters_near,
    clusters_of,
    overlap,
    surround,
)
from cloth_sim_ros.sim.kernels.compiled import compiled
from cloth_sim_ros.sim.kernels.intrinsics import lowest_bit


@compiled
def _count(boxes: Boxes, panels: int, team: int, found: wp.array2d(dtype=int)):
    t, lane = wp.tid() / team, wp.tid() % team
    w = t / panels
    for c in range(0, clusters_of(panels), team):
        near = clusters_near(boxes, panels, w, t, c, lane)
        while near != wp.uint64(0):
            begin = wp.static(CLUSTER) * (c + lowest_bit(near))
            near &= near - wp.uint64(1)
            for q in range(begin + lane, wp.min(begin + wp.static(CLUSTER), panels), team):
                if overlap(boxes, t, w * panels + q):
                    wp.atomic_add(found, t, q, 1)


@pytest.mark.parametrize("panels", [1, CLUSTER - 1, CLUSTER, 5 * CLUSTER + 7, 40 * CLUSTER + 3])
def test_each_box_that_overlaps_is_found_once(device, panels):
    team = 1 if device == "cpu" else CLUSTER
    worlds, random = 2, np.random.default_rng()
    middles = np.cumsum(random.normal(0.0, 0.3, (worlds * panels, 3)), axis=0)  # what follows lies side by side
    sizes = random.uniform(0.0, 1.0, (worlds * panels, 1))
    lows, highs = (middles - sizes).astype(np.float32), (middles + sizes).astype(np.float32)
    boxes = boxes_of(worlds, panels, device)
    boxes.lows.assign(lows)
    boxes.highs.assign(highs)
    found = wp.zeros((worlds * panels, panels), dtype=int, device=device)
    wp.launch(surround, worlds * clusters_of(panels) * team, [boxes, panels, team], device=device)
    wp.launch(_count, worlds * panels * team, [boxes, panels, team, found], device=device)
    wanted = [
        np.all((lows[t] <= highs[of_world]) & (lows[of_world] <= highs[t]), axis=1)
        for t in range(worlds * panels)
        for of_world in [slice(t // panels * panels, (t // panels + 1) * panels)]
    ]
    assert np.array_equal(found.numpy(), np.array(wanted, int))
