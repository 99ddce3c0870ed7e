# SPDX-License-Identifier: Apache-2.0
"""All outputs of the node, in the order in which they are called. Plugins add theirs (docs/how-to/extending.md)."""

from __future__ import annotations

from cloth_sim_ros.ros.outputs.clock import ClockOutput
from cloth_sim_ros.ros.outputs.colliders import CollidersOutput
from cloth_sim_ros.ros.outputs.grippers import GripperStates
from cloth_sim_ros.ros.outputs.journal import JournalOutput
from cloth_sim_ros.ros.outputs.objects import ObjectOutput
from cloth_sim_ros.ros.outputs.output import Output
from cloth_sim_ros.ros.outputs.wrenches import RopeEnds, Wrenches

OUTPUTS: list[type[Output]] = [
    ClockOutput,
    ObjectOutput,
    RopeEnds,
    Wrenches,
    CollidersOutput,
    GripperStates,
    JournalOutput,
]
