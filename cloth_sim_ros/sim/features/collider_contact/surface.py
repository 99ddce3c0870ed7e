# SPDX-License-Identifier: Apache-2.0
"""Contact of a surface between its particles: triangles of cloth and segments of ropes against colliders.

Each facet computes the push on its deepest point, with friction. Then each particle sums the pushes of its facets. The
order of facets does not matter, so all run in parallel.
"""

import warp as wp

from cloth_sim_ros.sim.arrays.context import SEARCH, Context, note_work
from cloth_sim_ros.sim.arrays.model import Features
from cloth_sim_ros.sim.arrays.state import ColliderMotion
from cloth_sim_ros.sim.features.collider_contact.arrays import Press, Sweep
from cloth_sim_ros.sim.features.collider_contact.broad_phase import make_near_of, next_of, note
from cloth_sim_ros.sim.features.collider_contact.facet import CORNER, FAST, Facet, longest_way, point_of, slip_at
from cloth_sim_ros.sim.features.collider_contact.facet_clamp import MOVED, PRESSED, mark
from cloth_sim_ros.sim.features.collider_contact.facet_place import (
    corner_in,
    corners_of,
    facet_of,
    is_close,
    is_stray,
    is_tested,
    make_touched_in,
)
from cloth_sim_ros.sim.features.collider_contact.lean import exact_gap, keep_lean, rubs
from cloth_sim_ros.sim.features.collider_contact.part import make_meet_between, note_parted
from cloth_sim_ros.sim.features.collider_contact.particle import (
    Met,
    Push,
    add_force,
    least_mass,
    make_leave,
    make_touch,
    with_push,
)
from cloth_sim_ros.sim.features.collider_contact.pinch import (
    add_load,
    depth_before_middle,
    is_between,
    is_facet_squeezed,
    keeps_a_corner,
    load_on_facet,
    slack_of,
)
from cloth_sim_ros.sim.features.collider_contact.sweep import NOISE
from cloth_sim_ros.sim.kernels.intrinsics import load4, pack, xyz
from cloth_sim_ros.sim.physics.friction import friction_correction, outward

# Smallest divisor of a push beside a pinned or heavy corner, as a fraction of the largest inverse mass. No other corner
# is then thrown farther than four times the gap.
LEAST_SHARE = wp.constant(0.25)
# Fraction of the triangles around a particle that count as touching at once. At 1 they would lie deep; at half of this
# value, a cloth over a rail shakes by 1e-6 J/kg.
_TOUCH_AT_ONCE = wp.constant(0.67)
# Factor of the inverse mass of a facet that two colliders squeeze. It is bound to its place, and must not overshoot.
_SQUEEZED = wp.constant(1.5)
# Largest distance that friction leaves a sliding facet from its anchor, as a fraction of the thickness. One that was
# pushed away by more is not pulled back.
_MOST_LEFT = wp.constant(0.1)
NOT_YET = wp.constant(1.0e30)  # of a press outside of a rope's solve: the next one within it has no past
LONG_AGO = wp.constant(-2)  # number of a substep that no next one can continue from


@wp.func
def facets_around(i: int, ctx: Context) -> float:
    """Return the number of facets that particle i is a corner of."""
    slot = ctx.body.particles + i
    return float(ctx.model.panel_start[slot + 1] - ctx.model.panel_start[slot])


@wp.func
def yielding(corners: wp.vec3i, weights: wp.vec3, ctx: Context) -> float:
    """Return the inverse mass of a point of a facet [1/kg]; 0 if no corner can move.

    The facets around a particle share its mass (mass splitting, Tonge et al. 2012). Their corrections then add up, and
    move it no farther than one alone would. With more, a cloth over a rail would shake.
    """
    sum = float(0.0)
    most = float(0.0)
    for k in range(3):
        facets = facets_around(corners[k], ctx)
        if corners[1] != corners[2]:
            facets = wp.max(_TOUCH_AT_ONCE * facets, 1.0)
        w = facets * load4(ctx.d, corners[k])[3]
        sum += weights[k] * weights[k] * w
        most = wp.max(most, w)
    return wp.max(sum, LEAST_SHARE * most)


@wp.func
def points_of(corners: wp.vec3i, ctx: Context) -> float:
    """Return the number of points that a facet counts for in a soft collider: its share of each corner."""
    points = float(0.0)
    for k in range(3):
        if k < 2 or corners[2] != corners[1]:
            points += 1.0 / facets_around(corners[k], ctx)
    return points


def _make_rubbed(leans: bool):
    """Return a Warp function: the Press with its friction; `so_far` has the corrections before, and the pressure now.

    A facet that sticks is held where it first touched, not where it was a substep ago, so that it does not creep. Its
    corners share their mass with other facets, so one substep does not bring it back. What is left counts on while it
    slides (return mapping, Simo and Hughes 1998, ch. 1); else friction would act as a part of Coulomb's. A rope has its
    friction in its solve instead. n, and the friction that is returned, are in the collider's axes.
    """

    @wp.func
    def rubbed(
        press: Press, last: Press, facet: Facet, corners: wp.vec3i, n: wp.vec3, friction: wp.vec3, ctx: Context
    ) -> Press:
        found = press
        before, pressed = xyz(press.so_far), press.so_far[3]
        found.stuck = last.stuck
        found.anchor = last.anchor
        if last.when < ctx.substep - 1 or wp.max(last.stuck) == 0.0:
            found.stuck = press.weights
            found.anchor = point_of(facet, press.weights) - slip_at(facet, press.weights)
        elif last.slides == 1:
            left = point_of(facet, last.stuck) - slip_at(facet, last.stuck) - last.anchor
            left *= wp.min(1.0, _MOST_LEFT * ctx.material.thickness / wp.max(wp.length(left), 1.0e-12))
            found.stuck = press.weights
            found.anchor = point_of(facet, press.weights) - slip_at(facet, press.weights) - left
        # Friction acts at the point where the slip is measured.
        found.rubbed = found.stuck
        w = yielding(corners, found.rubbed, ctx)
        slid = point_of(facet, found.stuck) - found.anchor
        slid -= wp.dot(slid, n) * n
        moves = float(1.0)
        if wp.static(leans):
            # Friction within the solve only has its multiplier cut to the cone, see `settled`.
            moves = wp.where(last.lean[3] > 0.0, 0.0, 1.0)
        slid *= moves
        rubbed_before = w * (before - wp.dot(before, n) * n)
        rub = friction_correction(slid, rubbed_before, w * pressed, friction)
        if wp.length_sq(rub - (rubbed_before - slid)) > 0.0:
            if wp.static(leans):
                found.stuck = wp.vec3(0.0)
            else:
                found.anchor += slid + (rub - rubbed_before)
                found.slides = 1
        found.rub = (moves / w) * (rub - rubbed_before)
        found.so_far = pack(rub / w, pressed)
        return found

    return rubbed


def _make_point_on(features: Features):
    """Return a Warp function: the weights of the point at which a collider may press a facet; 0 if there is none.

    It marks the corners of a fast facet that touches.
    """
    touched_in = make_touched_in(features)

    @wp.func
    def point_on(facet: Facet, corners: wp.vec3i, entry: int, collider: ColliderMotion, ctx: Context) -> wp.vec3:
        squeezed = is_facet_squeezed(entry, collider, ctx)
        slack = slack_of(collider, squeezed, ctx.state.contact.presses[entry].when >= ctx.substep - 1)
        weights = touched_in(facet, entry, collider, ctx.material.thickness + slack, ctx)
        if wp.max(weights) > 0.0 and longest_way(facet) > FAST * ctx.material.thickness:
            mark(corners, PRESSED, ctx)  # another of its points may pass through, see facet_clamp.py
        if wp.max(weights) > CORNER and not squeezed:
            return wp.vec3(0.0)
        return weights

    return point_on


def make_press_on(features: Features):
    """Return a Warp function: the Press of a facet against one collider at a point, with friction.

    last: its last Press.
    """
    meet, leans = make_meet_between(features), features.leans
    rubbed = _make_rubbed(leans)

    @wp.func
    def press_on(
        facet: Facet,
        weights: wp.vec3,
        corners: wp.vec3i,
        entry: int,
        collider: ColliderMotion,
        sweep: Sweep,
        last: Press,
        ctx: Context,
    ) -> Press:
        press = Press()
        thickness = ctx.material.thickness
        squeezed = is_facet_squeezed(entry, collider, ctx)
        slack = slack_of(collider, squeezed, last.when >= ctx.substep - 1)
        w = wp.where(squeezed, _SQUEEZED, 1.0) * yielding(corners, weights, ctx)
        if w == 0.0:
            return press
        slip = slip_at(facet, weights)
        p = point_of(facet, weights)
        touching, overlap = meet(corners, weights, collider, sweep, facet, thickness + slack, ctx)
        c = entry % ctx.colliders.shape[0]
        before = wp.where(last.when == ctx.substep, last.so_far, wp.vec4(0.0))
        gap, friction = touching[3] + NOISE, rubs(collider, ctx)
        if wp.static(leans):
            before *= ctx.step.effective * ctx.step.effective
            gap = exact_gap(gap, wp.dot(slip, xyz(touching)), wp.length(p))
            if last.lean[3] > 0.0:
                gap -= last.rounded
                friction = last.friction
        gap += slack
        squeezed = is_between(squeezed, gap, slack, xyz(touching), c, ctx)
        gap = wp.where(keeps_a_corner(corners, collider, ctx), 0.0, gap)
        if gap >= 0.0 and before[3] == 0.0 and not squeezed:
            return press
        gap += depth_before_middle(squeezed, collider, thickness)
        n = xyz(touching)
        softness = collider.compliance * ctx.step.inverse_square / (w * points_of(corners, ctx))
        more = outward(gap, w * before[3], softness) / w
        press.weights = weights
        press.so_far = pack(xyz(before), before[3] + more)
        press = rubbed(press, last, facet, corners, n, friction, ctx)
        back = wp.transpose(sweep.to_local)
        press.normal = back * n
        press.push = more * press.normal
        if overlap > 0.0:
            press.part = wp.clamp(before[3] + more, 0.0, overlap / w)
        press.rub = back * press.rub
        if wp.static(leans):
            press.so_far *= ctx.step.inverse_square
        press.load = load_on_facet(squeezed, c, points_of(corners, ctx), ctx)
        return press

    return press_on


@wp.func
def _keep(found: Press, entry: int, ctx: Context):
    """Store what the stage found; the solve of a rope and the clamp of facets write the other fields."""
    presses = ctx.state.contact.presses
    presses[entry].when = ctx.substep
    presses[entry].stopped = LONG_AGO
    presses[entry].weights = found.weights
    presses[entry].push = found.push
    presses[entry].rubbed = found.rubbed
    presses[entry].rub = found.rub
    presses[entry].normal = found.normal
    presses[entry].so_far = found.so_far
    presses[entry].stuck = found.stuck
    presses[entry].slides = found.slides
    presses[entry].anchor = found.anchor
    presses[entry].load = found.load
    presses[entry].part = found.part


def _make_presses(features: Features):
    """Return a Warp function that stores the Press of a facet against collider c; False if it presses nowhere.

    Most do not: they are told before a Press is made.
    """
    point_on, press_on, leans = _make_point_on(features), make_press_on(features), features.leans

    @wp.func
    def presses(corners: wp.vec3i, entry: int, c: int, ctx: Context) -> bool:
        sweep, collider = ctx.state.contact.sweeps[ctx.sweep + c], ctx.colliders[c]
        if not is_tested(corners, ctx, collider, sweep):
            return False
        facet = facet_of(corners, ctx, sweep)
        weights = point_on(facet, corners, entry, collider, ctx)
        if wp.max(weights) == 0.0:
            return False
        last = ctx.state.contact.presses[entry]
        if wp.static(leans):
            if last.lean[3] > 0.0:
                weights = last.weights  # the same point as in the solve
        found = press_on(facet, weights, corners, entry, collider, sweep, last, ctx)
        if wp.max(found.weights) == 0.0:
            return False
        _keep(found, entry, ctx)
        if wp.static(leans):
            if last.lean[3] == 0.0:
                ctx.state.contact.presses[entry].eased = NOT_YET
        return True

    return presses


def make_press(features: Features):
    """Return the stage that computes the pushes of all colliders on the facets of a body.

    Thread t of `width` does its share.
    """
    presses, near_of, leans = _make_presses(features), make_near_of(features.listed), features.leans

    @wp.func
    def press(t: int, width: int, ctx: Context):
        colliders, near = ctx.colliders.shape[0], near_of(ctx)
        if wp.static(leans):
            for k in range(t, ctx.body.count - 1, width):
                keep_lean(k, near, ctx)
        for k in range(ctx.body.panels + t, ctx.body.panels_end, width):
            corners = corners_of(k, ctx)
            whole = bool(True)
            if wp.static(features.tears):
                whole = corners[0] != corners[1]  # a triangle that failed
            if whole and is_close(corners, ctx):
                stray = is_stray(corners, near, ctx)
                c = next_of(-1, near, stray)
                while c < colliders:
                    entry = k * colliders + c
                    if presses(corners, entry, c, ctx):
                        note_work(SEARCH, ctx)
                        note(c, near)
                        mark(corners, PRESSED, ctx)
                    elif ctx.state.contact.presses[entry].when == ctx.substep:
                        # The push of an earlier iteration was enough.
                        ctx.state.contact.presses[entry].push = wp.vec3(0.0)
                        ctx.state.contact.presses[entry].rub = wp.vec3(0.0)
                        ctx.state.contact.presses[entry].load = 0.0
                    c = next_of(c, near, stray)

    return press


@wp.struct
class Yield:
    """Sums over the facets around a particle, of what one collider does to them.

    wanted: correction over the inverse mass [kg m]. parting: the part of it that ends overlaps, see part.py [kg m].
    normal: that of the collider, weighted by the pushes [kg m].
    """

    wanted: wp.vec3
    parting: wp.vec3
    normal: wp.vec3


@wp.func
def yield_of(i: int, c: int, ctx: Context) -> Yield:
    """Return what collider c does to the facets around particle i, as far as the particle takes it."""
    slot, found = ctx.body.particles + i, Yield()
    for place in range(ctx.model.panel_start[slot], ctx.model.panel_start[slot + 1]):
        q = ctx.model.particle_panels[place]
        press = ctx.state.contact.presses[q * ctx.colliders.shape[0] + c]
        if press.when == ctx.substep:
            k = corner_in(q, i, ctx)
            share = press.weights[k] * press.push + press.rubbed[k] * press.rub
            found.wanted += share
            found.normal += wp.length(share) * press.normal
            found.parting += press.weights[k] * press.part * press.normal
    return found


def _make_leaned(features: Features):
    """Return a Warp function that adds to forces what colliders did to segments around particle i in the solve.

    It returns the push by those that hit them.
    """

    @wp.func
    def leaned(i: int, w: float, met: Met, ctx: Context) -> Push:
        push = Push()
        if not ctx.last:
            return push
        for place in range(ctx.model.panel_start[met.slot], ctx.model.panel_start[met.slot + 1]):
            q = ctx.model.particle_panels[place]
            first = corners_of(q, ctx)[0] == i
            for c in range(ctx.colliders.shape[0]):
                at = q * ctx.colliders.shape[0] + c
                lean = ctx.state.contact.presses[at].lean
                if ctx.state.contact.presses[at].when == ctx.substep and lean[3] > 0.0:
                    weights, acted = ctx.state.contact.presses[at].weights, ctx.state.contact.presses[at].acted
                    share = wp.where(first, weights[0], weights[1] + weights[2]) * acted
                    entry = met.slot * ctx.colliders.shape[0] + c
                    add_force(entry, met.share * share, ctx)
                    n, motion = xyz(lean), ctx.state.contact.sweeps[ctx.sweep + c].motion
                    if wp.static(features.order == 2):
                        if ctx.state.contact.presses[at].hits == 1:
                            push = with_push(push, n, w * wp.dot(share, n), motion, entry)
        return push

    return leaned


def make_yield(features: Features):
    """Return the stage that moves particle i as its facets are pressed."""
    least, touch = least_mass(features), make_touch(features)
    leave, leaned = make_leave(features), _make_leaned(features)

    @wp.func
    def give_way(i: int, met: Met, ctx: Context):
        packed = load4(ctx.d, i)
        w = packed[3]
        if w <= wp.static(least) * load4(ctx.x, i)[3]:
            return
        touched, push, displacement = bool(False), Push(), xyz(packed)
        parted, motion = wp.vec3(0.0), wp.vec3(0.0)
        if wp.static(features.leans):
            push = leaned(i, w, met, ctx)
        marks = ctx.state.contact.pressed[met.slot]
        if marks & PRESSED == 0:
            if push.pressed > 0.0:
                leave(i, displacement, push, (1.0 / push.pressed) * push.motion, met, ctx)
            return
        ctx.state.contact.pressed[met.slot] = MOVED
        ctx.state.contact.facets_moved_in[ctx.body.index] = ctx.substep + 1
        c = next_of(-1, met.near, False)
        while c < ctx.colliders.shape[0]:
            add_load(i, c, ctx)
            found = yield_of(i, c, ctx)
            correction = w * found.wanted
            if wp.length_sq(correction) > 0.0:
                displacement += correction
                parted += w * found.parting
                entry = met.slot * ctx.colliders.shape[0] + c
                add_force(entry, (met.share / w) * correction, ctx)
                touched = True
                motion = ctx.state.contact.sweeps[ctx.sweep + c].motion
                if wp.static(features.order == 2):
                    n = wp.normalize(found.normal)
                    push = with_push(push, n, wp.dot(correction, n), motion, entry)
            c = next_of(c, met.near, False)
        if touched:
            note_parted(i, parted, ctx)
            leave(i, displacement, push, motion, met, ctx)
            # Its facets may have moved the particle into a collider, so its own contact acts last.
            met.carries = False
            touch(i, met, ctx, 0.0)

    return give_way


def make_carry_presses(features: Features):
    """Return the stage that begins a frame: the first substep continues from the presses of the last one before."""
    near_of = make_near_of(features.listed)

    @wp.func
    def carry_presses(t: int, width: int, ctx: Context):
        colliders, near = ctx.colliders.shape[0], near_of(ctx)
        taken = ctx.state.control.taken[ctx.body.index]
        c = next_of(-1, near, False)
        while c < colliders:
            for k in range(ctx.body.panels + t, ctx.body.panels_end, width):
                entry = k * colliders + c
                was = ctx.state.contact.presses[entry].when
                ctx.state.contact.presses[entry].when = wp.where(was == taken - 1, -1, LONG_AGO)
                ctx.state.contact.presses[entry].stopped = LONG_AGO
                ctx.state.contact.looks[entry].known = 0
            c = next_of(c, near, False)

    return carry_presses
