# SPDX-License-Identifier: Apache-2.0
"""Continuous collision of a moving point with a collider, also if the point passed through its surface."""

import warp as wp

from cloth_sim_ros.sim.colliders import make_is_beyond, make_signed_distance, number_of
from cloth_sim_ros.sim.features.collider_contact.sweep import Apart, separated
from cloth_sim_ros.sim.kernels.intrinsics import pack, xyz

_TRACED = 1.0e-3  # distance from the surface at which tracing of a path ends, as a fraction of the thickness


def make_ccd(shapes: tuple[str, ...], called: bool):
    """Return a Warp function: the contact of a moving point with a collider of one of `shapes`.

    called: True if it is a function call; a rope asks in so many places that a GPU compiles for minutes otherwise.
    """
    signed_distance, is_beyond = make_signed_distance(shapes), make_is_beyond(shapes)

    @wp.func
    def enter(
        shape: int, size: wp.vec3, data: wp.uint64, start: wp.vec3, path: wp.vec3, before: wp.vec4, thickness: float
    ) -> wp.vec4:
        """Return the normal, and the fraction of `path` at which it enters the surface; -1 if it does not.

        The search is by sphere tracing. before: normal and signed distance [m] at the start.
        """
        length = wp.length(path)
        surface = before
        gap = surface[3] - thickness
        reached = wp.where(surface[3] < 0.0 or length <= 0.0, 2.0, 0.0)
        count = int(0)
        # Keep this loop from being unrolled: very few particles come here, and all would carry its registers.
        while count < 16 and gap > wp.static(_TRACED) * thickness and reached <= 1.0:
            reached += gap / wp.max(length, 1.0e-30)
            if reached <= 1.0:
                surface = signed_distance(shape, start + reached * path, size, data)
                gap = surface[3] - thickness
            count += 1
        return pack(xyz(surface), wp.where(reached > 1.0, -1.0, reached))

    def meet(
        shape: int, size: wp.vec3, data: wp.uint64, p: wp.vec3, slip: wp.vec3, thickness: float, apart: Apart
    ) -> tuple[wp.vec4, float, float]:
        """Return the normal and gap [m] of local point p, which came by `slip`; negative also if it passed through.

        If the point cannot touch the collider, the gap is just some positive number. An overlap that was there before
        counts for no more than separates in a substep. What does so without a velocity, and the overlap, follow [m].
        """
        if wp.static(is_beyond is not None):
            if is_beyond(shape, p, thickness + wp.length(slip), data):
                return wp.vec4(0.0, 0.0, 1.0, thickness), 0.0, 0.0
        surface = signed_distance(shape, p, size, data)
        gap = surface[3] - thickness
        n = xyz(surface)
        square = wp.length_sq(slip)
        if wp.static("mesh" in shapes):
            # A point on the surface that moved less than its distance from the other side has not passed through.
            if shape == wp.static(number_of("mesh")) and gap <= 0.0 and surface[3] > wp.sqrt(square):
                square = 0.0
        before = surface
        # Both distances are evaluated at once, though few points need the earlier one: a GPU waits as long for one as
        # for both. A mesh is slow, so there it is evaluated only if needed.
        if wp.static("mesh" not in shapes) or square > gap * gap or gap < -wp.where(apart.left > 0.0, 0.0, apart.most):
            before = signed_distance(shape, p - slip, size, data)
        if square > gap * gap:
            # Fast enough to have passed through the surface: find where it entered, and stay on that side. A particle
            # that merely touches also does better there: a third of the error of the way straight out.
            entry = enter(shape, size, data, p - slip, slip, before, thickness)
            deep = wp.dot(xyz(entry), slip) * (1.0 - entry[3])
            # A point outside now, which went no deeper than tracing can resolve, has not passed through.
            through = wp.dot(xyz(entry), n) < 0.5 or (gap > 0.0 and deep < -wp.static(_TRACED) * thickness)
            if entry[3] >= 0.0 and through:
                n = xyz(entry)
                gap = deep
        overlap, parts = thickness - before[3], float(0.0)
        if apart.left > 0.0:
            parts = separated(overlap, apart)
            gap += wp.max(wp.min(overlap, apart.left) - parts, 0.0)
        if gap < -apart.most:
            gap -= wp.min(before[3] - thickness + apart.left + apart.most, 0.0)
        return pack(n, gap), parts, overlap

    return wp.func(meet, inline=False if called else None)
