# SPDX-License-Identifier: Apache-2.0
"""Environments for learning and planning: worlds as a `gymnasium.vector.VectorEnv`, see docs/how-to/learn.md.

task: the common part; fold, hang, route: fold a towel, hang a towel over a peg, lay a cable around pegs; single: one
world as a `gymnasium.Env`; plan: a planner over worlds that solves them.
"""

from functools import partial

import gymnasium

from cloth_sim_ros.learn.fold import FoldTowel
from cloth_sim_ros.learn.hang import HangTowel
from cloth_sim_ros.learn.plan import mppi
from cloth_sim_ros.learn.route import RouteCable
from cloth_sim_ros.learn.single import Single

for _task in (FoldTowel, HangTowel, RouteCable):
    _id = f"cloth_sim_ros/{_task.__name__}-v0"
    gymnasium.register(_id, entry_point=partial(Single, _task), vector_entry_point=_task)

__all__ = ["FoldTowel", "HangTowel", "RouteCable", "mppi"]
