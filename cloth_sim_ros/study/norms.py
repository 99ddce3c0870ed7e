# SPDX-License-Identifier: Apache-2.0
"""Norms of the distance of a run from its reference, for every table and figure.

Runs are frames of positions (F, N, 3) [m] sampled at the same times, the start first.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cloth_sim_ros.study.springs import SpringSystem


@dataclass(frozen=True)
class Error:
    """position: RMS |x - x_ref| [m]; relative: that over RMS |x_ref - x_0|; strain_rms, strain_max: difference [-]."""

    position: float
    relative: float
    strain_rms: float
    strain_max: float


def rms(vectors: np.ndarray) -> float:
    """Return the root of the mean squared length of the vectors (..., 3)."""
    return float(np.sqrt((np.asarray(vectors, dtype=np.float64) ** 2).sum(axis=-1).mean()))


def error(system: SpringSystem, run: np.ndarray, reference: np.ndarray) -> Error:
    """Return the error of `run` over all particles and all frames after the start; inf after a blow-up."""
    if not np.isfinite(run).all():
        return Error(*[float("inf")] * 4)
    absolute = rms(run[1:] - reference[1:])
    moved = rms(reference[1:] - reference[0])
    strain = system.strains(np.asarray(run[1:], dtype=np.float64)) - system.strains(reference[1:])
    return Error(absolute, absolute / moved, float(np.sqrt((strain**2).mean())), float(np.abs(strain).max()))


def energy_drift(system: SpringSystem, positions: np.ndarray, velocities: np.ndarray) -> float:
    """Return the largest change of the total energy over the largest change of any one part of it.

    It is 0 for an exact undamped motion.
    """
    parts = np.array([system.energy(x, v) for x, v in zip(positions, velocities, strict=True)])
    exchanged = np.ptp(parts, axis=0).max()
    return float(np.abs(parts.sum(axis=1) - parts[0].sum()).max() / exchanged)


def trusted_frames(reference: np.ndarray, perturbed: np.ndarray, tolerance: float) -> int:
    """Return the number of leading frames over which chaos has not yet grown to a tenth of `tolerance` [m].

    `perturbed` is the reference started 1e-6 m beside; beyond these frames no run can be judged at that tolerance.
    """
    return leading_frames(reference, perturbed, 0.1 * tolerance)


def leading_frames(run: np.ndarray, other: np.ndarray, limit: float) -> int:
    """Return the number of leading frames in which two runs are at most `limit` [m] apart, RMS over particles."""
    beyond = np.flatnonzero(np.sqrt(((run - other) ** 2).sum(axis=-1).mean(axis=-1)) > limit)
    return int(beyond[0]) if len(beyond) else len(run)


def perturbation(shape: tuple[int, ...], size: float = 1e-6) -> np.ndarray:
    """Return random displacements of RMS length `size` [m] and the given shape (N, 3), the same in every run."""
    vectors = np.random.default_rng(7).standard_normal(shape)
    return size / rms(vectors) * vectors
