# SPDX-License-Identifier: Apache-2.0
"""The forces on a member of a subdomain, gathered from what lies around it in its shared memory (see subdomains.py)."""

from dataclasses import dataclass
from typing import Any

import warp as wp

from cloth_sim_ros.sim.executors.subdomain_plan import PLACES, SubdomainArrays
from cloth_sim_ros.sim.intrinsics import array_address, load4, xyz
from cloth_sim_ros.sim.model import Features
from cloth_sim_ros.sim.physics.distance import SHORTEST
from cloth_sim_ros.sim.physics.integrate import kicked
from cloth_sim_ros.sim.stages.aerodynamics import Corners, make_air
from cloth_sim_ros.sim.stages.motion import constant_of_spring, force_of_spring, pack
from cloth_sim_ros.sim.stages.near import Near
from cloth_sim_ros.sim.state import ColliderMotion, Frame, Material


@dataclass(frozen=True)
class Widths:
    """The most that lies around a particle: springs, panels, neighbours in the operator of bending; and how many rings
    the slow forces reach."""

    springs: int
    panels: int
    plate: int
    reach: int


@dataclass(frozen=True)
class SpringForce:
    """The struct of the springs of a member, its size, and the Warp functions that fetch it, compute its force and find
    the largest strain."""

    Springs: Any
    width: int
    gather: Any
    of: Any
    strain: Any


@wp.struct
class Carried:
    """What a particle carries from substep to substep: position [m] and inverse mass [1/kg], what float32 lost of the
    position [m], and velocity [m/s]. Also how far it may go before it can touch a collider [m]."""

    x: wp.vec4
    low: wp.vec3
    v: wp.vec3
    clearance: float


@wp.struct
class InSubdomain:
    """What all members of a subdomain know: the subdomain, its body and its block in the launch, the launch's first
    substep, the body's numbers, and the address of its memory."""

    subdomains: SubdomainArrays
    subdomain: int
    body: int
    block: int
    first: int
    shared: wp.uint64
    frame: Frame
    material: Material
    constants: wp.vec3  # of springs, see stages.spring_constants
    colliders: wp.array(dtype=ColliderMotion)
    spring_types: wp.array(dtype=wp.vec4)
    last_displacements: wp.array(dtype=wp.vec3)
    strain_found: wp.array(dtype=float)
    near: Near


def make_springs(width: int, capacity: int) -> SpringForce:
    """What fetches the `width` springs of a member of a subdomain and computes their force [N].

    The springs of one member do not wait for one another: no branch lies between them.
    """
    places = wp.types.vector(length=width, dtype=wp.int32)
    numbers = wp.types.vector(length=width, dtype=wp.float32)

    @wp.struct
    class Springs:
        others: places
        rests: numbers
        constants: numbers
        lost: numbers

    @wp.func
    def gather(i: int, here: InSubdomain) -> Springs:
        springs = Springs()
        for q in range(width):
            packed = here.subdomains.incident_springs[(here.subdomain * width + q) * capacity + i]
            kind = load4(array_address(here.spring_types, 0), packed / wp.static(PLACES))
            springs.others[q] = packed & wp.static(PLACES - 1)
            springs.rests[q] = kind[0]
            springs.constants[q] = constant_of_spring(kind, here.constants)
            springs.lost[q] = kind[3]
        return springs

    @wp.func
    def edge(half: int, now: Carried, other: int, shared: wp.uint64) -> wp.vec3:
        j = half + other
        return xyz((load4(shared, j) - now.x) + (load4(shared, capacity + j) - pack(now.low, 0.0)))

    @wp.func
    def elastic_force(half: int, now: Carried, springs: Springs, shared: wp.uint64) -> wp.vec3:
        total = wp.vec3(0.0)
        for q in range(width):
            e = edge(half, now, springs.others[q], shared)
            total += force_of_spring(e, springs.rests[q], springs.constants[q], springs.lost[q], 0.0, wp.vec3(0.0))
        return total

    @wp.func
    def strain(half: int, now: Carried, springs: Springs, shared: wp.uint64) -> float:
        longest = float(0.0)  # of what is missing both lengths are 0
        for q in range(width):
            length = wp.length(edge(half, now, springs.others[q], shared))
            longest = wp.max(longest, length / wp.max(springs.rests[q], SHORTEST))
        return longest - 1.0

    @wp.func
    def damped_force(half: int, now: Carried, springs: Springs, damping: float, shared: wp.uint64) -> wp.vec3:
        total = wp.vec3(0.0)
        for q in range(width):
            apart = xyz(load4(shared, 2 * capacity + half + springs.others[q])) - now.v
            e = edge(half, now, springs.others[q], shared)
            total += force_of_spring(e, springs.rests[q], springs.constants[q], springs.lost[q], damping, apart)
        return total

    @wp.func
    def force(half: int, now: Carried, springs: Springs, damping: float, shared: wp.uint64) -> wp.vec3:
        if damping > 0.0:
            return damped_force(half, now, springs, damping, shared)
        return elastic_force(half, now, springs, shared)

    return SpringForce(Springs, width, gather, force, strain)


def make_impulse(features: Features, widths: Widths, capacity: int):
    """A Warp function: the velocity [m/s] of member i after an impulse of the slow forces over `span` [s]."""
    drag = make_drag(features, widths.panels, capacity) if features.panels else None
    bending = make_bending(widths.plate, capacity) if features.plate else None

    @wp.func
    def impulse(i: int, half: int, now: Carried, span: float, here: InSubdomain) -> wp.vec3:
        total = wp.vec4(0.0)
        if wp.static(drag is not None):
            total = drag(i, half, now, here)
        force = xyz(total)
        if wp.static(bending is not None):
            force += bending(i, half, now, here)
        return kicked(now.v, force, total[3], now.x[3], span)

    return impulse


def make_bending(width: int, capacity: int):
    """A Warp function: the force [N] of the sheet's bending on a member, see plate.make_bending_force."""

    @wp.func
    def bending(i: int, half: int, now: Carried, here: InSubdomain) -> wp.vec3:
        total = wp.vec3(0.0)
        slips = wp.vec3(0.0)
        for q in range(width):
            found = here.subdomains.plate[(here.subdomain * width + q) * capacity + i]
            j = half + int(found[0])
            weight = found[1]
            total += weight * xyz(
                (load4(here.shared, j) - now.x) + (load4(here.shared, capacity + j) - pack(now.low, 0.0))
            )
            if here.material.damping > 0.0:
                slips += weight * (xyz(load4(here.shared, 2 * capacity + j)) - now.v)
        return -(total + here.material.damping * slips) / here.material.compliance[2]

    return bending


def make_drag(features: Features, panels: int, capacity: int):
    """A Warp function: the force of the air [N] on a member of a subdomain by the `panels` around it, and its drag
    rate."""
    air = make_air(features)

    @wp.func
    def drag(i: int, half: int, now: Carried, here: InSubdomain) -> wp.vec4:
        shared = here.shared
        total = wp.vec4(0.0)
        for q in range(panels):
            packed = here.subdomains.panels[(here.subdomain * panels + q) * capacity + i]
            corner = packed / wp.static(PLACES * PLACES)
            if corner < 3:
                j = half + (packed & wp.static(PLACES - 1))
                k = half + ((packed / wp.static(PLACES)) & wp.static(PLACES - 1))
                p = xyz(load4(shared, j))
                vp = xyz(load4(shared, 2 * capacity + j))
                r = xyz(load4(shared, k))
                vr = xyz(load4(shared, 2 * capacity + k))
                corners = Corners()
                corners.a = p
                corners.va = vp
                corners.b = p
                corners.vb = vp
                corners.c = r
                corners.vc = vr
                if corner == 0:
                    corners.a = xyz(now.x)
                    corners.va = now.v
                elif corner == 1:
                    corners.b = xyz(now.x)
                    corners.vb = now.v
                else:
                    corners.b = r
                    corners.vb = vr
                    corners.c = xyz(now.x)
                    corners.vc = now.v
                total += air(corners, here.frame, here.material)
        return total

    return drag
