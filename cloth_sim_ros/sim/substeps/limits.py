# SPDX-License-Identifier: Apache-2.0
"""Largest stable steps of an explicit method, in NumPy from the rest shape, without a device."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from cloth_sim_ros.sim.physics.plate import MOST_BENDING
from cloth_sim_ros.sim.scene.scene import Scene
from cloth_sim_ros.sim.scene.settings import Settings
from cloth_sim_ros.sim.topology import KINDS, Topology


class Unstable(ValueError):
    """Explicit steps cannot compute an object; the message says what is allowed."""


# Fraction of the stable step for small motions that is used: in a sheet, and in a rope. Leapfrog heats springs that
# turn while they stretch, in resonances of third, fourth, .. order, at omega h = sqrt(3), sqrt(2), .. (Schlick et al.
# 1998). At a fraction of 0.9 a whipping rope flies apart within a minute, and so does a soft hung sheet. In a line of
# springs most modes are near the fastest, in a sheet few.
_SHARE = 0.7
_SHARE_OF_LINES = 0.5

_ROUNDING = 2.0**-24 / math.sqrt(3.0)  # RMS relative rounding error of a length in float32
_HEAT = 1e-2  # largest heating by rounding [m^2/s^3]; beyond it a spring counts as rigid

EFFECTIVE = {1: 1.0, 2: 2.0 / 3.0}  # order -> effective length h_e of a substep of XPBD over its length h


def bending_share(rate: float, step: float) -> float:
    """The share of a sheet's bending rigidity that acts under XPBD, for its stiffest mode's omega^2 [1/s^2] and h_e."""
    return min(1.0, MOST_BENDING / max(rate * step * step, 1e-30))


def check_explicit(
    scene: Scene, settings: Settings, name: str, topology: Topology, materials: Iterable[tuple[Sequence[float], float]]
) -> None:
    """Raise Unstable if explicit steps lack a feature of an object, or are unstable for it.

    materials: pairs of compliances [m/N] and damping [s]. The message says what is allowed.
    """
    thing = scene.objects[name]
    lacking = {
        "a winch on": getattr(thing, "winch", None) is not None,
        "twist in": getattr(thing, "twist_compliance", None) is not None,
        "bending by angles of": topology.bends_by_angles,
        "self_contact of": thing.self_contact,
        "object_contact of": scene.object_contact,
        "a seam of": name in scene.sewn,
        "tear_strain of": topology.tear_strain > 0.0,
        "a shear_compliance of the mesh": topology.coupling is not None,
    }
    for what, is_there in lacking.items():
        if is_there:
            raise Unstable(f"solver.method is 'verlet' with {what} {name}; allowed is 'auto' or 'xpbd'")
    for compliance, damping in materials:
        needed = explicit_substeps(topology, compliance, damping, settings.frame_dt, scene.wind is not None)
        if math.isinf(needed):
            raise Unstable(
                f"solver.method is 'verlet' with a spring of {name} too stiff for explicit steps; allowed is 'auto' or "
                f"'xpbd'"
            )
        if 0 < settings.substeps < needed:
            raise Unstable(
                f"solver.substeps is {settings.substeps} with method 'verlet'; allowed is at least {needed:g} for the "
                f"stiffness and damping of {name}, or method 'xpbd'"
            )


def explicit_substeps(
    topology: Topology, compliance: Sequence[float], damping: float, frame_dt: float, crumples: bool
) -> float:
    """Return the minimum substeps per frame of `frame_dt` [s] at which leapfrog is stable.

    They are infinite if a spring is rigid, and for a winch, which feeds a segment from zero length.

    Dashpots have the time constant tau = `damping` [s], and their force uses the velocity of the last half step. Then
    the limit is omega^2 (h^2 + 2 h tau) < 4 (Jury's criterion on one oscillator). omega^2 is the largest eigenvalue of
    M^-1 K of all springs, by power iteration from a fixed start. K is taken at rest or, if the body `crumples` as in
    wind, as a bound over all shapes. A stretched spring along n has the stiffness
    k (n n^T + (1 - rest / length) (1 - n n^T)), at most k in every direction. With that bound, K is the Laplacian of
    the springs' graph along each axis. A sheet uses 0.7 of that step and a rope 0.5, because of nonlinear resonances
    (Schlick, Mandziuk, Skeel and Srinivas 1998, Nonlinear resonance artifacts in molecular dynamics simulations).

    The rounding r of lengths l shakes particles by (k / m) l r h in a substep of length h = 2 / omega. As a random walk
    this heats them by (l r)^2 omega^3 / 8 per second. The substeps are also infinite if that exceeds _HEAT.
    """
    if topology.winch is not None:
        return math.inf
    values = [float(compliance[KINDS.index(kind)]) for kind in topology.springs]
    if 0.0 in values or (topology.plate is not None and compliance[2] == 0.0):
        return math.inf
    if not values:
        return 1
    found, constants = topology.frequencies(crumples), tuple(1.0 / value for value in values)
    length = found.mean_length * topology.scales_in().max()
    plate = 0.0 if topology.plate is None else topology.plate_rate / float(compliance[2])
    about, margin = found.near(constants)
    least, most = (
        _substeps_for(topology, share * about + plate, length, damping, frame_dt)
        for share in (1.0 - margin, 1.0 + margin)
    )
    if least == most:
        return least
    return _substeps_for(topology, found.exact(constants) + plate, length, damping, frame_dt)


def _substeps_for(topology: Topology, largest: float, length: float, damping: float, frame_dt: float) -> float:
    """Minimum substeps of a frame, for omega^2 of the fastest mode `largest` [1/s^2] and mean spring `length` [m]."""
    if largest == 0.0:
        return 1.0
    if (length * _ROUNDING) ** 2 * largest * math.sqrt(largest) / 8.0 > _HEAT:
        return math.inf
    longest = 4.0 / largest / (damping + math.sqrt(damping**2 + 4.0 / largest))
    share = _SHARE if len(topology.triangles) else _SHARE_OF_LINES
    return float(math.ceil(frame_dt / (share * longest)))
