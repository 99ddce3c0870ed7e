# SPDX-License-Identifier: Apache-2.0
"""The float64 minimum of the energy of a SpringSystem near a state, for tests of what is at rest."""

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from cloth_sim_ros.study.springs import SpringSystem


def system_of(sim, name="it"):
    """The springs that a simulation reports, and its pins."""
    arrays, span, _ = sim.device_arrays(name)
    pinned = np.flatnonzero(arrays.state.positions[span].numpy()[:, 3] == 0.0)
    return SpringSystem.from_springs(sim.masses(name), pinned, sim.springs(name))


def minimum(system, x, tolerance=1e-7):
    """Positions (N, 3) of the minimum downhill from x, where no force is above `tolerance` of all weight.

    Newton's method with a shift of the Hessian that grows where a step would not lower the energy (Levenberg 1944).
    """
    free = np.flatnonzero(np.repeat(~system.fixed, 3))
    least = tolerance * system.masses.sum() * np.linalg.norm(system.gravity)
    still, shift = np.zeros_like(x), 1e-3 * system.constant.max()
    energy = sum(system.energy(x, still))
    for _ in range(400):
        force = system.forces(x, still).ravel()[free]
        if np.abs(force).max() < least:
            return x
        tension = system.constant * (system.lengths(x)[0] - system.rest_length)
        hessian = system.stiffness(x, tension, system.constant, clamped=False)[free][:, free]
        step = np.zeros(x.size)
        step[free] = splu((hessian + shift * sparse.eye_array(len(free))).tocsc()).solve(force)
        trial = x + step.reshape(x.shape)
        lower = sum(system.energy(trial, still))
        if step[free] @ force > 0.0 and lower < energy + 1e-14 * abs(energy):
            x, energy, shift = trial, lower, shift / 3.0
        else:
            shift *= 4.0
    raise ArithmeticError(f"no minimum within {np.abs(force).max():g} N")
