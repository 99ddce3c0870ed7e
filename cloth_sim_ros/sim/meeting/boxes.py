# SPDX-License-Identifier: Apache-2.0
"""Boxes of panels, and which of them overlap.

Panels that follow one another lie side by side, see surfaces.py. Around each cluster of them is one more box, so that
most are passed over together. A GPU goes through clusters much faster than down a tree, as no step waits for another.
"""

import warp as wp

from cloth_sim_ros.sim.compiled import compiled

CLUSTER = 32  # panels


@wp.struct
class Boxes:
    """Of panels, and around each cluster of a world; all worlds in one row [m]."""

    lows: wp.array(dtype=wp.vec3)
    highs: wp.array(dtype=wp.vec3)
    around_lows: wp.array(dtype=wp.vec3)
    around_highs: wp.array(dtype=wp.vec3)


@wp.func
def _overlap(low: wp.vec3, high: wp.vec3, other_low: wp.vec3, other_high: wp.vec3) -> bool:
    apart = wp.max(low - other_high, other_low - high)
    return wp.max(apart) <= 0.0


@wp.func
def _around(boxes: Boxes, low: wp.vec3, high: wp.vec3, c: int) -> bool:
    """Whether the box around cluster c of all overlaps one."""
    return _overlap(low, high, boxes.around_lows[c], boxes.around_highs[c])


@wp.func
def clusters_of(panels: int) -> int:
    """How many clusters they have."""
    return (panels + wp.static(CLUSTER - 1)) // wp.static(CLUSTER)


@wp.func
def before(first: int, team: int) -> int:
    """What comes before the panels of a thread, of `team` that share clusters in turn, if its own ones begin there."""
    return wp.static(CLUSTER) * (first - team + 1) - 1


@wp.func
def next_near(boxes: Boxes, panels: int, w: int, t: int, after: int, team: int) -> int:
    """The next panel of a thread in world w whose box overlaps that of panel t of all; `panels` if there is none."""
    clusters = clusters_of(panels)
    low, high = boxes.lows[t], boxes.highs[t]
    k = after
    while k < panels:
        k += 1
        if k % wp.static(CLUSTER) == 0:
            k += wp.static(CLUSTER) * (team - 1)
            while k < panels and not _around(boxes, low, high, w * clusters + k / wp.static(CLUSTER)):
                k += wp.static(CLUSTER) * team
        if k < panels and _overlap(low, high, boxes.lows[w * panels + k], boxes.highs[w * panels + k]):
            return k
    return panels


@compiled
def surround(boxes: Boxes, panels: int):
    """The boxes around clusters."""
    clusters = clusters_of(panels)
    w = wp.tid() / clusters
    first = (wp.tid() - w * clusters) * wp.static(CLUSTER)
    low, high = wp.vec3(1.0e30), wp.vec3(-1.0e30)
    for k in range(w * panels + first, w * panels + wp.min(first + wp.static(CLUSTER), panels)):
        low, high = wp.min(low, boxes.lows[k]), wp.max(high, boxes.highs[k])
    boxes.around_lows[wp.tid()] = low
    boxes.around_highs[wp.tid()] = high


def boxes_of(worlds: int, panels: int, device: wp.Device) -> Boxes:
    """Room for those of all worlds."""
    boxes = Boxes()
    for name in ("lows", "highs"):
        setattr(boxes, name, wp.zeros(worlds * panels, dtype=wp.vec3, device=device))
        setattr(boxes, f"around_{name}", wp.zeros(worlds * clusters_of(panels), dtype=wp.vec3, device=device))
    return boxes
