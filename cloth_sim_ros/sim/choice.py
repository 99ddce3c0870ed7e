"""What computes each object where the settings leave it open, and why: the cheapest way to the wanted error.

The error of both methods and their prices were measured (docs/study.md, `study error`); what is chosen depends on
these constants and the scene alone, never on a clock, so that the same scene is computed alike every time.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cloth_sim_ros.sim import limits
from cloth_sim_ros.sim.settings import Settings
from cloth_sim_ros.sim.topology import Topology

STRAINED = 0.5  # Strain of a spring beyond which explicit steps may heat an object, however small they are at rest
_SAFE = 40  # substeps of a frame that is done again, at least
FEWEST = 10  # substeps a frame that are chosen at least: contact and gusts need them
_MOST_LINES = 2000  # substeps of xpbd that are chosen at most
_LEAST_ROPE = 20  # of a rope at an error of 1e-3

# BDF2 by lines misses the motion by _BDF2 (limit / 44)^2 (16 / side)^1.4 / substeps^2, relative to it, in sheets held
# at all edges, the hardest of the study's cases; `limit` are the substeps that leapfrog needs, side^2 the particles.
# Of a sheet too stiff to be seen to stretch it is no more than _RIGID / substeps^2.
_BDF2, _RIGID = 5.6, 30.0
_BENDING = 0.3  # (omega h_e)^2 of the stiffest bending mode that xpbd is given where it chooses
_LEAPFROG = 4.0e-4  # error of leapfrog at its limit, likewise; by four with twice the substeps


@dataclass(frozen=True)
class Price:
    """Milliseconds that a substep takes on a device: a part for itself and a part for each particle."""

    verlet: tuple[float, float]
    lines: tuple[float, float]
    rope: tuple[float, float]

    def of(self, kind: str, particles: int, substeps: float) -> float:
        """Of a frame [ms]."""
        each, by_particle = getattr(self, kind)
        return substeps * (each + by_particle * particles)


PRICES = {
    "cpu": Price(verlet=(2.0e-4, 9.0e-6), lines=(2.0e-4, 1.8e-5), rope=(1.0e-4, 5.0e-5)),
    "cuda": Price(verlet=(6.0e-4, 1.6e-8), lines=(2.5e-2, 4.0e-7), rope=(5.0e-3, 1.0e-6)),
}


@dataclass(frozen=True)
class Choice:
    """How one object is computed; `reason` says why, in words that follow its name.

    error: what is expected of it, in the units of solver.error. safe_substeps: of a frame that XPBD does again.
    """

    method: str
    order: int
    substeps: int
    iterations: int
    error: float
    reason: str
    safe_substeps: int = 1

    @property
    def words(self) -> str:
        """The method and its order."""
        return self.method if self.method == "verlet" else f"{self.method} order {self.order}"


def choose(
    settings: Settings,
    topology: Topology,
    materials: Collection[tuple[Sequence[float], float]],
    crumples: bool,
    strained: bool,
    device: str,
) -> Choice:
    """How to compute an object of `topology` on a `device` of PRICES, whose worlds have these pairs of compliances and
    damping, which wind `crumples`; one that is or was `strained` beyond all rest is left to xpbd.

    Numbers that are set in `settings` are kept; set iterations or an order belong to xpbd.
    """
    needed = max(limits.explicit_substeps(topology, *material, settings.frame_dt, crumples) for material in materials)
    undamped = max(limits.explicit_substeps(topology, c, 0.0, settings.frame_dt, crumples) for c, _ in materials)
    softest = min((c[2] for c, _ in materials), default=0.0)
    bending = math.sqrt(topology.plate_rate / softest) if topology.plate is not None and softest > 0.0 else 0.0
    xpbd = _xpbd(settings, topology, undamped, bending, device)
    if settings.method == "xpbd":
        return xpbd
    verlet = replace(_verlet(settings, needed), safe_substeps=max(xpbd.substeps, _SAFE))
    if settings.method == "verlet":
        return verlet
    because = _not_explicit(settings, topology, needed, strained)
    if because:
        return _with_reason(xpbd, f"{because}; {xpbd.reason}")
    price, count, budget = PRICES[device], len(topology.masses), _budget(settings)
    kind = "rope" if xpbd_is_direct(topology) else "lines"
    cost, other = price.of("verlet", count, verlet.substeps), price.of(kind, count, xpbd.substeps * xpbd.iterations)
    nearer = verlet.error <= xpbd.error
    if (cost <= other and cost <= budget) or (nearer and cost <= budget and xpbd.error > settings.error):
        return verlet
    if cost > budget:
        why = f"explicit steps would need {needed:g} substeps, more than the budget"
        return _with_reason(xpbd, f"{why}; {xpbd.reason}")
    return xpbd


def xpbd_is_direct(topology: Topology) -> bool:
    """Whether xpbd solves an object as a whole, a rope."""
    return not len(topology.triangles)


def _budget(settings: Settings) -> float:
    """What a frame may take [ms]."""
    return 1e3 * settings.budget * settings.frame_dt


def _with_reason(choice: Choice, reason: str) -> Choice:
    return replace(choice, reason=reason)


def _not_explicit(settings: Settings, topology: Topology, needed: float, strained: bool) -> str:
    """Why explicit steps cannot be taken, in words; "" where they can."""
    if settings.iterations or settings.order:
        return "iterations or an order are set, which belong to xpbd"
    if topology.reel is not None:
        return "a winch feeds it, which explicit steps lack"
    if topology.bends_by_angles:
        return "it bends by angles, which explicit steps lack"
    if strained:
        return f"it is or was strained by more than {STRAINED:g}, and explicit steps heat it"
    if math.isinf(needed):
        return "a spring is too stiff for explicit steps"
    if settings.substeps and settings.substeps < needed:
        return f"explicit steps would need {needed:g} substeps and {settings.substeps} are set"
    return ""


def _verlet(settings: Settings, needed: float) -> Choice:
    """Explicit steps: as many as stability asks for, and more where they would miss by more than is wanted."""
    least = max(FEWEST, needed)
    substeps = settings.substeps or least * max(1.0, math.sqrt(_LEAPFROG / settings.error))
    substeps = math.ceil(substeps) if math.isfinite(substeps) else 1
    error = _LEAPFROG * (least / substeps) ** 2 if math.isfinite(needed) else math.inf
    reason = f"is computed by verlet in {substeps} substeps, of which it needs {needed:g} to be stable"
    return Choice("verlet", 1, substeps, settings.iterations or 1, error, reason)


def _xpbd(settings: Settings, topology: Topology, limit: float, bending: float, device: str) -> Choice:
    """XPBD in as many substeps as the wanted error asks for and the budget allows.

    limit: substeps that leapfrog needs without dashpots; bending: rate of the stiffest bending mode [1/s].
    """
    order, iterations, count = settings.order or 2, settings.iterations or 1, len(topology.masses)
    direct = xpbd_is_direct(topology)
    if direct:
        constant = _LEAST_ROPE**2 * 1e-3
    else:
        constant = _BDF2 * (limit / 44.0) ** 2 * (16.0 / math.sqrt(count)) ** 1.4 if math.isfinite(limit) else _RIGID
        constant = min(constant, _RIGID)
    power = 2 if order == 2 else 1
    effective = settings.frame_dt * (2.0 / 3.0 if order == 2 else 1.0)
    wanted = max((constant / settings.error) ** (1.0 / power), effective * bending / math.sqrt(_BENDING))
    each = PRICES[device].of("rope" if direct else "lines", count, iterations)
    affordable = _budget(settings) / each
    substeps = settings.substeps or int(np.clip(math.ceil(min(wanted, affordable)), FEWEST, _MOST_LINES))
    error = constant / substeps**power
    reason = f"is computed by xpbd order {order} in {substeps} x {iterations}"
    if not settings.substeps and substeps < math.floor(wanted):
        reason += (
            f", where an error of {settings.error:g} would take {math.ceil(wanted)} substeps: it may be {error:.2g}"
        )
    return Choice("xpbd", order, substeps, iterations, error, reason)


def is_strained(topology: Topology, positions: np.ndarray) -> bool:
    """Whether positions (N, 3) [m] strain any spring by more than STRAINED."""
    for elements in topology.springs.values():
        length = np.linalg.norm(positions[elements.particles[:, 1]] - positions[elements.particles[:, 0]], axis=1)
        if (np.abs(length - elements.rest) > STRAINED * elements.rest).any():
            return True
    return False
