# SPDX-License-Identifier: Apache-2.0
"""Contact between particles: the stage that keeps an edge of two particles outside all colliders, colour by colour.

Colliders are convex, and the signed distance of a convex shape is convex along a line. Where its slope is downhill at
both ends, the deepest point lies between them. Nowhere else does a particle's own contact leave anything to do.
"""

import warp as wp

from cloth_sim_ros.sim.colliders import make_signed_distance
from cloth_sim_ros.sim.intrinsics import load4, load_row, store4, store_row, xyz
from cloth_sim_ros.sim.physics.friction import friction_correction
from cloth_sim_ros.sim.physics.integrate import Step
from cloth_sim_ros.sim.stages.contact import (
    NOISE,
    SEPARATION,
    add_force,
    forgotten,
    length_of,
    lost_motion,
    make_meet,
    share_of,
)
from cloth_sim_ros.sim.stages.here import Here
from cloth_sim_ros.sim.stages.motion import pack
from cloth_sim_ros.sim.stages.near import near_of, note
from cloth_sim_ros.sim.state import State, Sweep

# Of the larger inverse mass: what a push beside a pinned or heavy end divides by, so that the other end is never thrown
# farther than four times the gap.
LEAST_SHARE = wp.constant(0.25)


@wp.func
def slip_of(x: wp.vec3, d: wp.vec3, low: wp.vec3, sweep: Sweep) -> wp.vec3:
    """Displacement of a particle relative to a collider in this substep, in the collider's axes [m]."""
    return sweep.to_local * (d - low - sweep.motion) + sweep.turn * (x - sweep.position)


def make_deepest(shapes: tuple[str, ...]):
    """A Warp function: the fraction of a segment at which it is deepest in a collider of one of `shapes`."""
    signed_distance = make_signed_distance(shapes)

    @wp.func
    def deepest(shape: int, size: wp.vec3, data: wp.uint64, start: wp.vec3, e: wp.vec3) -> float:
        """Fraction of the segment from local point `start` along `e`; -1 where it is one of the ends.

        A bracket shrinks to where the tangents at its ends meet (Kelley 1960): at once where two faces do.
        """
        low = float(0.0)
        high = float(1.0)
        at_low = signed_distance(shape, start, size, data)
        at_high = signed_distance(shape, start + e, size, data)
        slope_low = wp.dot(xyz(at_low), e)
        slope_high = wp.dot(xyz(at_high), e)
        if slope_low >= 0.0 or slope_high <= 0.0:
            return -1.0
        value_low = at_low[3]
        value_high = at_high[3]
        t = float(0.0)
        for _ in range(6):
            t = (value_high - value_low + slope_low * low - slope_high * high) / (slope_low - slope_high)
            t = wp.clamp(t, low, high)
            here = signed_distance(shape, start + t * e, size, data)
            slope = wp.dot(xyz(here), e)
            if slope < 0.0:
                low, value_low, slope_low = t, here[3], slope
            else:
                high, value_high, slope_high = t, here[3], slope
        return t

    return deepest


@wp.func
def forget(g: int, moved: wp.vec3, normal: wp.vec3, hit: bool, s: State, step: Step) -> wp.vec3:
    """Of the past of particle g, which an edge contact moved by `moved` [m], only what still holds (see stages.py).

    Returns the correction [m] that has the effect on the momentum of what is forgotten.
    """
    past = s.last_displacements[g]
    lost = wp.vec3(0.0)
    if wp.dot(moved - past, normal) > NOISE:
        v = xyz(load_row(s.velocities, g))
        kept = forgotten(past, moved, normal, hit)
        kept_speed = forgotten(v, moved / length_of(step), normal, hit)
        s.last_displacements[g] = kept
        store_row(s.velocities, g, pack(kept_speed, 0.0))
        lost = lost_motion(past - kept, v - kept_speed, step)
    return lost


def make_edge_contact(shapes: tuple[str, ...], order: int):
    """The stage that keeps edge k of the batch outside all colliders of `shapes`, with friction."""
    deepest, meet = make_deepest(shapes), make_meet(shapes)

    @wp.func
    def edge_contact(
        k: int,
        here: Here,
    ):
        i = here.model.edges[k][0]
        j = here.model.edges[k][1]
        packed_i = load4(here.d, i)
        packed_j = load4(here.d, j)
        wi = packed_i[3]
        wj = packed_j[3]
        if wi + wj == 0.0:
            return
        xi = xyz(load4(here.x, i))
        xj = xyz(load4(here.x, j))
        di = xyz(packed_i)
        dj = xyz(packed_j)
        touched = bool(False)
        near = near_of(here)
        for c in range(here.colliders.shape[0]):
            collider = here.colliders[c]
            sweep = here.state.sweeps[here.sweep + c]
            slot = c * here.model.edges.shape[0] + k
            before = wp.vec4(0.0)
            if not here.step.first:
                before = load_row(here.state.edge_contacts, slot)
            after = before
            start = (xi - sweep.position) + di
            e = (xj - xi) + (dj - di)
            away = wp.length(start + 0.5 * e)
            path = wp.max(wp.length(di - sweep.motion), wp.length(dj - sweep.motion)) + 0.5 * wp.length(e)
            path += sweep.spin * (away + path)
            if away - path < collider.reach + here.material.thickness:
                shape, size, data = collider.shape, collider.size, collider.data
                t = deepest(shape, size, data, sweep.to_local * start, sweep.to_local * e)
                if t >= 0.0:
                    slip = (1.0 - t) * slip_of(xi, di, xyz(load4(here.low, i)), sweep)
                    slip += t * slip_of(xj, dj, xyz(load4(here.low, j)), sweep)
                    p = sweep.to_local * (start + t * e)
                    apart = SEPARATION * here.step.effective
                    touching = meet(shape, size, data, p, slip, here.material.thickness, apart)
                    gap = touching[3]
                    if gap < 0.0:
                        n = xyz(touching)
                        pressed = before[3] - gap
                        mu_s = wp.sqrt(here.material.static_friction * collider.static_friction)
                        mu_k = wp.sqrt(here.material.kinetic_friction * collider.kinetic_friction)
                        tangential = slip - wp.dot(slip, n) * n
                        rubbed_before = xyz(before) - wp.dot(xyz(before), n) * n
                        rubbed = friction_correction(tangential, rubbed_before, pressed, mu_s, mu_k)
                        w = wi * (1.0 - t) * (1.0 - t) + wj * t * t
                        w = wp.max(w, LEAST_SHARE * wp.max(wi, wj))
                        push = wp.transpose(sweep.to_local) * (-gap * n + rubbed - rubbed_before) / w
                        share = share_of(here.step, here.frame.substeps)
                        colliders, first = here.colliders.shape[0], here.body.particles
                        add_force(here.state.contact_forces, (first + i) * colliders + c, share * (1.0 - t) * push)
                        add_force(here.state.contact_forces, (first + j) * colliders + c, share * t * push)
                        di += wi * (1.0 - t) * push
                        dj += wj * t * push
                        after = pack(rubbed, pressed)
                        touched = True
                        note(c, near)
                        if wp.static(order == 2):
                            normal = wp.transpose(sweep.to_local) * n
                            past = (1.0 - t) * here.state.last_displacements[here.body.particles + i]
                            past += t * here.state.last_displacements[here.body.particles + j]
                            hit = -wp.dot(past - sweep.motion, normal) > 0.5 * pressed
                            if wi > 0.0:
                                moved = di - xyz(load4(here.low, i))
                                lost = forget(first + i, moved, normal, hit, here.state, here.step)
                                add_force(here.state.contact_forces, (first + i) * colliders + c, share / wi * lost)
                            if wj > 0.0:
                                moved = dj - xyz(load4(here.low, j))
                                lost = forget(first + j, moved, normal, hit, here.state, here.step)
                                add_force(here.state.contact_forces, (first + j) * colliders + c, share / wj * lost)
            if here.step.repeats:
                store_row(here.state.edge_contacts, slot, after)
        if touched:
            store4(here.d, i, pack(di, wi))
            store4(here.d, j, pack(dj, wj))

    return edge_contact
