# SPDX-License-Identifier: Apache-2.0
"""A winch at the start of a rope: it changes the rest length of the segment between the drum and the rope.

All particles of a rope exist from the beginning. Those still on the drum lie at its point, held, with no length between
them. `WinchState.index` is the last of them, and the segment that begins there is fed. A segment is born when the fed
one is longer than one and a half segments. The particle at the drum is then released where one whole segment ends, and
the rest is fed on. The fed segment is swallowed when it is shorter than nearly half a segment. The drum then takes in
the particle at its other end. So no segment gets so short that its mass or length would stiffen the solve.

None of this causes a jump. Fed material enters at the pay-out rate of unstretched rope. A born particle lies on its
segment at the place of its material, so that both parts keep the strain. It moves as that material does: with the rope
ahead and with the feed behind it. If a segment is swallowed, the merged segment has the mean strain of the two. A bend
between them would pull it taut, so that length is added to `backlog` and fed little by little. The particle next to the
drum has the mass of the part of its two half segments that is out.

The drum is a hinge: a rope with bending stiffness leaves it in any direction. A joint that has just come out begins
straight.
"""

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context
from cloth_sim_ros.sim.arrays.model import Body, Model
from cloth_sim_ros.sim.features.winch.arrays import WinchState
from cloth_sim_ros.sim.kernels.intrinsics import load4, store4, xyz
from cloth_sim_ros.sim.physics.integrate import split_sum

BORN = wp.constant(0.5)  # excess over its own length that splits the fed segment, as a fraction of the next one
SWALLOWED = wp.constant(0.45)  # fraction of its own length below which the fed segment joins the next
SHORTEST = wp.constant(0.5)  # length that stays out, as a fraction of the last segment
REACHED = wp.constant(1.0e-5)  # distance from a length limit that counts as reached, as a fraction of the rope
SETTLING = wp.constant(0.2)  # time in which the backlog is fed [s]


@wp.func
def braking(room: float, acceleration: float, h: float) -> float:
    """The fastest rate [m/s] from which `room` [m] is enough to stop in, sqrt(2 a s); 0 beyond a limit."""
    left = wp.max(room, 0.0)
    return wp.min(wp.sqrt(2.0 * acceleration * left), left / h)


@wp.func
def next_rate(
    rate: float, wanted: float, most: float, acceleration: float, room: float, slack: float, h: float
) -> float:
    """The pay-out rate [m/s] of the next substep of length h [s], below 0 for hauling in.

    It nears `wanted`, within `most` both ways, by at most `acceleration` [m/s^2], and stops where the `room` [m] to
    pay out or the `slack` [m] to haul in ends.
    """
    goal = wp.clamp(wanted, -most, most)
    rate = wp.clamp(goal, rate - acceleration * h, rate + acceleration * h)
    return wp.clamp(rate, -braking(slack, acceleration, h), braking(room, acceleration, h))


@wp.func
def density_at(k: int, m: Model, body: Body) -> float:
    """Return the rope's mass per length [kg/m] at segment k: the smaller of its two ends, which leaves out loads."""
    at = body.segments + k
    i = body.particles + k
    before = wp.where(k > 0, m.segment_length[wp.max(at - 1, 0)], 0.0)
    after = wp.where(at + 1 < body.segments_end, m.segment_length[wp.min(at + 1, body.segments_end - 1)], 0.0)
    near = m.particle_masses[i] / (before + m.segment_length[at])
    far = m.particle_masses[i + 1] / (after + m.segment_length[at])
    return 2.0 * wp.min(near, far)


@wp.func
def mass_beyond(winch: WinchState, m: Model, body: Body) -> float:
    """Return the mass [kg] of the particle after the drum, with the part of its segment that is out."""
    k = winch.index
    lacks = m.segment_length[body.segments + k] - winch.length
    return m.particle_masses[body.particles + k + 1] - 0.5 * density_at(k, m, body) * lacks


@wp.func
def weigh(i: int, mass: float, x: wp.uint64):
    """Give particle i of the body a mass [kg], unless it is held."""
    p = load4(x, i)
    if p[3] > 0.0:
        store4(x, i, wp.vec4(p[0], p[1], p[2], 1.0 / mass))


def _make_swallow(order: int):
    """Return a Warp function that takes the first segment that is out onto the drum."""

    @wp.func
    def swallow(winch: WinchState, ctx: Context) -> WinchState:
        k = winch.index
        g = ctx.body.particles + k
        drum = load4(ctx.x, k)
        drum_low = load4(ctx.position_lo, k)
        middle = load4(ctx.x, k + 1)
        middle_low = load4(ctx.position_lo, k + 1)
        first = xyz(middle - drum) + xyz(middle_low - drum_low)
        second = xyz(load4(ctx.x, k + 2) - middle) + xyz(load4(ctx.position_lo, k + 2) - middle_low)
        following = ctx.model.segment_length[ctx.body.segments + k + 1]
        whole = winch.length + following
        straight = wp.length(first + second) / wp.max(wp.length(first) + wp.length(second), 1.0e-12)
        length = wp.clamp(straight * whole, SHORTEST * following, whole)
        winch.backlog += whole - length
        winch.length = length
        winch.behind -= following
        winch.index = k + 1
        store4(ctx.x, k + 1, wp.vec4(drum[0], drum[1], drum[2], 0.0))
        store4(ctx.position_lo, k + 1, drum_low)
        ctx.state.velocities[g + 1] = wp.vec4(0.0)
        ctx.state.rope.tensions[ctx.body.segments + k] = 0.0
        if wp.static(order == 2):
            ctx.state.last_velocities[g + 1] = wp.vec3(0.0)
            ctx.state.last_displacements[g + 1] = wp.vec3(0.0)
        return winch

    return swallow


def _make_bear(order: int):
    """Return a Warp function that lets another segment begin between the drum and the first one that is out."""

    @wp.func
    def bear(winch: WinchState, h: float, ctx: Context) -> WinchState:
        k = winch.index
        g = ctx.body.particles + k
        drum = load4(ctx.x, k)
        drum_low = xyz(load4(ctx.position_lo, k))
        e = xyz(load4(ctx.x, k + 1) - drum) + (xyz(load4(ctx.position_lo, k + 1)) - drum_low)
        own = ctx.model.segment_length[ctx.body.segments + k]
        part = own / winch.length
        away = drum_low + (1.0 - part) * e
        position = xyz(drum)
        rest = split_sum(position, away)
        position += away
        # Velocity of the material at this place: (1 - part) of the rope ahead, and `part` of the feed.
        feed = (part * winch.rate / winch.length) * e
        velocity = (1.0 - part) * xyz(ctx.state.velocities[g + 1]) + feed
        store4(ctx.x, k, wp.vec4(position[0], position[1], position[2], 1.0 / ctx.model.particle_masses[g]))
        store4(ctx.position_lo, k, wp.vec4(rest[0], rest[1], rest[2], 0.0))
        ctx.state.velocities[g] = wp.vec4(velocity[0], velocity[1], velocity[2], 0.0)
        if wp.static(order == 2):
            ctx.state.last_velocities[g] = (1.0 - part) * ctx.state.last_velocities[g + 1] + feed
            ctx.state.last_displacements[g] = (1.0 - part) * ctx.state.last_displacements[g + 1] + h * feed
        ctx.state.rope.tensions[ctx.body.segments + k - 1] = ctx.state.rope.tensions[ctx.body.segments + k]
        weigh(k + 1, ctx.model.particle_masses[g + 1], ctx.x)
        winch.length -= own
        winch.behind += own
        winch.index = k - 1
        return winch

    return bear


def make_turn(order: int):
    """Return a Warp function in which one thread turns a body's drum at the start of a substep."""
    swallow, bear = _make_swallow(order), _make_bear(order)

    @wp.func
    def turn(i: int, ctx: Context):
        drive, h = ctx.drive, ctx.frame.dt
        winch = ctx.state.winch.winches[ctx.body.index]
        last = ctx.body.segments_end - ctx.body.segments - 1
        while (
            winch.index < last and winch.length < SWALLOWED * ctx.model.segment_length[ctx.body.segments + winch.index]
        ):
            winch = swallow(winch, ctx)
        while winch.index > 0 and winch.length >= (
            ctx.model.segment_length[ctx.body.segments + winch.index]
            + BORN * ctx.model.segment_length[ctx.body.segments + winch.index - 1]
        ):
            winch = bear(winch, h, ctx)
        out = winch.behind + winch.length + winch.backlog
        shortest = wp.max(drive.shortest, SHORTEST * ctx.model.segment_length[ctx.body.segments_end - 1])
        longest = wp.min(drive.longest, winch.total)
        room = longest - out
        slack = out - wp.max(winch.backlog, 0.0) - shortest  # the backlog cannot be hauled in
        winch.rate = next_rate(winch.rate, drive.pay_out, drive.max_rate, drive.acceleration, room, slack, h)
        near = REACHED * winch.total
        winch.stopped = 0
        if (drive.pay_out > 0.0 and room < near) or (drive.pay_out < 0.0 and slack < near):
            winch.stopped = 1
        returned = winch.backlog * wp.min(h / SETTLING, 1.0)
        fed = winch.rate * h + returned
        length = winch.length + fed
        winch.last_fed = winch.fed
        winch.fed = length - winch.length
        winch.backlog += (fed - winch.fed) - returned  # includes the rounding error of the length
        winch.length = length
        weigh(winch.index + 1, mass_beyond(winch, ctx.model, ctx.body), ctx.x)
        ctx.state.winch.winches[ctx.body.index] = winch

    return turn


@wp.func
def joint_out(j: int, joint: wp.vec4, winch: WinchState) -> wp.vec4:
    """Return joint j as in Model.joints, with the present length of the fed segment; without weights on the drum."""
    if j < winch.index:
        return wp.vec4(0.0, 1.0, 0.0, 0.0)
    if j > winch.index:
        return joint
    return wp.vec4(0.0, joint[1] + 0.5 * (winch.length - 1.0 / joint[2]), 1.0 / winch.length, joint[3])
