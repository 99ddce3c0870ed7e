# SPDX-License-Identifier: Apache-2.0
"""The hard cases as data: their trials, bodies and options.

To add a case, add its row to CASES and the function that makes its trial from the options of one combination.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from cloth_sim_ros.study.hard.bodies import KINDS, is_rope
from cloth_sim_ros.study.hard.trial import Options, Trial
from cloth_sim_ros.study.hard.trials import contact, pulls, repeats, starts


@dataclass(frozen=True)
class Case:
    """`trial`(kind, options, random) for every kind of body and every combination of `grid`."""

    name: str
    text: str
    trial: Callable[[str, Options, np.random.Generator], Trial]
    kinds: tuple[str, ...] = KINDS
    grid: dict[str, tuple] = field(default_factory=dict)


_SHEETS_AND_ROPES = ("sheet", "sheet with bending", "rope")
_ROPES = tuple(kind for kind in KINDS if is_rope(kind))
_COMPLIANCES = (0.0, 1e-9, 1e-6, 1e-3, 1.0, 1e3)

CASES = {
    case.name: case
    for case in (
        Case(
            "end load",
            "a load of 1 to 1e5 times the rope",
            starts.end_load,
            _ROPES,
            {"ratio": (1.0, 1e2, 1e3, 1e4, 1e5)},
        ),
        Case(
            "bad start",
            "random, 10x stretched, collapsed, inside out",
            starts.bad_start,
            grid={"start": tuple(starts.STARTS)},
        ),
        Case(
            "bad start, loaded",
            "the same with a load of 1 to 1e5 times the rope",
            starts.bad_start,
            _ROPES,
            {"start": tuple(starts.STARTS), "ratio": (1.0, 1e2, 1e5)},
        ),
        Case("degenerate", "springs of no length, triangles of no area", starts.degenerate),
        Case(
            "compliance",
            "rigid to 1e3 m/N",
            starts.compliance,
            grid={"compliance": _COMPLIANCES, "iterations": (1, 10)},
        ),
        Case("long step", "frames of 0.1 s", starts.long_step, grid={"substeps": (1, 2), "iterations": (1, 10)}),
        Case(
            "fast collider",
            "5 and 20 m/s, thinner than its motion a frame",
            contact.fast_collider,
            _SHEETS_AND_ROPES,
            {"shape": tuple(contact.SHAPES), "speed": (5.0, 20.0)},
        ),
        Case(
            "teleport",
            "a collider placed into, past and away",
            contact.teleport,
            _SHEETS_AND_ROPES,
            {"shape": tuple(contact.SHAPES), "where": ("into", "through", "away")},
        ),
        Case(
            "squeeze",
            "to half its thickness",
            contact.squeeze,
            _SHEETS_AND_ROPES,
            {"shape": ("plane", "sphere", "box")},
        ),
        Case("pulled pins", "to twice the rest length", pulls.pulled_pins),
        Case("pins in conflict", "jump every frame", pulls.pins_in_conflict, grid={"compliance": (0.0, 1e-6, 1e-4)}),
        Case(
            "sharp edge", "dragged over a box's edge", contact.sharp_edge, _SHEETS_AND_ROPES, {"substeps": (5, 20, 80)}
        ),
        Case("gusts", "100 m/s, reversing every frame", pulls.gusts, grid={"pins": ("hung", "none")}),
        Case(
            "centre",
            "a particle in the very middle",
            contact.centre,
            ("sheet", "rope"),
            {"shape": tuple(shape for shape in contact.SHAPES if shape != "plane")},
        ),
        Case("same bits", "after a reset, and by another simulation", repeats.same_bits),
        Case(
            "gone bad",
            "one of three bodies; it alone is put back",
            repeats.gone_bad,
            grid={"value": (float("nan"), float("inf"))},
        ),
    )
}
