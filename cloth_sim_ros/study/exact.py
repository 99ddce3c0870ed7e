# SPDX-License-Identifier: Apache-2.0
"""The exact motion of a case, with a guard against chaos, cached on disk as it takes longer than the runs it judges."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cloth_sim_ros.study import motion, norms
from cloth_sim_ros.study.case import FRAME_DT, Case
from cloth_sim_ros.study.contact import obstacle, projected_leapfrog
from cloth_sim_ros.study.springs import SpringSystem

CONTACT_SUBSTEPS = 1000  # least of a frame for the coarser of two runs with contact


@dataclass(frozen=True)
class Reference:
    """A system, its exact frames (F + 1, N, 3) [m], and the number of leading frames that chaos leaves usable."""

    system: SpringSystem
    frames: np.ndarray
    trusted: int


def reference(case: Case, resolution: int, constant: float) -> Reference:
    """Return the exact motion of a case: its closed form if known, else computed once and cached.

    Without contact it is exact to a thousandth of the case's tolerance. Contact is first order in the step: frames
    count until the run with half the step is a tenth of the tolerance away.
    """
    system, start = case.system(resolution, constant)
    if case.closed is not None:
        return Reference(system, case.closed(resolution, constant), case.frames + 1)
    path = _cache() / f"{case.name}-{resolution}-{_digest(system, start, case)}.npz"
    if path.exists():
        with np.load(path) as stored:
            return Reference(system, stored["frames"], int(stored["trusted"]))
    still, tolerance = np.zeros_like(start), 0.1 * case.tolerance
    step, substeps = motion.runge_kutta_4, motion.stable_substeps(system, FRAME_DT)
    if case.colliders:
        body = case.body(resolution, constant)
        step = projected_leapfrog(obstacle(collider, body) for collider in case.colliders.values())
        substeps = max(CONTACT_SUBSTEPS, substeps)
        frames = motion.frames_by(step, system, start, still, FRAME_DT, case.frames, 2 * substeps)[0]
        coarse = motion.frames_by(step, system, start, still, FRAME_DT, case.frames, substeps)[0]
        known = norms.leading_frames(frames, coarse, tolerance)
    else:
        frames = coarse = motion.exact_frames(system, start, still, FRAME_DT, case.frames, tolerance)[0]
        known = len(frames)
    beside = start + np.where(system.fixed[:, None], 0.0, norms.perturbation(start.shape))
    perturbed = motion.frames_by(step, system, beside, still, FRAME_DT, case.frames, substeps)[0]
    trusted = min(known, norms.trusted_frames(coarse, perturbed, tolerance))
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(path, frames=frames, trusted=trusted)
    return Reference(system, frames, trusted)


def _cache() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "cloth_sim_ros" / "references"


def _digest(system: SpringSystem, start: np.ndarray, case: Case) -> str:
    """Return a name that changes with anything that the motion depends on."""
    numbers = (system.masses, system.fixed, system.pairs, system.rest_length, system.constant, start)
    scalars = (
        system.damping,
        system.global_damping,
        *system.gravity,
        case.frames,
        case.tolerance,
        repr(case.colliders),
    )
    if system.bending is not None:
        numbers += (system.bending.toarray(),)
    digest = hashlib.sha256(repr(scalars).encode())
    for array in numbers:
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:16]
