"""The exact motion of a case, with the guard against chaos, kept on disk since it takes longer than what it judges."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cloth_sim_ros.study import motion, norms
from cloth_sim_ros.study.cases import FRAME_DT, Case
from cloth_sim_ros.study.springs import SpringSystem


@dataclass(frozen=True)
class Reference:
    """The system, its exact frames (F + 1, N, 3) [m], and how many leading ones chaos leaves to judge by."""

    system: SpringSystem
    frames: np.ndarray
    trusted: int


def reference(case: Case, resolution: int, constant: float) -> Reference:
    """The exact motion of a case to a hundredth of a tenth of its tolerance; computed once, then read from the
    cache."""
    system, start = case.system(resolution, constant)
    tolerance = 0.1 * case.tolerance
    path = _cache() / f"{case.name}-{resolution}-{_digest(system, start, case.frames, tolerance)}.npz"
    if path.exists():
        with np.load(path) as stored:
            return Reference(system, stored["frames"], int(stored["trusted"]))
    still = np.zeros_like(start)
    frames = motion.exact_frames(system, start, still, FRAME_DT, case.frames, tolerance)[0]
    beside = start + np.where(system.fixed[:, None], 0.0, norms.perturbation(start.shape))
    substeps = motion.stable_substeps(system, FRAME_DT)
    perturbed = motion.frames_by(motion.runge_kutta_4, system, beside, still, FRAME_DT, case.frames, substeps)[0]
    trusted = norms.trusted_frames(frames, perturbed, tolerance)
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(path, frames=frames, trusted=trusted)
    return Reference(system, frames, trusted)


def _cache() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "cloth_sim_ros" / "references"


def _digest(system: SpringSystem, start: np.ndarray, frames: int, tolerance: float) -> str:
    """A name that changes with anything that the motion depends on."""
    numbers = (system.masses, system.fixed, system.pairs, system.rest_length, system.constant, start)
    scalars = (system.damping, system.global_damping, *system.gravity, frames, tolerance)
    digest = hashlib.sha256(repr(scalars).encode())
    for array in numbers:
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:16]
