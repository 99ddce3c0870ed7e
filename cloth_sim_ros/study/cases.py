# SPDX-License-Identifier: Apache-2.0
"""Cases of the study as data: the bodies to simulate, their duration, and their exact springs.

To add a case, add its row in CASES, and a function that builds its body if none of those here does.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from cloth_sim_ros.sim import Cloth, Rope
from cloth_sim_ros.sim.topology import build
from cloth_sim_ros.study import contact_cases
from cloth_sim_ros.study.case import BODY, FRAME_DT, Case


def clamped_sheet(resolution: int, constant: float) -> Cloth:
    """A square sheet of 1 m and 0.2 kg, all four edges fixed, that falls from flat into its sag."""
    index = np.arange(resolution**2).reshape(resolution, resolution)
    edges = np.unique(np.concatenate([index[0], index[-1], index[:, 0], index[:, -1]]))
    return _sheet(resolution, constant, edges)


def swinging_sheet(resolution: int, constant: float) -> Cloth:
    """A square sheet of 1 m and 0.2 kg that hangs by its upper edge and is let go at 45 degrees."""
    upper = np.arange(resolution * (resolution - 1), resolution**2)
    return _sheet(resolution, constant, upper, (np.sin(np.pi / 8), 0.0, 0.0, np.cos(np.pi / 8)))


def heavy_hem(resolution: int, constant: float) -> Cloth:
    """The swinging sheet with a lowest row of particles that are 100 times as heavy as the others."""
    sheet = swinging_sheet(resolution, constant)
    masses = build(sheet, BODY, False).masses
    masses[:resolution] *= 100.0
    return dataclasses.replace(sheet, particle_masses=masses)


def two_corner_curtain(resolution: int, constant: float) -> Cloth:
    """A square sheet of 1 m and 0.2 kg that is held level and let go but for the two upper corners."""
    return _sheet(resolution, constant, np.array([resolution * (resolution - 1), resolution**2 - 1]))


def _sheet(resolution: int, constant: float, pins: np.ndarray, orientation: tuple = (0.0, 0.0, 0.0, 1.0)) -> Cloth:
    return Cloth(
        resolution=(resolution, resolution),
        size=(1.0, 1.0),
        mass=0.2,
        orientation=orientation,
        pins=tuple(pins.tolist()),
        stretch_compliance=1.0 / constant,
        shear_compliance=1.0 / constant,
    )


def loaded_chain(load: float) -> Callable[[int, float], Rope]:
    """A chain of 1 m and 0.2 kg with a mass of `load` times its own at its end, let go at 45 degrees."""

    def body(resolution: int, constant: float) -> Rope:
        masses = np.full(resolution + 1, 0.2 / resolution)
        masses[[0, -1]] *= 0.5
        masses[-1] += load * 0.2
        return Rope(
            start=(0.0, 0.0, 0.0),
            end=(np.sqrt(0.5), 0.0, -np.sqrt(0.5)),
            segments=resolution,
            particle_masses=masses,
            pins=(0,),
            stretch_compliance=resolution / constant,  # 1/EA of segments of 1 m / resolution
        )

    return body


def cantilever(resolution: int, constant: float) -> Rope:
    """A rod of 1 m, 0.2 kg and EI = 2 N m^2 that is clamped level and let go: its first two particles are fixed."""
    return Rope(
        start=(0.0, 0.0, 0.0),
        end=(1.0, 0.0, 0.0),
        segments=resolution,
        mass=0.2,
        pins=(0, 1),
        stretch_compliance=resolution / constant,
        bend_compliance=0.5,
    )


CASES = {
    case.name: case
    for case in (
        Case("clamped_sheet", "sheet of 1 m, 0.2 kg, four edges fixed", clamped_sheet, 30, 1e-3, 32, 1e3),
        Case("swinging_sheet", "sheet of 1 m, 0.2 kg, let go at 45 degrees", swinging_sheet, 30, 1e-3, 16, 1e3),
        Case("heavy_hem", "swinging sheet with a hem 100x as heavy", heavy_hem, 30, 1e-3, 16, 1e3),
        Case("curtain", "sheet of 1 m, 0.2 kg, held by two corners", two_corner_curtain, 30, 1e-3, 16, 1e3),
        Case("cantilever", "rod of 1 m, 0.2 kg, EI 2 N m2, clamped level", cantilever, 30, 1e-3, 16, 1e5),
        Case(
            "ball",
            "sheet of 1 m, 0.2 kg, onto a ball",
            contact_cases.sheet_over_ball,
            30,
            1e-3,
            16,
            1e3,
            contact_cases.BALL,
        ),
        Case(
            "incline",
            "sheet of 0.2 m on a slope of 35 degrees, mu 0.5 and 0.3",
            contact_cases.sliding_sheet,
            30,
            1e-3,
            8,
            1e3,
            contact_cases.SLOPE,
            lambda resolution, constant: contact_cases.sliding_frames(
                build(contact_cases.sliding_sheet(resolution, constant), BODY, False).rest, FRAME_DT * np.arange(31.0)
            ),
        ),
        Case(
            "capstan",
            "rope over a drum, 0.1 kg and 0.3 kg at its ends, mu 0.2",
            contact_cases.rope_over_drum,
            30,
            1e-3,
            40,
            1e6,
            contact_cases.DRUM,
            lambda resolution, _: contact_cases.rope_frames(resolution, FRAME_DT * np.arange(31.0)),
        ),
        # The load stretches every chain by half to one percent at rest.
        Case("chain_1", "chain of 1 m, 0.2 kg, load of 0.2 kg", loaded_chain(1.0), 30, 1e-3, 64, 2.5e4),
        Case("chain_100", "chain of 1 m, 0.2 kg, load of 20 kg", loaded_chain(1e2), 30, 1e-3, 64, 1.25e6),
        Case("chain_10000", "chain of 1 m, 0.2 kg, load of 2000 kg", loaded_chain(1e4), 30, 1e-3, 64, 1.25e8),
    )
}
