# SPDX-License-Identifier: Apache-2.0
"""Cases with contact, and their exact motion if it is known."""

from __future__ import annotations

import numpy as np

from cloth_sim_ros.sim import Capsule, Cloth, Plane, Rope, Sphere
from cloth_sim_ros.study.closed_forms import contact
from cloth_sim_ros.study.contact import SLOW

GRAVITY = 9.81
BALL = {"ball": Sphere(radius=0.3, position=(0.0, 0.0, -0.325))}
_SLOPE, _THICKNESS = np.deg2rad(35.0), 0.005
_NORMAL = np.array([np.sin(_SLOPE), 0.0, np.cos(_SLOPE)])
_DOWN = np.array([np.cos(_SLOPE), 0.0, -np.sin(_SLOPE)])
SLOPE = {"slope": Plane(normal=tuple(_NORMAL), static_friction=0.5, kinetic_friction=0.3)}
_DRUM, _ROPE, _GRIP = 0.1, 0.005, 0.2  # radii [m] and friction
DRUM = {
    "drum": Capsule(
        radius=_DRUM,
        half_length=0.2,
        orientation=(np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)),
        static_friction=_GRIP,
        kinetic_friction=_GRIP,
    )
}
_HANGING = 0.4  # [m] of rope on either side
_LOADS = (0.1, 0.3)  # [kg] at its ends; the rope itself weighs next to nothing


def sheet_over_ball(resolution: int, constant: float) -> Cloth:
    """A square sheet of 1 m and 0.2 kg that falls from level onto a ball of 0.3 m just below.

    It is so thick that the ball cannot come between 16 x 16 particles: the reference has contact of particles only.
    """
    return Cloth(
        resolution=(resolution, resolution),
        pins=(),
        stretch_compliance=1.0 / constant,
        shear_compliance=1.0 / constant,
        thickness=0.01,
    )


def sliding_sheet(resolution: int, constant: float) -> Cloth:
    """A square sheet of 0.2 m that lies on a slope of 35 degrees, touching it, and is let go."""
    return Cloth(
        resolution=(resolution, resolution),
        size=(0.2, 0.2),
        pins=(),
        stretch_compliance=1.0 / constant,
        shear_compliance=1.0 / constant,
        thickness=_THICKNESS,
        static_friction=0.5,
        kinetic_friction=0.3,
        position=tuple(_THICKNESS * _NORMAL),
        orientation=(0.0, np.sin(0.5 * _SLOPE), 0.0, np.cos(0.5 * _SLOPE)),
    )


def sliding_frames(start: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Return positions (F, N, 3) [m] at `times` [s] of a body that slides down the slope from rest, as a whole."""
    ways = contact.incline_distance(times, _SLOPE, 0.5, 0.3, SLOW, GRAVITY)
    return start + ways[:, None, None] * _DOWN


def rope_over_drum(resolution: int, constant: float) -> Rope:
    """A rope over a drum with 0.1 kg at one end and 0.3 kg at the other, three times the friction's e^(mu pi) = 1.87.

    A whole number of the `resolution` segments lies on the drum, so that they start unstrained.
    """
    masses = np.full(resolution + 1, 1e-3 / resolution)
    masses[[0, -1]] = _LOADS
    return Rope(
        points=_on_drum(resolution, np.arange(resolution + 1.0)),
        particle_masses=masses,
        radius=_ROPE,
        pins=(),
        stretch_compliance=1.0 / (constant * _segment(resolution)),
        static_friction=_GRIP,
        kinetic_friction=_GRIP,
    )


def rope_frames(resolution: int, times: np.ndarray) -> np.ndarray:
    """Positions (F, N, 3) [m] at `times` [s] of the rope, inextensible and without mass: Atwood's machine whose sides
    differ by the capstan's ratio of a chain."""
    ratio = contact.capstan_ratio_of_nodes(_GRIP, np.pi, _on_the_drum(resolution))
    light, heavy = _LOADS
    a = GRAVITY * (heavy - ratio * light) / (heavy + ratio * light)
    shifts = 0.5 * a * times**2 / _segment(resolution)
    return np.stack([_on_drum(resolution, np.arange(resolution + 1.0) + shift) for shift in shifts])


def _on_the_drum(resolution: int) -> int:
    """Segments on the drum."""
    arc = np.pi * (_DRUM + _ROPE)
    return max(2, round(resolution * arc / (arc + 2.0 * _HANGING)))


def _segment(resolution: int) -> float:
    """Length of a segment [m]: the chord of its share of the half circle."""
    return 2.0 * (_DRUM + _ROPE) * np.sin(0.5 * np.pi / _on_the_drum(resolution))


def _on_drum(resolution: int, place: np.ndarray) -> np.ndarray:
    """Points (N, 3) [m] of the rope's way, up the left side, over the drum, down the right, at `place` in segments."""
    count, a, radius = _on_the_drum(resolution), _segment(resolution), _DRUM + _ROPE
    before = (resolution - count) // 2
    along = place - before
    angle = np.pi * np.clip(along, 0.0, count) / count
    left, right = np.minimum(along, 0.0) * a, np.maximum(along - count, 0.0) * a
    return np.stack([-radius * np.cos(angle), 0.0 * angle, radius * np.sin(angle) + left - right], axis=1)
