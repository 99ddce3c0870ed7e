# SPDX-License-Identifier: Apache-2.0
"""Constraints between two particles, XPBD (Macklin, Mueller, Chentanez 2016), in two passes without a conflict.

Each constraint finds its pull, then each particle adds those around it. Constraints at one particle share its mass
(mass splitting, Tonge 2012), so that the sum is stable and independent of an order.
"""

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context
from cloth_sim_ros.sim.arrays.model import Features
from cloth_sim_ros.sim.features.stage import Stage, over_particles
from cloth_sim_ros.sim.kernels.intrinsics import load4, load_row, pack, store4, store_row, xyz
from cloth_sim_ros.sim.physics.distance import SHORTEST
from cloth_sim_ros.sim.scene.constraints import make_law


@wp.func
def _shared_inverse_mass(w: float, i: int, ctx: Context) -> float:
    """Return the inverse mass of the part of particle i that each of its constraints has [1/kg]."""
    g = ctx.body.particles + i
    return w * float(ctx.model.constraint_start[g + 1] - ctx.model.constraint_start[g])


def make_stages(features: Features) -> list[Stage]:
    """Return the two stages."""
    law = make_law(features.constraints)

    @wp.func
    def pull(t: int, width: int, ctx: Context):
        for e in range(ctx.body.constraints + t, ctx.body.constraints_end, width):
            ends, of = ctx.model.constraint_ends[e], ctx.model.constraint_of[e]
            first, second = load4(ctx.d, ends[0]), load4(ctx.d, ends[1])
            way = xyz(load4(ctx.x, ends[0]) - load4(ctx.x, ends[1])) + xyz(first - second)
            distance = wp.length(way)
            allowed = law(of[1], distance, ctx.model.constraint_rests[e], ctx.numbers[of[0]].values)
            softness = allowed[1] / (ctx.step.effective * ctx.step.effective)
            so_far = float(0.0)
            if not ctx.step.first:
                so_far = load_row(ctx.state.constraints.constraint_pulls, e)[3]
            inverse = _shared_inverse_mass(first[3], ends[0], ctx) + _shared_inverse_mass(second[3], ends[1], ctx)
            more = float(0.0)
            if inverse > 0.0:
                more = (distance - allowed[0] - softness * so_far) / (inverse + softness)
            toward = way * (-more / wp.max(distance, SHORTEST))
            store_row(ctx.state.constraints.constraint_pulls, e, pack(toward, so_far + more))

    @wp.func
    def move(i: int, ctx: Context):
        g = ctx.body.particles + i
        moved = wp.vec3(0.0)
        for q in range(ctx.model.constraint_start[g], ctx.model.constraint_start[g + 1]):
            entry = ctx.model.constraint_entries[q]
            pulled = xyz(load_row(ctx.state.constraints.constraint_pulls, wp.abs(entry) - 1))
            moved += wp.where(entry > 0, 1.0, -1.0) * pulled
        d = load4(ctx.d, i)
        store4(ctx.d, i, d + pack(d[3] * moved, 0.0))

    return [Stage("pull_together", pull), over_particles("move_together", move)]
