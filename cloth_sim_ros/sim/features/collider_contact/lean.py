# SPDX-License-Identifier: Apache-2.0
"""Contact of a rope within its solve, as an augmented Lagrangian of Coulomb's law.

A collider that corrects a point by p_0 so far, in a place `gap` above it and after a slip s, corrects it by

    p = (p_0n - R gap) n + (p_0t - R s)    while that is within the cone of friction,

with p_n >= 0, and with the tangential part cut to the cone where it slides. R, a ratio of a contact's stiffness to the
mass of the point, is finite, so that the rope is solved with the contact as one more spring. The multiplier p is
carried to the next substep, so that R does not matter for what rests (Alart and Curnier 1991; Daviet 2020, Simple and
scalable frictional contacts for thin nodal objects). Where a solve leaves a contact that pulls, or friction that is not
Coulomb's, the rope is solved again with what the law allows. The stages behind the solve take what R left.

Points are particles, and those of segments that a collider touches between its particles.
"""

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context, note_searches
from cloth_sim_ros.sim.arrays.model import Features
from cloth_sim_ros.sim.arrays.state import ColliderMotion
from cloth_sim_ros.sim.colliders import make_signed_distance
from cloth_sim_ros.sim.features.collider_contact.arrays import Lean, Press, Sweep
from cloth_sim_ros.sim.features.collider_contact.broad_phase import Near, next_of, strays
from cloth_sim_ros.sim.features.collider_contact.facet import CORNER, FAST, Facet, longest_way, point_of, slip_at
from cloth_sim_ros.sim.features.collider_contact.facet_place import corners_of, facet_of, is_tested, make_touched_in
from cloth_sim_ros.sim.features.collider_contact.facet_search import make_deepest
from cloth_sim_ros.sim.features.collider_contact.part import make_meet, make_meet_between
from cloth_sim_ros.sim.features.collider_contact.pinch import is_squeezed
from cloth_sim_ros.sim.features.collider_contact.sweep import NOISE, least_gap, slip_of
from cloth_sim_ros.sim.features.grasp.hold import HELD
from cloth_sim_ros.sim.kernels.intrinsics import load4, load_row, pack, store_row, xyz
from cloth_sim_ros.sim.physics.distance import SHORTEST
from cloth_sim_ros.sim.physics.friction import SLOW, coefficient, friction_correction, outward
from cloth_sim_ros.sim.ropes.arrays import Between, Point

# R in effective steps of SHORT [s]. In a shorter one it falls with the square, as a rounding error of a gap would make
# ever more force. Below LEAST, contacts would open and close, and lose their friction. In longer steps it is as stiff
# as its rope is along the normal, up to its stiffness in SHORT. What a softer one leaves, the stage behind would press
# into the rope as energy: a rod of 100 segments that leans on a wall climbed up. A stiffer one jams on a peg.
RATIO = wp.constant(100.0)
SHORT, LEAST = wp.constant(1.0e-4), wp.constant(10.0)
OFF = wp.constant(0.1)  # error of a segment's friction, as a fraction of the most, above which a rope is solved again
WRONG = wp.constant(0.02)  # error of a particle's friction, likewise
FULL = wp.constant(4)  # solves of a rope in a substep after which friction that may stop a point is a dashpot
# States of a contact. Friction of a DASHPOT turns no motion round.
DASHPOT, STICKS = wp.constant(1.0), wp.constant(2.0)
SLIDES = wp.constant(3.0)  # state of a contact whose friction does not depend on how far the solve moves it
# Heights by which the ends of a segment are moved to see which part of it a collider may press, over the thickness.
TILT = wp.constant(3.0e-2)
UNSURE = wp.constant(4.0)  # errors of the searches that tell by how much a face is rounded, in NOISE
WITHIN = wp.constant(1.5)  # distance at which a segment is watched in the solve, as a multiple of the thickness
ROUNDING = wp.constant(2.4e-7)  # rounding error of a gap as a fraction of the distance from the collider's origin


@wp.func
def ratio_of(first: int, last: int, w: float, n: wp.vec3, ctx: Context) -> float:
    """Return R of a point of inverse mass w [1/kg] of a rope that is pressed along n, beside these of its segments."""
    pull = float(0.0)
    for k in range(wp.max(first, 0), wp.min(last, ctx.body.count - 2) + 1):
        way = xyz(load4(ctx.x, k + 1) - load4(ctx.x, k))
        along = wp.dot(way, n) / wp.max(wp.length(way), SHORTEST)
        pull = wp.max(pull, along * along / ctx.model.segment_length[ctx.body.segments + k])
    square = (ctx.step.effective / SHORT) * (ctx.step.effective / SHORT)
    yields = ctx.material.compliance[0] * ctx.step.inverse_square
    least, most = wp.max(RATIO * wp.min(square, 1.0), LEAST), RATIO * wp.max(square, 1.0)
    return wp.clamp(w * pull / wp.max(yields, 1.0e-20), least, most)


@wp.func
def ratio_at(i: int, w: float, n: wp.vec3, ctx: Context) -> float:
    """Return R of particle i of a rope, likewise."""
    return ratio_of(i - 1, i, w, n, ctx)


@wp.func
def ratio_along(ratio: float, softness: float) -> float:
    """Return R along the normal of a collider; softness: its compliance over the point's inverse mass x h^2."""
    return ratio / (1.0 + ratio * softness)


@wp.func
def slope_of(n: wp.vec3, ratio: float, softness: float, state: float, p: wp.vec3) -> wp.mat33:
    """Return by how much a correction p [m] falls while the solve moves its point by a metre in each direction.

    ratio: R. state: of the contact, see `augmented`.
    """
    along, rub = wp.outer(n, n), p - wp.dot(p, n) * n
    across, rubbed = wp.identity(n=3, dtype=float) - along, state - 1.0
    if state >= SLIDES:
        rubbed = state - SLIDES
        across -= wp.outer(rub, rub) / wp.max(wp.length_sq(rub), 1.0e-30)
    return ratio_along(ratio, softness) * along + (ratio * rubbed) * across


@wp.func
def exact_gap(gap: float, opened: float, size: float) -> float:
    """Return a gap [m], whose part before this substep counts as 0 if rounding at that size [m] may be all of it.

    opened: the part in this substep [m], known with more digits. R times the rounding error would exceed a weight.
    """
    before = gap - opened
    return opened + wp.sign(before) * wp.max(wp.abs(before) - ROUNDING * size, 0.0)


@wp.func
def half_turn_of(i: int, ctx: Context) -> float:
    """Return half the angle [rad] by which a rope turns at particle i; 0 at its ends."""
    if i == 0 or i + 1 == ctx.body.count:
        return 0.0
    here = xyz(load4(ctx.x, i)) + xyz(load4(ctx.d, i))
    first = here - (xyz(load4(ctx.x, i - 1)) + xyz(load4(ctx.d, i - 1)))
    last = (xyz(load4(ctx.x, i + 1)) + xyz(load4(ctx.d, i + 1))) - here
    return 0.5 * wp.atan2(wp.length(wp.cross(first, last)), wp.dot(first, last))


@wp.func
def along_corner(mu: float, half_turn: float) -> float:
    """Return the coefficient with which a corner of a rope rubs as the curve does that it stands for.

    Over an angle t the tension of a curve grows by exp(mu t) (Euler and Eytelwein). At a corner that is pressed along
    its bisector it grows by (1 + m tan(t/2)) / (1 - m tan(t/2)); m is returned.
    """
    if half_turn < 1.0e-3:
        return mu
    return wp.tanh(mu * half_turn) / wp.tan(wp.min(half_turn, 1.5))


@wp.func
def rubs(collider: ColliderMotion, ctx: Context) -> wp.vec3:
    """Return the friction of a body on a collider, see `coefficient` of physics/friction.py."""
    static = wp.sqrt(ctx.material.static_friction * collider.static_friction)
    kinetic = wp.sqrt(ctx.material.kinetic_friction * collider.kinetic_friction)
    return wp.vec3(static, kinetic, SLOW * ctx.frame.dt)


@wp.func
def friction_of(collider: ColliderMotion, half_turn: float, ctx: Context) -> wp.vec3:
    """Return the friction of a body on a collider, at such a corner of a rope."""
    mu = rubs(collider, ctx)
    return wp.vec3(along_corner(mu[0], half_turn), along_corner(mu[1], half_turn), mu[2])


@wp.func
def _load_on(k: int, c: int, ctx: Context) -> float:
    """Return the force [N] by which collider c pressed segment k in the last substep."""
    if k < 0 or k + 1 >= ctx.body.count:
        return 0.0
    press = ctx.state.contact.presses[(ctx.body.panels + k) * ctx.colliders.shape[0] + c]
    return wp.where(press.when >= ctx.substep - 1, wp.max(press.so_far[3], 0.0), 0.0)


@wp.func
def along_segment(mu: float, turn: float, lever: float) -> float:
    """Return the coefficient with which a segment that is pressed at one point rubs as the curve that it stands for.

    turn: of that curve [rad]. lever: weight of the end with less tension over that of the other, of the point. The
    forces on both ends have the ratio exp(mu turn) and, by their moments about the point, the angles to the segment
    a and turn - a.
    """
    if turn < 1.0e-3:
        return mu
    ratio, within = wp.exp(mu * turn), wp.min(turn, 1.5)
    a = wp.atan2(wp.sin(within), ratio * lever + wp.cos(within))
    rubbed = ratio * wp.cos(a) - wp.cos(within - a)
    return wp.max(rubbed, 0.0) / (ratio * wp.sin(a) + wp.sin(within - a))


@wp.func
def _turn_beside(k: int, beside: int, i: int, c: int, ctx: Context) -> float:
    """Return the part of a rope's turn at particle i [rad] for which segment k stands, not the one `beside` it."""
    turn = 2.0 * ctx.state.rope.half_turns[ctx.body.particles + i]
    load, other = _load_on(k, c, ctx), _load_on(beside, c, ctx)
    return wp.where(other > 0.0, turn * load / wp.max(load + other, 1.0e-20), turn)


@wp.func
def friction_between(k: int, c: int, weights: wp.vec3, forward: float, ctx: Context) -> wp.vec3:
    """Return the friction of segment k of a rope on collider c.

    weights: of the point that is pressed. forward: above 0 if friction acts towards its end. A neighbour that is
    pressed too takes its part of the turn between them, without a jump as it lifts off: that would shake the rope. It
    holds while the rope is solved. The stage behind changes how neighbours were pressed last.
    """
    mu = rubs(ctx.colliders[c], ctx)
    turn = _turn_beside(k, k - 1, k, c, ctx) + _turn_beside(k, k + 1, k + 1, c, ctx)
    lever = wp.clamp((weights[1] + weights[2]) / wp.max(weights[0], 1.0e-3), 0.5, 2.0)
    lever = wp.where(forward > 0.0, lever, 1.0 / lever)
    return wp.vec3(along_segment(mu[0], turn, lever), along_segment(mu[1], turn, lever), mu[2])


@wp.func
def slack_of(ratio: float, size: float) -> float:
    """Return what of a correction [m] may be rounding at that distance from the collider's origin [m].

    It does not part a point from the collider, nor let it slide before it is loaded.
    """
    return ratio * ROUNDING * size


@wp.func
def augmented(
    before: wp.vec3,
    met: wp.vec4,
    slip: wp.vec3,
    size: float,
    ratio: float,
    softness: float,
    friction: wp.vec3,
    unless_free: float,
) -> wp.vec4:
    """Return the correction [m] of a point by a collider, and the state of the contact, also if they are apart.

    Then the correction points into the collider. The state is 2 where it sticks, and less where it slides; from SLIDES
    on it slides freely.

    before: correction so far [m]; met: normal and gap [m]; slip: of the point on the collider [m]; size: distance from
    the collider's origin [m]. All are in the collider's axes. ratio: R. friction: see `coefficient`.
    unless_free: state where friction may stop the point: DASHPOT, STICKS or SLIDES.
    """
    n = xyz(met)
    gap = exact_gap(met[3], wp.dot(slip, n), size)
    pressed = (wp.dot(before, n) / ratio - gap) * ratio_along(ratio, softness)
    slack = slack_of(ratio, size)
    rub, cone = (before - wp.dot(before, n) * n) - ratio * (slip - wp.dot(slip, n) * n), wp.max(pressed, 0.0)
    most = friction[0] * cone
    if wp.length_sq(before) == 0.0 and pressed <= slack and friction[0] > 0.0:
        most = slack
    if wp.length(rub) <= most:
        return pack(pressed * n + rub, STICKS)
    kinetic = coefficient(friction, wp.max(wp.length(rub) - friction[0] * cone, 0.0) / ratio)
    rubbed = kinetic * cone / wp.length(rub)
    # Friction that cannot stop the point in this substep has its full size. Else it is like a dashpot, and never turns
    # a motion round.
    free = kinetic * cone < wp.length(slip - wp.dot(slip, n) * n)
    if unless_free == STICKS and not free:
        return pack(pressed * n + rub, STICKS)
    return pack(pressed * n + rubbed * rub, wp.where(free, SLIDES, unless_free) + rubbed)


@wp.func
def settled(before: wp.vec3, n: wp.vec3, gap: float, slip: wp.vec3, softness: float, friction: wp.vec3):
    """Return the multiplier (3,) [m] of a point after the solve, and how it moves to where it touches (3,) [m].

    before: correction in the solve. slip: what is left of it along the collider. The multiplier meets Coulomb's law,
    and acts so in the next substep. A light particle of a stiff rope would fly off if it moved by what it now has less.
    """
    pressed = wp.max(wp.dot(before, n), 0.0)
    out = outward(gap, pressed, softness)
    pressed += out
    wanted = (before - wp.dot(before, n) * n) - slip
    sticks = wp.length(wanted) <= friction[0] * pressed
    rub = friction_correction(wp.vec3(0.0), wanted, pressed, friction)
    return pressed * n + rub, wp.where(sticks, out * n - slip, out * n)


@wp.func
def solved_lean(i: int, c: int, entry: int, w: float, moved: wp.vec3, ctx: Context) -> wp.vec3:
    """Return the correction [m] of particle i by collider c, in its axes, after the solve `moved` the particle [m]."""
    contact, to_local = ctx.state.contact.leans[entry].contact, ctx.state.contact.sweeps[ctx.sweep + c].to_local
    before = (ctx.step.effective * ctx.step.effective) * xyz(load_row(ctx.state.contact.contacts, entry))
    softness = ctx.colliders[c].compliance * ctx.step.inverse_square / w
    local = wp.transpose(to_local) * before
    return before - to_local * (
        slope_of(xyz(contact), ratio_at(i, w, xyz(contact), ctx), softness, contact[3], local) * moved
    )


@wp.func
def _rubs_wrongly(wanted: wp.vec3, solved: wp.vec3, before: wp.vec3, n: wp.vec3, friction: wp.vec3) -> bool:
    """Return True if the friction that a solve left, part of the correction `solved` [m], is not Coulomb's.

    wanted: the correction that would stop the point. The load that bounds it is the mean before and after the solve,
    as it alternates in long ones.
    """
    load = 0.5 * (wp.max(wp.dot(before, n), 0.0) + wp.max(wp.dot(solved, n), 0.0))
    rub = friction_correction(wp.vec3(0.0), wanted - wp.dot(wanted, n) * n, load, friction)
    most = friction[1] * load
    return most > 0.0 and wp.length((solved - wp.dot(solved, n) * n) - rub) > WRONG * most


@wp.func
def _friction_at(k: int) -> float:
    """Return the state of a contact whose friction may stop a particle, in solve k of a substep (see `augmented`).

    The first one tries to stop it. Where this asks for too much, the others let it slide. Where FULL of them do not
    end, friction is a dashpot.
    """
    return wp.where(k == 0, STICKS, wp.where(k < FULL, SLIDES, DASHPOT))


def make_lean(features: Features):
    """Return a Warp function that finds what colliders do to particle i before solve `k` of a rope in a substep.

    It returns True if the last solve left a contact that pulls, a particle in a collider, or friction that is not
    Coulomb's. With `writes` the next solve takes what is found: contacts that press are closed, others open, steps of
    a semi-smooth Newton method (Alart and Curnier 1991).
    """
    meet = make_meet(features)

    @wp.func
    def lean(i: int, near: Near, ctx: Context, k: int, writes: bool) -> bool:
        g, packed, position = ctx.body.particles + i, load4(ctx.d, i), xyz(load4(ctx.x, i))
        displacement, w, when = xyz(packed), packed[3], float(ctx.substep + 1)
        moved, open = displacement - ctx.state.rope.starts[g], bool(False)
        push, hold, thickness = wp.vec3(0.0), wp.mat33(0.0), ctx.material.thickness
        if writes and k == 0:
            ctx.state.rope.half_turns[g] = half_turn_of(i, ctx)
        turn, unless_free = ctx.state.rope.half_turns[g], _friction_at(k)
        stray = strays(near, position + displacement, displacement)
        c = next_of(-1, near, stray)
        while c < ctx.colliders.shape[0]:
            entry, sweep = g * ctx.colliders.shape[0] + c, ctx.state.contact.sweeps[ctx.sweep + c]
            offset = (position - sweep.position) + displacement
            away = least_gap(offset, displacement - sweep.motion, sweep.spin, ctx.colliders[c].reach + thickness)
            stored, last = load_row(ctx.state.contact.contacts, entry), ctx.state.contact.leans[entry]
            now, known = Lean(), k > 0 and last.carried[3] == when
            earlier = (ctx.step.effective * ctx.step.effective) * xyz(stored)
            now.carried = wp.where(known, last.carried, pack(earlier, when))
            before = xyz(now.carried)
            if w > HELD * load4(ctx.x, i)[3] and (away < 0.0 or wp.length_sq(before) > 0.0):
                collider = ctx.colliders[c]
                slip = slip_of(position - sweep.position, displacement - xyz(load4(ctx.position_lo, i)), sweep)
                met, _overlap = meet(i, collider, sweep, sweep.to_local * offset, slip, thickness, ctx)
                softness = collider.compliance * ctx.step.inverse_square / w
                ratio = ratio_at(i, w, wp.transpose(sweep.to_local) * xyz(met), ctx)
                friction = friction_of(collider, turn, ctx)
                found = augmented(before, met, slip, wp.length(offset), ratio, softness, friction, unless_free)
                # Rounding neither opens nor closes a contact.
                closed, slack = known and last.contact[3] > 0.0, slack_of(ratio, wp.length(offset))
                pressed = wp.dot(xyz(found), xyz(met))
                touches = pressed > wp.where(closed or k == 0, -slack, slack) and not is_squeezed(i, collider, ctx)
                if not writes:
                    n, solved = sweep.to_local * xyz(last.contact), solved_lean(i, c, entry, w, moved, ctx)
                    wrong = touches and _rubs_wrongly(before - ratio * slip, solved, earlier, n, friction)
                    open = open or wrong or closed != touches
                elif touches:
                    back = wp.transpose(sweep.to_local)
                    n = back * xyz(met)
                    push += back * xyz(found)
                    hold += slope_of(n, ratio, softness, found[3], back * xyz(found))
                    store_row(ctx.state.contact.contacts, entry, pack(ctx.step.inverse_square * xyz(found), stored[3]))
                    now.contact = pack(n, found[3])
            if writes:
                ctx.state.contact.leans[entry] = now
            c = next_of(c, near, stray)
        if writes:
            ctx.state.rope.starts[g] = displacement
            ctx.state.rope.pushes[g] = push
            ctx.state.rope.holds[g] = hold
        return open

    return lean


@wp.func
def _inverse_mass(corners: wp.vec3i, weights: wp.vec3, ctx: Context) -> float:
    """Return the inverse mass of a point of a segment [1/kg]."""
    near, far = load4(ctx.d, corners[0])[3], load4(ctx.d, corners[1])[3]
    beyond = weights[1] + weights[2]
    return weights[0] * weights[0] * near + beyond * beyond * far


@wp.func
def _moved_at(corners: wp.vec3i, point: Point, ctx: Context) -> wp.vec3:
    """Return by how much a point of a segment, of these weights, moved since the solve began [m]."""
    a, b = ctx.body.particles + corners[0], ctx.body.particles + corners[1]
    first = xyz(load4(ctx.d, corners[0])) - ctx.state.rope.starts[a]
    return point[0] * first + point[1] * (xyz(load4(ctx.d, corners[1])) - ctx.state.rope.starts[b])


@wp.func
def _solved_between(k: int, ctx: Context) -> wp.vec3:
    """Return the correction [kg m] of segment k by colliders as the last solve left it."""
    place, corners = ctx.body.segments + k, corners_of(ctx.body.panels + k, ctx)
    now = ctx.state.rope.between[place]
    return now.push - now.hold * _moved_at(corners, now.point, ctx)


@wp.func
def _eased(press: Press, start: float, ctx: Context) -> float:
    """Return by how much less a face is rounded where it presses a segment [m].

    start: the gap at the start of the substep [m]. A segment that falls flat on a face comes to where that is rounded
    most at once, and would be thrown back. So the rounding starts at the gap, and grows as the segment tilts.
    """
    least = wp.clamp(press.rounded - start, 0.0, press.rounded)
    return wp.where(press.when >= ctx.substep - 1, wp.min(press.eased, least), least)


def _make_watch(features: Features):
    """Return a Warp function that opens the contact of a segment, and stores the point at which a collider presses it.

    As the segment turns, the deepest point runs along it on a round collider, and jumps from one end of a flat face to
    the other. The push there turns the segment back, far too much in a substep of a light rope. So the solve has to
    know how fast the point runs. It is told by the points a and b that are deepest if the ends of the segment move by
    `up`, TILT times the thickness, either way. Let a and b be their weights of the second corner. It has risen by t
    over the first since both points were as deep. Then

        p = (a + b) / 2 - (b - a) t / (4 up),    within a and b.

    On a flat face the push at p belongs to a collider that is rounded there: the gap at p, less the integral of p by t
    from where p is a or b. Without this the push would not be the gradient of a gap, and rock a stiff rope for ever. A
    sharp edge has a = b.

    The function returns -dp/dt [1/m].
    """
    touched_in, deepest = make_touched_in(features), make_deepest(features.facet_shapes, True)
    signed_distance = make_signed_distance(features.facet_shapes)

    @wp.func
    def tilted(collider: ColliderMotion, facet: Facet, at: float, n: wp.vec3, up: float, ctx: Context) -> wp.vec2:
        """Return where its line is deepest if its corners move by -up and up [m], and the gap there as it is."""
        turned, way = facet, (facet.b - facet.a) + (2.0 * up) * n
        turned.a += -way - up * n
        turned.b += way + up * n
        turned.c = turned.b
        none = wp.vec3(0.0)
        found = deepest(collider.shape, collider.size, collider.data, turned, ctx.material.thickness, none)
        place = wp.where(wp.max(found.weights) > 0.0, 3.0 * (found.weights[1] + found.weights[2]) - 1.0, at)
        return wp.vec2(place, found.value + up * (1.0 - 2.0 * place))

    @wp.func
    def watch(corners: wp.vec3i, entry: int, collider: ColliderMotion, sweep: Sweep, ctx: Context) -> float:
        ctx.state.contact.presses[entry].lean = wp.vec4(0.0)
        if not is_tested(corners, ctx, collider, sweep):
            return 0.0
        facet, runs, round = facet_of(corners, ctx, sweep), float(0.0), float(0.0)
        weights = touched_in(facet, entry, collider, WITHIN * ctx.material.thickness, ctx)
        if wp.max(weights) == 0.0:
            return 0.0
        if wp.max(weights) <= CORNER and longest_way(facet) <= FAST * ctx.material.thickness:
            n = xyz(signed_distance(collider.shape, point_of(facet, weights), collider.size, collider.data))
            up, at = TILT * ctx.material.thickness, weights[1] + weights[2]
            note_searches(2, collider, ctx)
            a, b = tilted(collider, facet, at, n, up, ctx), tilted(collider, facet, at, n, -up, ctx)
            runs = wp.max(b[0] - a[0], 0.0) / (4.0 * up)
            if runs > 0.0:
                way = wp.clamp(-(b[1] - a[1]) / (4.0 * up), -0.5 * (b[0] - a[0]), 0.5 * (b[0] - a[0]))
                at = 0.5 * (a[0] + b[0]) + way
                weights = wp.vec3(1.0 - at, at, 0.0)
                now = signed_distance(collider.shape, point_of(facet, weights), collider.size, collider.data)
                over = 0.5 * (a[1] + b[1]) + way * (b[1] - a[1]) / (b[0] - a[0])
                arc = (0.5 * up) * (b[0] - a[0]) - 0.5 * way * way / runs
                round = wp.max(now[3] - over + arc - UNSURE * NOISE, 0.0)  # 0 where the collider is round itself
        ctx.state.contact.presses[entry].weights = weights
        ctx.state.contact.presses[entry].rounded = round
        return runs

    return watch


@wp.func
def _lean_on(k: int, now: Between, ctx: Context):
    """Let segment k lean on a collider in the next solve, which counts moves from `starts`; now: as it is moved."""
    place, moved = ctx.body.segments + k, _moved_at(corners_of(ctx.body.panels + k, ctx), now.point, ctx)
    ctx.state.rope.between[place].push = now.push + now.hold * moved
    ctx.state.rope.between[place].hold = now.hold
    ctx.state.rope.between[place].point = now.point
    ctx.state.rope.between[place].eased = now.eased


def make_lean_between(features: Features):
    """Return a Warp function that finds what a collider does to segment k between its particles.

    It returns True if a contact is open that acts within the solve, or closed and does not act, or if its friction is
    off. Then the rope is solved once more from where it is now, a step of a semi-smooth Newton method (Alart and
    Curnier 1991). A solve takes the friction that belongs to the pressure before it. Left so, it would depend on how
    fast the rope comes nearer, by R, and shake a rope that slides. With `writes` the next solve takes what is found.
    Where several colliders touch a segment, only the one that presses most acts.
    """
    meet, watch = make_meet_between(features), _make_watch(features)

    @wp.func
    def lean_between(k: int, near: Near, ctx: Context, writes: bool) -> bool:
        corners = corners_of(ctx.body.panels + k, ctx)
        push, hold, point, most, less = wp.vec3(0.0), wp.mat33(0.0), Point(), float(0.0), float(0.0)
        solved = _solved_between(k, ctx)
        kept, acted, off, best = int(-1), bool(False), bool(False), Press()
        c = next_of(-1, near, False)
        while c < ctx.colliders.shape[0]:
            entry = (ctx.body.panels + k) * ctx.colliders.shape[0] + c
            collider, sweep = ctx.colliders[c], ctx.state.contact.sweeps[ctx.sweep + c]
            runs = float(0.0)
            if writes:
                runs = watch(corners, entry, collider, sweep, ctx)
            weights = ctx.state.contact.presses[entry].weights
            if wp.max(weights) > 0.0 and wp.max(weights) <= CORNER:  # it touched the segment at some time
                press = ctx.state.contact.presses[entry]
                facet, w = facet_of(corners, ctx, sweep), _inverse_mass(corners, weights, ctx)
                p, slip = point_of(facet, press.weights), slip_at(facet, press.weights)
                met, _overlap = meet(corners, press.weights, collider, sweep, facet, ctx.material.thickness, ctx)
                ratio = ratio_of(k - 1, k + 1, w, wp.transpose(sweep.to_local) * xyz(met), ctx)
                met[3] += NOISE  # as in surface.py
                eased = _eased(press, met[3] - wp.dot(slip, xyz(met)), ctx)
                met[3] -= press.rounded - eased
                local = sweep.to_local * press.normal
                before = wp.vec3(0.0)
                if press.when >= ctx.substep - 1:
                    before = xyz(press.so_far) + press.so_far[3] * local
                before *= w * ctx.step.effective * ctx.step.effective
                softness = collider.compliance * ctx.step.inverse_square / wp.max(w, 1.0e-20)
                friction = friction_between(k, c, press.weights, wp.dot(before - ratio * slip, facet.b - facet.a), ctx)
                found = augmented(before, met, slip, wp.length(p), ratio, softness, friction, DASHPOT)
                pressed = wp.dot(xyz(found), xyz(met))
                acted = acted or press.lean[3] > 0.0
                if w > 0.0 and pressed > most:
                    most, back = pressed, wp.transpose(sweep.to_local)
                    n, push = back * xyz(met), (1.0 / w) * (back * xyz(found))
                    hold = (1.0 / w) * slope_of(n, ratio, softness, found[3], push)
                    s, at = wp.sqrt(pressed / w * runs) * n, press.weights[1] + press.weights[2]
                    point = Point(1.0 - at, at, s[0], s[1], s[2])
                    kept, best, less = entry, press, eased
                    best.lean = pack(n, found[3])
                    best.friction = friction
                    change = push - solved
                    off = wp.length(change - wp.dot(change, n) * n) > OFF * friction[0] * pressed / w
            c = next_of(c, near, False)
        if writes:
            _lean_on(k, Between(push, hold, point, less), ctx)
            if kept >= 0:
                ctx.state.contact.presses[kept] = best
        return off or acted != (kept >= 0)

    return lean_between


@wp.func
def past_of(g: int, ctx: Context) -> wp.vec3:
    """Return the displacement of particle g of the batch [m] that BDF2 goes on from."""
    if ctx.step.second:
        return ctx.state.last_displacements[g]
    return ctx.step.effective * xyz(load_row(ctx.state.velocities, g))


@wp.func
def is_hit(past: wp.vec3, motion: wp.vec3, normal: wp.vec3, pressed: float) -> bool:
    """Return True if what a rope leans on within its solve hits a point: it came nearer by more than half of `pressed`.

    Then BDF2 forgets its past. Else it would rebound at half its speed. What is only pressed would do so if it did, by
    the force that the solve carries.
    """
    return wp.dot(motion - past, normal) > 0.5 * pressed


@wp.func
def keep_lean(k: int, near: Near, ctx: Context):
    """Store what the solve made of the correction of segment k as that of this substep so far."""
    corners, place = corners_of(ctx.body.panels + k, ctx), ctx.body.segments + k
    now = ctx.state.rope.between[place]
    point = now.point
    if point[0] + point[1] == 0.0:
        return
    a, b = ctx.body.particles + corners[0], ctx.body.particles + corners[1]
    moved = point[0] * (ctx.state.rope.solved[a] - ctx.state.rope.starts[a])
    moved += point[1] * (ctx.state.rope.solved[b] - ctx.state.rope.starts[b])
    acted = now.push - now.hold * moved
    past = point[0] * past_of(a, ctx) + point[1] * past_of(b, ctx)
    w = _inverse_mass(corners, wp.vec3(point[0], point[1], 0.0), ctx)
    c = next_of(-1, near, False)
    while c < ctx.colliders.shape[0]:
        entry = (ctx.body.panels + k) * ctx.colliders.shape[0] + c
        lean, friction = ctx.state.contact.presses[entry].lean, ctx.state.contact.presses[entry].friction
        if lean[3] > 0.0:
            n = xyz(lean)
            pressed = wp.max(wp.dot(acted, n), 0.0)
            hits = is_hit(past, ctx.state.contact.sweeps[ctx.sweep + c].motion, n, w * pressed)
            rub = friction_correction(wp.vec3(0.0), acted - wp.dot(acted, n) * n, pressed, friction)
            rub = ctx.state.contact.sweeps[ctx.sweep + c].to_local * rub
            ctx.state.contact.presses[entry].when = ctx.substep
            ctx.state.contact.presses[entry].eased = now.eased
            ctx.state.contact.presses[entry].rounded -= now.eased
            ctx.state.contact.presses[entry].normal = n
            ctx.state.contact.presses[entry].acted = acted
            ctx.state.contact.presses[entry].hits = int(hits)
            ctx.state.contact.presses[entry].so_far = ctx.step.inverse_square * pack(rub, wp.dot(acted, n))
        c = next_of(c, near, False)
