"""The watch over every body at the end of a frame: what is not finite or ran away is put back, and it alone.

A body in which any particle is bad returns to where all of them were last good (rounded to float32), at rest, with its
history and multipliers forgotten; velocities are not kept, or the same runaway would come again. Where it comes again
from there, frame after frame, that state was not good: the body then returns to its rest shape. Other bodies never
notice.
"""

import warp as wp

from cloth_sim_ros.sim.model import Model
from cloth_sim_ros.sim.schedules.native import load_row, store_row
from cloth_sim_ros.sim.state import State

FARTHEST = wp.constant(1.0e6)  # [m] from the origin
FASTEST = wp.constant(1.0e5)  # [m/s]
RELAPSES = wp.constant(3)  # frames in a row after which a state that was good is so no longer


@wp.func
def is_good(position: wp.vec4, velocity: wp.vec4) -> bool:
    """Whether a particle is finite and within bounds; written so that NaN is not."""
    size = wp.abs(position[0]) + wp.abs(position[1]) + wp.abs(position[2])
    speed = wp.abs(velocity[0]) + wp.abs(velocity[1]) + wp.abs(velocity[2])
    return size < FARTHEST and speed < FASTEST


@wp.func
def keep(g: int, position: wp.vec4, low: wp.vec4, s: State):
    """Particle g of the batch is at `position` plus `low`, and its body is good."""
    store_row(s.positions, g, position)
    store_row(s.good_positions, g, position)
    store_row(s.low, g, low)


@wp.func
def count_fault(b: int, s: State) -> bool:
    """Whether body b was put back in this frame, counted; the next one starts without a fault."""
    faulty = s.faulty[b]
    s.recoveries[b] += faulty
    s.relapses[b] = faulty * (s.relapses[b] + 1)
    s.faulty[b] = 0
    return faulty == 1


@wp.func
def put_back(g: int, relapses: int, m: Model, s: State):
    """Particle g of the batch goes back to where it was last good, at rest, or was at first after too many
    `relapses`."""
    if relapses >= RELAPSES:
        rest = m.rest[g]
        s.good_positions[g] = wp.vec4(rest[0], rest[1], rest[2], s.good_positions[g][3])
    store_row(s.positions, g, load_row(s.good_positions, g))
    store_row(s.low, g, wp.vec4(0.0))
    store_row(s.velocities, g, wp.vec4(0.0))
