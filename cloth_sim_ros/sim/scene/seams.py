# SPDX-License-Identifier: Apache-2.0
"""Seams: lines of stitches that tie two objects, or one object to itself."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cloth_sim_ros import parameters as table
from cloth_sim_ros.sim.input.numbers import Described


class Seam(Described):
    """Stitches that tie a line of particles of `first` to a line of `second`, which may be the same object.

    A line runs through the given particles: along the border of a sheet where they lie on it, else along edges. Lines
    of equally many particles are sewn one to one. Otherwise each particle of the finer line is sewn to the point at the
    same share of the length of the other. A single particle is sewn to another one, or slides along a line from its
    first particle. Numbers, live and different between worlds: compliance [m/N] of a stitch, strength [N] at which it
    breaks, closing_speed [m/s] at which those that begin open close.

    Args:
        first: The name of an object.
        second: The name of an object.
        first_particles: Particles of `first`, in order.
        second_particles: Particles of `second`, in the same order.
        points: True to sew these particles alone, one to one.
        slides: True for stitches that slide without friction along `second`, a rope.

    Raises:
        ValueError: A value is not allowed.
    """

    rows = table.SEAM

    def __init__(
        self,
        first: str,
        second: str,
        first_particles: Sequence[int],
        second_particles: Sequence[int],
        points: bool = False,
        slides: bool = False,
        **values: float,
    ) -> None:
        super().__init__(**values)
        for name, given in (("first_particles", first_particles), ("second_particles", second_particles)):
            numbers = np.asarray(given)
            if numbers.ndim != 1 or not len(numbers) or numbers.dtype.kind not in "iu" or numbers.min() < 0:
                raise ValueError(f"Seam.{name} is {table.shown(given)}; allowed are numbers of particles, one at least")
        one, other = len(first_particles), len(second_particles)
        if points and one != other:
            raise ValueError(f"Seam.points is True for {one} and {other} particles; allowed are equally many")
        if one != other and (other == 1 or one == 1 and not slides) and not points:
            which, given = ("second", second_particles) if other == 1 else ("first", first_particles)
            alone = f"Seam.{which}_particles is {table.shown(given)}, into which a whole line would gather"
            raise ValueError(f"{alone}; allowed are two lines, two particles, or points with one repeated")
        self.first, self.second, self.points, self.slides = first, second, bool(points), bool(slides)
        self.first_particles, self.second_particles = (
            tuple(map(int, each)) for each in (first_particles, second_particles)
        )
