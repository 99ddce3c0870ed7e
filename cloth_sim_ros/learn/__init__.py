# SPDX-License-Identifier: Apache-2.0
"""Environments for learning and planning: worlds as a `gymnasium.vector.VectorEnv`, see docs/how-to/learn.md.

fold: a towel to be folded in half; plan: a planner over worlds that folds it.
"""

import gymnasium

from cloth_sim_ros.learn.fold import FoldTowel
from cloth_sim_ros.learn.plan import mppi

gymnasium.register("cloth_sim_ros/FoldTowel-v0", vector_entry_point="cloth_sim_ros.learn.fold:FoldTowel")

__all__ = ["FoldTowel", "mppi"]
