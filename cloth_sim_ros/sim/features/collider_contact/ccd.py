# SPDX-License-Identifier: Apache-2.0
"""Where a point that moved meets a collider, also one that came through its surface."""

import warp as wp

from cloth_sim_ros.sim.colliders import make_is_beyond, make_signed_distance, number_of
from cloth_sim_ros.sim.kernels.intrinsics import pack, xyz

_TRACED = 1.0e-3  # of the thickness: how near to the surface the tracing of a path ends


def make_ccd(shapes: tuple[str, ...]):
    """A Warp function: where a point that moved meets a collider of one of `shapes`."""
    signed_distance, is_beyond = make_signed_distance(shapes), make_is_beyond(shapes)

    @wp.func
    def enter(
        shape: int, size: wp.vec3, data: wp.uint64, start: wp.vec3, path: wp.vec3, before: wp.vec4, thickness: float
    ) -> wp.vec4:
        """Normal and fraction of `path` at which it enters the surface, by sphere tracing; -1 if it does not.

        before: normal and signed distance [m] at its start.
        """
        length = wp.length(path)
        surface = before
        gap = surface[3] - thickness
        reached = wp.where(surface[3] < 0.0 or length <= 0.0, 2.0, 0.0)
        count = int(0)
        # A loop that Warp does not unroll: next to no particle ever comes here, and all would carry its registers.
        while count < 16 and gap > wp.static(_TRACED) * thickness and reached <= 1.0:
            reached += gap / wp.max(length, 1.0e-30)
            if reached <= 1.0:
                surface = signed_distance(shape, start + reached * path, size, data)
                gap = surface[3] - thickness
            count += 1
        return pack(xyz(surface), wp.where(reached > 1.0, -1.0, reached))

    @wp.func
    def meet(
        shape: int, size: wp.vec3, data: wp.uint64, p: wp.vec3, slip: wp.vec3, thickness: float, apart: float
    ) -> wp.vec4:
        """Normal and gap [m] of local point p, which came by `slip`; negative also where it came through.

        Of what it cannot meet all that is told is that the gap is above 0.

        Of an overlap that was there before it came, no more than `apart` [m] counts.
        """
        if wp.static(is_beyond is not None):
            if is_beyond(shape, p, thickness + wp.length(slip), data):
                return wp.vec4(0.0, 0.0, 1.0, thickness)
        surface = signed_distance(shape, p, size, data)
        gap = surface[3] - thickness
        n = xyz(surface)
        square = wp.length_sq(slip)
        if wp.static("mesh" in shapes):
            # What lies on the surface now, and came by less than it is from the other side, has not come through.
            if shape == wp.static(number_of("mesh")) and gap <= 0.0 and surface[3] > wp.sqrt(square):
                square = 0.0
        before = surface
        # Both at once, though few need where they came from: a GPU waits for the one as long as for both. Of a mesh
        # it takes its time.
        if wp.static("mesh" not in shapes) or square > gap * gap or gap < -apart:
            before = signed_distance(shape, p - slip, size, data)
        if square > gap * gap:
            # Fast enough to have come through the surface: find where it entered, and stay on that side. A particle
            # that merely touches is also better off where it entered: a third of the error of the way straight out.
            entry = enter(shape, size, data, p - slip, slip, before, thickness)
            deep = wp.dot(xyz(entry), slip) * (1.0 - entry[3])
            # What comes no deeper than the tracing can tell, and lies outside now, has not come through.
            through = wp.dot(xyz(entry), n) < 0.5 or (gap > 0.0 and deep < -wp.static(_TRACED) * thickness)
            if entry[3] >= 0.0 and through:
                n = xyz(entry)
                gap = deep
        if gap < -apart:
            gap -= wp.min(before[3] - thickness + apart, 0.0)
        return pack(n, gap)

    return meet
