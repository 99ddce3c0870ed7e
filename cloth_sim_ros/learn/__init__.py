# SPDX-License-Identifier: Apache-2.0
"""Environments for learning and planning: worlds as a `gymnasium.vector.VectorEnv`, see docs/how-to/learn.md.

task: what all share; fold, hang, route: a towel to be folded, a towel to be hung over a peg, a cable to be laid around
pegs; plan: a planner over worlds that solves them.
"""

import gymnasium

from cloth_sim_ros.learn.fold import FoldTowel
from cloth_sim_ros.learn.hang import HangTowel
from cloth_sim_ros.learn.plan import mppi
from cloth_sim_ros.learn.route import RouteCable

for _name, _module in (("FoldTowel", "fold"), ("HangTowel", "hang"), ("RouteCable", "route")):
    gymnasium.register(f"cloth_sim_ros/{_name}-v0", vector_entry_point=f"cloth_sim_ros.learn.{_module}:{_name}")

__all__ = ["FoldTowel", "HangTowel", "RouteCable", "mppi"]
