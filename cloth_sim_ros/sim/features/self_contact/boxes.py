# SPDX-License-Identifier: Apache-2.0
"""Bounding boxes of panels, and tests for overlap.

Consecutive panels lie side by side (see surfaces.py). Each cluster of them has one more box, so a test can skip the
whole cluster. A GPU goes through clusters much faster than down a tree, as each thread of a warp tests one box. A CPU
uses a team of one thread.
"""

import warp as wp

from cloth_sim_ros.sim.kernels.compiled import compiled
from cloth_sim_ros.sim.kernels.device import allocated
from cloth_sim_ros.sim.kernels.intrinsics import ballot, least_of_warp

CLUSTER = 32  # panels


@wp.struct
class Boxes:
    """Bounding boxes [m] of the panels and of the clusters of all worlds, world after world."""

    lows: wp.array(dtype=wp.vec3)
    highs: wp.array(dtype=wp.vec3)
    around_lows: wp.array(dtype=wp.vec3)
    around_highs: wp.array(dtype=wp.vec3)


@wp.func
def _overlap(low: wp.vec3, high: wp.vec3, other_low: wp.vec3, other_high: wp.vec3) -> bool:
    apart = wp.max(low - other_high, other_low - high)
    return wp.max(apart) <= 0.0


@wp.func
def clusters_of(panels: int) -> int:
    """Return the number of clusters of `panels` panels."""
    return (panels + wp.static(CLUSTER - 1)) // wp.static(CLUSTER)


@wp.func
def clusters_near(boxes: Boxes, panels: int, w: int, t: int, first: int, lane: int) -> wp.uint64:
    """Return a bit for each thread of a warp: 1 if the box of panel t overlaps the box of its cluster of world w.

    Panel t is counted through all worlds. Thread `lane` tests cluster `first` + `lane`.
    """
    clusters, near = clusters_of(panels), bool(False)
    if first + lane < clusters:
        c = w * clusters + first + lane
        near = _overlap(boxes.lows[t], boxes.highs[t], boxes.around_lows[c], boxes.around_highs[c])
    return ballot(near)


@wp.func
def overlap(boxes: Boxes, t: int, other: int) -> bool:
    """Return True if the boxes of two panels, counted through all worlds, overlap."""
    return _overlap(boxes.lows[t], boxes.highs[t], boxes.lows[other], boxes.highs[other])


@compiled
def surround(boxes: Boxes, panels: int, team: int):
    """Compute the boxes around clusters, each by a `team` of threads."""
    clusters = clusters_of(panels)
    of_all, lane = wp.tid() / team, wp.tid() % team
    w = of_all / clusters
    first = (of_all - w * clusters) * wp.static(CLUSTER)
    low, high = wp.vec3(1.0e30), wp.vec3(-1.0e30)
    for k in range(w * panels + first + lane, w * panels + wp.min(first + wp.static(CLUSTER), panels), team):
        low, high = wp.min(low, boxes.lows[k]), wp.max(high, boxes.highs[k])
    low, high = least_of_warp(low), -least_of_warp(-high)
    if lane == 0:
        boxes.around_lows[of_all] = low
        boxes.around_highs[of_all] = high


def boxes_of(worlds: int, panels: int, device: wp.Device) -> Boxes:
    """Allocate the boxes of `panels` panels in each of `worlds` worlds."""
    each, around = worlds * panels, worlds * clusters_of(panels)
    return allocated(Boxes, device, lows=each, highs=each, around_lows=around, around_highs=around)
