# SPDX-License-Identifier: Apache-2.0
"""Sheets that tear: arrays of a batch, and their sizes."""

import warp as wp

from cloth_sim_ros.sim.arrays.model import Counts, Features

# Arrays of the model that each world has a copy of.
LEFT = ("line_rests", "panels", "panel_parts", "plate_weights", "curve_stencil_gradients", "curve_gradients")


@wp.struct
class TearingState:
    """Sheets that tear; see State for the letters."""

    # Copies of Model's arrays of these names for objects that tear. The rest length of a failed spring is negative: its
    # own rest length with a minus in the frame in which it failed. A failed triangle has its first corner three times.
    line_rests: wp.array(dtype=float)
    panels: wp.array(dtype=wp.vec3i)
    panel_parts: wp.array(dtype=wp.vec2i)
    plate_weights: wp.array(dtype=float)
    curve_stencil_gradients: wp.array(dtype=float)
    curve_gradients: wp.array(dtype=float)
    tearing: wp.array(dtype=int)  # (B,) 1 if a spring failed in this frame


def sizes(features: Features, n: Counts) -> dict[str, int]:
    there = features.tears
    return {**{name: n.model[name] if there else 0 for name in LEFT}, "tearing": n.bodies if there else 0}
