# SPDX-License-Identifier: Apache-2.0
"""Sheets that tear: arrays of a batch, and how many elements each has."""

import warp as wp

from cloth_sim_ros.sim.arrays.model import Counts, Features

# Arrays of the model of which each world has its own.
LEFT = ("line_rests", "panels", "panel_parts", "plate_weights", "curve_stencil_gradients", "curve_gradients")


@wp.struct
class TearingState:
    """Sheets that tear; see State for the letters."""

    # What of Model's arrays of these names is left of objects that tear. The rest length of a spring that failed is
    # below 0: less itself in the frame in which it failed. The corners of a triangle that failed are its first one.
    line_rests: wp.array(dtype=float)
    panels: wp.array(dtype=wp.vec3i)
    panel_parts: wp.array(dtype=wp.vec2i)
    plate_weights: wp.array(dtype=float)
    curve_stencil_gradients: wp.array(dtype=float)
    curve_gradients: wp.array(dtype=float)
    tearing: wp.array(dtype=int)  # (B,) whether a spring failed in this frame


def sizes(features: Features, n: Counts) -> dict[str, int]:
    """Array -> its elements in one world; 0 where the features do not need it."""
    there = features.tears
    return {**{name: n.model[name] if there else 0 for name in LEFT}, "tearing": n.bodies if there else 0}
