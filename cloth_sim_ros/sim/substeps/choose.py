# SPDX-License-Identifier: Apache-2.0
"""Choose the order, substeps and iterations of each object that the settings leave open, and give the reason.

Errors and prices were measured (docs/explanation/study.md, `study error`). The choice depends only on them and on the
scene, never on a clock. So the same scene is always computed in the same way.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from cloth_sim_ros.sim.lines.membrane import WHOLE
from cloth_sim_ros.sim.physics.integrate import MOST_TURNED
from cloth_sim_ros.sim.scene.settings import Settings
from cloth_sim_ros.sim.substeps import limits, prices
from cloth_sim_ros.sim.substeps.prices import Surroundings
from cloth_sim_ros.sim.topology import Topology

_MOST_STIFF = 6.0  # largest ratio of the substeps that leapfrog needs to the sweeps of BDF2 on a mesh
_SAFE = 40  # minimum substeps of a repeated frame
FEWEST = 6  # minimum substeps per frame; contact and gusts need them
_FEWEST_LAYERS, _FEWEST_COILS = 13, 40  # minimum substeps with self or object contact: sheet, rope
# Largest number of particles along a sheet's side per substep of xpbd: without and with self or object contact. With
# fewer substeps, shape does not spread across the sheet, or contact fails.
_SIDE, _SIDE_LAYERS = 10.0, 5.0
_MOST_LINES = 2000  # maximum substeps of xpbd
_LEAST_ROPE = 20  # substeps of a rope at an error of 1e-3
# Fraction of a segment by which a rope's tension may move a particle in a substep, before a collider moves it back.
_LEANS = 0.05

# Error laws of XPBD, relative to the motion.
# - BDF2 by lines: _BDF2 (limit / 44)^2 (16 / side)^1.4 / substeps^2. This holds for sheets held at all edges, the
#   hardest of the study's cases. `limit` is the number of substeps that leapfrog needs, side^2 the number of particles.
# - A sheet too stiff to stretch visibly: at most _RIGID / substeps^2.
# - A sheet held along one edge swings: _HUNG / substeps for a grid, _HUNG_MESH side / substeps for a mesh. This holds
#   for a length of _LENGTH [m], and scales with the rate of a pendulum.
# - A grid that is free, or held at few particles: at most _FREE / substeps, scaled likewise.
# - Implicit Euler: at least _EULER / substeps.
# Laws without `limit` were measured in frames of _FRAME [s], and scale with the length of a substep.
_BDF2, _RIGID, _HUNG, _HUNG_MESH, _FREE, _LENGTH, _EULER, _FRAME = 5.6, 30.0, 0.013, 1e-3, 0.2, 1.2, 0.1, 1.0 / 60.0
_BENDING = 0.2  # largest (omega h_e)^2 of the stiffest bending mode when xpbd chooses its substeps
_LEAPFROG = 4.0e-4  # relative error of leapfrog at its limit; twice the substeps divide it by four
_MANY = 16  # largest number of materials that are examined one by one


@dataclass(frozen=True)
class Choice:
    """How one object is computed; `reason` is text that follows the object's name.

    error: expected error in the units of solver.error. safe_substeps: substeps of a frame that XPBD repeats.
    bending_share: share of a sheet's bending rigidity that acts. surface: True if colliders are also kept out between
    particles.
    """

    method: str
    order: int
    substeps: int
    iterations: int
    error: float
    reason: str
    safe_substeps: int = 1
    bending_share: float = 1.0
    surface: bool = False

    @property
    def words(self) -> str:
        """The method and its order."""
        return self.method if self.method == "verlet" else f"{self.method} order {self.order}"

    @property
    def kernels(self) -> tuple[str, bool]:
        """Properties that kernels depend on; a change rebuilds everything on the device."""
        return self.words, self.surface


def choose(
    settings: Settings,
    topology: Topology,
    materials: Collection[tuple[Sequence[float], float]],
    around: Surroundings,
) -> Choice:
    """Choose how to compute an object whose worlds have these pairs of compliances and damping.

    Numbers that are set in `settings` are kept.
    """
    limit = partial(_explicit_substeps, topology, settings, around)
    kinks = _kinks(settings, topology, materials, max(limit(compliance, 0.0) for compliance, _ in materials), around)
    xpbd = _xpbd(settings, topology, materials, kinks, around)
    if settings.method != "verlet":
        return xpbd
    needed = max(limit(compliance, damping) for compliance, damping in materials)
    safe = max(xpbd.substeps, _SAFE, math.ceil(kinks.substeps(settings.error, 1)))
    return replace(_verlet(settings, needed, around.surface), safe_substeps=safe)


def _explicit_substeps(
    topology: Topology, settings: Settings, around: Surroundings, compliance: Sequence[float], damping: float
) -> float:
    return limits.explicit_substeps(topology, compliance, damping, settings.frame_dt, around.wind)


def xpbd_is_direct(topology: Topology) -> bool:
    """True if xpbd solves an object as a whole, as it does a rope."""
    return not len(topology.triangles)


def _budget(settings: Settings) -> float:
    """Time budget of a frame [ms]."""
    return 1e3 * settings.budget * settings.frame_dt


def _verlet(settings: Settings, needed: float, surface: bool) -> Choice:
    """Choose explicit steps: as many as stability needs, and more if the error would exceed the wanted one."""
    least = max(FEWEST * max(1.0, settings.frame_dt / _FRAME), needed)
    substeps = settings.substeps or least * max(1.0, math.sqrt(_LEAPFROG / settings.error))
    substeps = math.ceil(substeps) if math.isfinite(substeps) else 1
    error = _LEAPFROG * (least / substeps) ** 2 if math.isfinite(needed) else math.inf
    reason = f"is computed by verlet in {substeps} substeps, of which it needs {needed:g} to be stable"
    return Choice("verlet", 1, substeps, settings.iterations or 1, error, reason, surface=surface)


def _xpbd(
    settings: Settings,
    topology: Topology,
    materials: Collection[tuple[Sequence[float], float]],
    kinks: limits.LineKinkError,
    around: Surroundings,
) -> Choice:
    """Choose XPBD with as many substeps as the wanted error needs and the budget allows."""
    iterations, rate, limit = settings.iterations or 1, _bending_rate(topology, materials), kinks.limit
    fewest, leaning = _fewest(topology, around.coupled), _leaning(topology, settings, around)
    affordable = _budget(settings) / (iterations * prices.xpbd(topology, materials, around))

    def substeps_of(order: int, least: float) -> tuple[int, float, float]:
        """Return the substeps taken, the substeps wanted, and the error of those taken."""
        laws = _error_laws(topology, limit, order, settings.frame_dt)
        enough = min((constant / settings.error) ** (1.0 / power) for constant, power in laws)
        bending = _effective(settings, order) * math.sqrt(rate / _BENDING)
        wanted = max(enough, bending, leaning, least, kinks.substeps(settings.error, order))
        taken = settings.substeps or int(np.clip(math.ceil(min(wanted, affordable)), fewest, _MOST_LINES))
        error = min(constant / taken**power for constant, power in laws)
        return taken, wanted, max(error, kinks.error(taken, order))

    order, calm = settings.order or 2, 0.0 if settings.order else _calm_substeps(topology, limit) / iterations
    substeps, wanted, error = substeps_of(order, calm)
    if (substeps < calm and topology.coupling is None) or (not settings.order and substeps_of(1, 0.0)[0] < substeps):
        order = 1
        substeps, wanted, error = substeps_of(order, 0.0)
    reason = f"is computed by xpbd order {order} in {substeps} x {iterations}"
    if not settings.substeps and substeps < math.floor(wanted):
        reason += f"; the budget allows no more, so its error may be {error:.2g} instead of {settings.error:g}"
        reason += f" ({math.ceil(wanted)} substeps); a larger solver.budget or solver.error helps"
    if kinks.error(substeps, order) > settings.error:
        reason += f"; under its weight it is strained {kinks.excess(substeps, order):.0%} too much"
    if order == 2 and topology.bends_by_angles:
        reason += f"; substeps in which a joint is bent by more than {MOST_TURNED:g} rad are of first order"
    share = limits.bending_share(rate, _effective(settings, order) / substeps)
    if share < 1.0:
        reason += f"; {share:.2g} of its bending rigidity acts"
    if topology.coupling is not None and substeps < _whole_substeps(limit, order):
        reason += "; it shears too little"
    return Choice("xpbd", order, substeps, iterations, error, reason, bending_share=share, surface=around.surface)


def _fewest(topology: Topology, coupled: bool) -> int:
    """Minimum substeps to choose; `coupled`: True with self or object contact."""
    if xpbd_is_direct(topology):
        return _FEWEST_COILS if coupled else FEWEST
    side = math.sqrt(len(topology.masses)) / (_SIDE_LAYERS if coupled else _SIDE)
    return max(_FEWEST_LAYERS if coupled else FEWEST, math.ceil(side))


def _leaning(topology: Topology, settings: Settings, around: Surroundings) -> float:
    """Substeps that a rope needs to lean on a collider with its whole weight; 0 for a sheet or without colliders."""
    if not xpbd_is_direct(topology) or not around.colliders:
        return 0.0
    pulled = around.gravity * topology.masses.sum() / float(np.median(topology.masses))
    spacing = float(np.median(topology.springs["structural"].rest)) * topology.scales_in().min()
    return settings.frame_dt * math.sqrt(pulled / (_LEANS * spacing))


def _effective(settings: Settings, order: int) -> float:
    """Effective length h_e of a substep times the number of substeps [s]."""
    return settings.frame_dt * limits.EFFECTIVE[order]


def _error_laws(topology: Topology, limit: float, order: int, frame_dt: float) -> list[tuple[float, int]]:
    """Constants and powers of error laws; the error of XPBD is the least of constant / substeps^power.

    limit: substeps that leapfrog needs.
    """
    long = frame_dt / _FRAME
    side = math.sqrt(len(topology.masses))
    if topology.hung_length > 0.0:
        swing = _swing(topology, topology.hung_length) * long
        laws = [((_HUNG if topology.grid is not None else _HUNG_MESH * side) * swing, 1)]
    elif xpbd_is_direct(topology):
        laws = [(_LEAST_ROPE**2 * 1e-3 * long**2, 2)]
    else:
        laws = [(min(_BDF2 * (limit / 44.0) ** 2 * (16.0 / side) ** 1.4, _RIGID * long**2), 2)]
        if topology.grid is not None and topology.is_free and order == 2:
            laws.append((_FREE * _swing(topology, float(np.ptp(topology.layout, axis=0).max())) * long, 1))
    return laws if order == 2 else [(max(math.sqrt(laws[0][0]), _EULER * long), 1)]


def _kinks(
    settings: Settings,
    topology: Topology,
    materials: Collection[tuple[Sequence[float], float]],
    limit: float,
    around: Surroundings,
) -> limits.LineKinkError:
    """Error left by the kinks of a mesh's lines; limit: substeps that leapfrog needs without dashpots."""
    weight = around.gravity * topology.masses.sum() if _is_mesh(topology) and math.isfinite(limit) else 0.0
    strain = 0.5 * weight * max(compliance[0] for compliance, _ in materials)
    if topology.coupling is not None and weight > 0.0:
        strain = max(strain, limits.SEEN)  # it has its moduli under any load
    return limits.LineKinkError(limit, strain, settings.iterations or 1)


def _swing(topology: Topology, length: float) -> float:
    """Frequency of a pendulum of `length` [m] relative to one of _LENGTH, in the world where the object is smallest."""
    return math.sqrt(_LENGTH / (length * topology.scales_in().min()))


def _calm_substeps(topology: Topology, limit: float) -> float:
    """Minimum sweeps of second order on a mesh; with fewer, the residual of its stiff springs shakes it.

    Those of a membrane do not, but only a part of its coupling acts then.
    """
    if topology.coupling is not None:
        return _whole_substeps(limit, 2)
    return limit / _MOST_STIFF if _is_mesh(topology) else 0.0


def _whole_substeps(limit: float, order: int) -> float:
    """Substeps in which the whole coupling of a membrane acts; `limit`: those that leapfrog needs."""
    return limits.LEAPFROG * limits.EFFECTIVE[order] * limit / math.sqrt(WHOLE)


def _is_mesh(topology: Topology) -> bool:
    """True if an object is a sheet that is no grid."""
    return len(topology.triangles) > 0 and topology.grid is None


def _bending_rate(topology: Topology, materials: Collection[tuple[Sequence[float], float]]) -> float:
    """omega^2 of the stiffest bending mode of a sheet [1/s^2]."""
    softest = min(compliance[2] for compliance, _ in materials)
    return topology.plate_rate / max(softest, 1e-30) if topology.plate is not None else 0.0


def distinct(materials: np.ndarray) -> set[tuple]:
    """The distinct pairs of compliances and damping in rows of Material.

    If they are very many, return one pair with the least compliances and the largest damping. So the cost does not grow
    with a thousand worlds.
    """
    columns = np.column_stack([materials["compliance"], materials["damping"]])
    codes = np.zeros(len(columns), dtype=int)
    for column in columns.T:  # one by one, as sorting rows of several numbers is slow
        if (column == column[0]).all():
            continue
        if len(set(column[: 4 * _MANY].tolist())) > _MANY:
            break
        found, where = np.unique(column, return_inverse=True)
        if len(found) > _MANY:
            break
        codes = codes * len(found) + where
    else:
        rows = columns[np.unique(codes, return_index=True)[1]]
        if len(rows) <= _MANY:
            return {(tuple(row[:3]), row[3]) for row in rows.tolist()}
    *stiffest, damped = [*columns[:, :3].min(axis=0).tolist(), float(columns[:, 3].max())]
    return {(tuple(stiffest), damped)}
