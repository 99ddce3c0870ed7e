# SPDX-License-Identifier: Apache-2.0
"""Choose the order and iterations of each object, and the bounds within which its substeps follow from measured errors.

The choice depends only on the scene and on the speed of the device, which is measured once. So a machine computes the
same scene always in the same way.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cloth_sim_ros.sim.features.collider_contact.lean import SHORT
from cloth_sim_ros.sim.lines.solve import DAMPED
from cloth_sim_ros.sim.scene.settings import Settings
from cloth_sim_ros.sim.substeps import limits, prices
from cloth_sim_ros.sim.substeps.prices import Surroundings
from cloth_sim_ros.sim.topology import Topology

_START = 20  # substeps of a frame of _FRAME [s] until the first error is measured, for an error of 1e-2
_FRAME = 1.0 / 60.0
_MOST = 2000  # maximum substeps of xpbd
_FINE = 0.01  # segments [m] below which a rope beside colliders may take substeps shorter than SHORT, in proportion
_SAFE = 40  # minimum substeps of a repeated frame
FEWEST = 6  # minimum substeps per frame; contact and gusts need them
_FEWEST_LAYERS, _FEWEST_COILS = 13, 40  # minimum substeps with self or object contact: sheet, rope
# Largest number of particles along a sheet's side per substep of xpbd: without and with self or object contact. With
# fewer substeps, shape does not spread across the sheet, or contact fails.
_SIDE, _SIDE_LAYERS = 10.0, 5.0
_LOOSE = 1e-2  # error for which the static strain stays right, however much contact costs
# See _static: largest excess of a static strain over solver.error, loss in meshes, strain that is seen.
_EXCESS, _LOST, _SEEN = 25.0, 0.1, 1e-4
_COUPLED = 1.3  # factor of these substeps for a membrane, as its soft strains lose most
_MOST_STIFF = 6.0  # largest ratio of the substeps that leapfrog needs to the sweeps of BDF2 on a mesh
_BENDING = 0.2  # largest (omega h_e)^2 of the stiffest bending mode when xpbd chooses its substeps
_LEAPFROG = 4.0e-4  # relative error of leapfrog at its limit; twice the substeps divide it by four
_MANY = 16  # largest number of materials that are examined one by one


@dataclass(frozen=True)
class Choice:
    """How one object is computed; `reason` is text that follows the object's name.

    substeps: those of the first frame. least, most: bounds of the substeps that follow from the measured error; both
    are `substeps` if that is set. error: expected error in the units of solver.error. safe_substeps: substeps of an
    explicit frame that XPBD repeats. bending_share: share of a sheet's bending rigidity that acts. surface: True if
    colliders are also kept out between particles. test, fewest: see StepLimits.
    """

    method: str
    order: int
    substeps: int
    iterations: int
    error: float
    reason: str
    least: int
    most: int
    safe_substeps: int = 1
    bending_share: float = 1.0
    surface: bool = False
    test: float = 0.0
    fewest: int = 1

    @property
    def words(self) -> str:
        """The method and its order."""
        return self.method if self.method == "verlet" else f"{self.method} order {self.order}"

    @property
    def kernels(self) -> tuple[str, bool]:
        """Properties that kernels depend on; a change rebuilds everything on the device."""
        return self.words, self.surface


def choose(
    settings: Settings, topology: Topology, materials: Collection[tuple[Sequence[float], float]], around: Surroundings
) -> Choice:
    """Choose how to compute an object whose worlds have these pairs of compliances and damping.

    Numbers that are set in `settings` are kept.
    """

    def limit(compliance: Sequence[float], damping: float) -> float:
        return limits.explicit_substeps(topology, compliance, damping, settings.frame_dt, around.wind)

    xpbd = _xpbd(settings, topology, materials, max(limit(each, 0.0) for each, _ in materials), around)
    if settings.method != "verlet":
        return xpbd
    needed = max(limit(compliance, damping) for compliance, damping in materials)
    return replace(_verlet(settings, needed, around.surface), safe_substeps=max(xpbd.substeps, _SAFE))


def xpbd_is_direct(topology: Topology) -> bool:
    """True if xpbd solves an object as a whole, as it does a rope."""
    return not len(topology.triangles)


def _verlet(settings: Settings, needed: float, surface: bool) -> Choice:
    """Choose explicit steps: as many as stability needs, and more if the error would exceed the wanted one."""
    least = max(FEWEST * max(1.0, settings.frame_dt / _FRAME), needed)
    substeps = settings.substeps or least * max(1.0, math.sqrt(_LEAPFROG / settings.error))
    substeps = math.ceil(substeps) if math.isfinite(substeps) else 1
    error = _LEAPFROG * (least / substeps) ** 2 if math.isfinite(needed) else math.inf
    reason = f"is computed by verlet in {substeps} substeps, of which it needs {needed:g} to be stable"
    iterations = settings.iterations or 1
    return Choice("verlet", 1, substeps, iterations, error, reason, substeps, substeps, surface=surface)


def _xpbd(
    settings: Settings,
    topology: Topology,
    materials: Collection[tuple[Sequence[float], float]],
    limit: float,
    around: Surroundings,
) -> Choice:
    """Choose XPBD, with bounds of its substeps; limit: substeps that leapfrog needs without dashpots."""
    iterations, rate = settings.iterations or 1, _bending_rate(topology, materials)
    price = iterations * prices.xpbd(topology, materials, around) / around.speed
    fewest = _fewest(topology, around.coupled)
    finest = max(fewest, _finest(topology, settings, around))
    paid = int(np.clip(1e3 * settings.budget * around.share * settings.frame_dt / price, fewest, finest))
    # With fewer sweeps of second order, the residual of a mesh's stiff springs shakes it.
    smooth = limit / (_MOST_STIFF * iterations) if _is_mesh(topology) and topology.coupling is None else 0.0
    order = settings.order or (1 if paid < smooth else 2)
    smooth = smooth if order == 2 else 0.0
    stiff = _effective(settings, order) / settings.frame_dt * limit
    steady = _steady(topology, stiff) / iterations
    corrected = max(_corrected(settings, order, materials, around), steady)
    static = min(_static(settings.error, topology, materials, stiff, around) / iterations, corrected)
    most = max(paid, min(math.ceil(steady), _MOST))
    bending = _effective(settings, order) * math.sqrt(rate / _BENDING)
    needed = math.ceil(max(fewest, bending, static))
    least = min(needed, most)
    first = _START * math.sqrt(1e-2 / settings.error) * settings.frame_dt / _FRAME
    substeps = int(np.clip(math.ceil(first), least, most))
    reason = f"is computed by xpbd order {order}"
    if settings.substeps:
        substeps = least = most = fewest = settings.substeps
        reason += f" in {substeps} x {iterations}"
    else:
        bounds = f"{least} to {most} substeps, as its measured error asks" if least < most else f"{most} substeps"
        reason += f" in {bounds}"
        if least == most <= paid:
            reason += ", the most that it may take"
        if most > paid:
            reason += f"; the budget pays {paid}, with which its frames would gain energy"
    if least < static:
        reason += f"; it would take {math.ceil(static)} substeps to be as stiff as it is set"
    share = limits.bending_share(rate, _effective(settings, order) / substeps)
    if share < 1.0:
        reason += f"; {share:.2g} of its bending rigidity acts"
    test = prices.test(around) / around.speed / price
    if test > 0.0:
        loose = min(_static(max(settings.error, _LOOSE), topology, materials, stiff, around) / iterations, corrected)
        fewest = min(least, math.ceil(max(fewest, smooth, bending, loose if topology.coupling is None else steady)))
    else:
        fewest = least
    return Choice(
        "xpbd", order, substeps, iterations, settings.error, reason, least, most, 1, share, around.surface, test, fewest
    )


def _corrected(
    settings: Settings, order: int, materials: Collection[tuple[Sequence[float], float]], around: Surroundings
) -> float:
    """Substeps from which the defect correction of lines/solve.py gives a sheet at rest all of its stiffness."""
    damping = min(damping for _, damping in materials)
    if order == 1 or around.sewn or damping == 0.0:
        return math.inf
    return DAMPED * _effective(settings, order) / damping


def _static(
    error: float,
    topology: Topology,
    materials: Collection[tuple[Sequence[float], float]],
    limit: float,
    around: Surroundings,
) -> float:
    """Substeps with which the static strain of a sheet is right for this wanted error.

    limit: substeps of leapfrog times the effective step.

    The lines of a grid meet at angles, and each undoes a little of the others. Those of a mesh have kinks: the solve of
    each straightens them, until others bend them back. The excess of the strain is _LOST (limit / substeps)^2 in a
    mesh, and about 0.1 (limit / (4 substeps))^1.35 in a grid. At most _EXCESS times the error is allowed. Strains
    below _SEEN count less, as nobody sees them.
    """
    if xpbd_is_direct(topology) or not math.isfinite(limit):
        return 0.0
    excess = min(1.0, _EXCESS * error)
    if topology.coupling is not None:
        return _steady(topology, limit) / math.sqrt(excess)
    strain = 0.5 * around.gravity * topology.masses.sum() * max(compliance[0] for compliance, _ in materials)
    seen = min(1.0, strain / _SEEN)
    if _is_mesh(topology):
        return math.sqrt(_LOST / excess * seen) * limit
    return 0.25 * (0.1 / excess * seen) ** (1.0 / 1.35) * limit


def _steady(topology: Topology, limit: float) -> float:
    """Substeps, likewise, with which a membrane's excess of strain is as large as the strain.

    With fewer, nearly every frame gains energy and is computed again, which costs more.
    """
    return _COUPLED * math.sqrt(_LOST) * limit if topology.coupling is not None and math.isfinite(limit) else 0.0


def _fewest(topology: Topology, coupled: bool) -> int:
    """Minimum substeps to choose; `coupled`: True with self or object contact."""
    if xpbd_is_direct(topology):
        return _FEWEST_COILS if coupled else FEWEST
    side = math.sqrt(len(topology.masses)) / (_SIDE_LAYERS if coupled else _SIDE)
    return max(_FEWEST_LAYERS if coupled else FEWEST, math.ceil(side))


def _finest(topology: Topology, settings: Settings, around: Surroundings) -> int:
    """Maximum substeps to choose. In shorter ones contact of a rope is softer than its segments, and gains energy.

    Fine ropes need shorter ones, as theirs shakes else.
    """
    if not xpbd_is_direct(topology) or not around.colliders:
        return _MOST
    segment = float(np.median(topology.springs["structural"].rest))
    return min(_MOST, int(settings.frame_dt / SHORT * max(1.0, _FINE / segment)))


def _effective(settings: Settings, order: int) -> float:
    """Effective length h_e of a substep times the number of substeps [s]."""
    return settings.frame_dt * limits.EFFECTIVE[order]


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
