# SPDX-License-Identifier: Apache-2.0
"""Excess elongation of a hung sheet by XPBD over equilibrium, by substeps, iterations and resolution."""

from __future__ import annotations

import argparse
import sys

import numpy as np
from scipy import optimize

from cloth_sim_ros.sim import Cloth, Scene, Settings, Simulation
from cloth_sim_ros.study.case import BODY, Case
from cloth_sim_ros.study.contenders import Run
from cloth_sim_ros.study.peers import PEERS

_REST = {"global_damping": 2.0}  # [1/s] by which it comes to rest
_APART = 1e3  # as many times as in equilibrium: then it has flown apart
_RESOLUTIONS, _CONSTANT, _SECONDS = (16, 32, 64), 1000.0, 5.0  # particles a side, [N/m], until it is at rest
_FINE = {"substeps": 80, "iterations": 4, "order": 1}  # from where the minimum of the energy is looked for


def run(arguments: argparse.Namespace) -> int:
    """Print a row for each resolution, by the arguments of `error`; return the exit status."""
    pairs = [(s, i) for s in arguments.substeps for i in arguments.iterations if s * i <= arguments.sweeps]
    print(f"{'mean strain over that of the equilibrium':<16}" + "".join(f"{f'{s} x {i}':>10}" for s, i in pairs))
    constant, seconds = arguments.constant or _CONSTANT, arguments.seconds or _SECONDS
    for resolution in [arguments.resolution] if arguments.resolution else _RESOLUTIONS:
        scene = Scene({BODY: hung_sheet(resolution, constant)})
        exact = equilibrium(*_at_rest(scene, _FINE, seconds, arguments.device))
        wanted = mean_strain(exact[0], exact[1])
        found = []
        for substeps, iterations in pairs:
            sim, x = _at_rest(
                scene, {"substeps": substeps, "iterations": iterations, "order": 1}, seconds, arguments.device
            )
            found.append(mean_strain(sim, x) / wanted - 1.0)
        _print_row(f"{resolution} x {resolution}", found)
        for peer in PEERS if arguments.peers else ():
            problem = peer.why_not(arguments.device)
            if problem:
                print(problem, file=sys.stderr)
                continue
            case = Case("hung", "hung by two corners", hung_sheet, round(60 * seconds), 1e-3, 32, 1e3)
            runs = [Run(case, resolution, constant, arguments.device, *pair) for pair in pairs]
            strains = [_lasting_strain(exact[0], peer.simulate(run)[0]) for run in runs]
            _print_row(f"{resolution} x {resolution}, {peer.label}", [strain / wanted - 1.0 for strain in strains])
    return 0


def _print_row(label: str, shares: list[float]) -> None:
    words = (f"{share:+.1%}" if share < _APART else "diverges" for share in shares)
    print(f"{label:<40}" + "".join(f"{word:>10}" for word in words), flush=True)


def _lasting_strain(sim: Simulation, frames: np.ndarray) -> float:
    """Return the mean strain [-] over the last quarter of frames (F, N, 3) [m], as a peer may still swing then."""
    return float(np.mean([mean_strain(sim, x) for x in frames[-len(frames) // 4 :]]))


def hung_sheet(resolution: int, constant: float) -> Cloth:
    """A square sheet of 1 m and 0.2 kg that hangs by its two upper corners."""
    return Cloth(
        resolution=(resolution, resolution),
        pins=(resolution * (resolution - 1), resolution**2 - 1),
        orientation=(np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)),
        stretch_compliance=1.0 / constant,
        shear_compliance=3.0 / constant,
    )


def _at_rest(scene: Scene, settings: dict, seconds: float, device: str) -> tuple[Simulation, np.ndarray]:
    sim = Simulation(scene, Settings(method="xpbd", **settings, **_REST), device=device)
    sim.step(round(60 * seconds))
    return sim, sim.positions(BODY).astype(np.float64)


def mean_strain(sim: Simulation, x: np.ndarray) -> float:
    """Return the mean strain [-] of the structural springs at positions x (N, 3) [m]."""
    pairs, rest, _ = sim.springs(BODY)["structural"]
    return float((np.linalg.norm(x[pairs[:, 1]] - x[pairs[:, 0]], axis=1) / rest - 1.0).mean())


def equilibrium(sim: Simulation, start: np.ndarray) -> tuple[Simulation, np.ndarray]:
    """Return `sim`, and the positions (N, 3) [m] near `start` of least energy of its springs and weight."""
    parts = list(sim.springs(BODY).values())
    pairs, rest, constant = (np.concatenate([part[k] for part in parts]) for k in range(3))
    masses, count = sim.masses(BODY), len(start)
    free = sim.device_arrays(BODY)[0].state.positions.numpy()[:count, 3] > 0.0

    def energy(moved: np.ndarray) -> tuple[float, np.ndarray]:
        x = start.copy()
        x[free] = moved.reshape(-1, 3)
        edge = x[pairs[:, 1]] - x[pairs[:, 0]]
        length = np.linalg.norm(edge, axis=1)
        pull = (constant * (length - rest) / length)[:, None] * edge
        gradient = np.stack([np.bincount(pairs[:, 1], p, count) - np.bincount(pairs[:, 0], p, count) for p in pull.T])
        gradient = gradient.T + masses[:, None] * [0.0, 0.0, 9.81]
        stored = 0.5 * (constant * (length - rest) ** 2).sum() + 9.81 * (masses * x[:, 2]).sum()
        return stored, gradient[free].ravel()

    options = {"maxiter": 6000, "maxfun": 8000, "ftol": 1e-16, "gtol": 1e-8, "maxcor": 50}
    found = optimize.minimize(energy, start[free].ravel(), jac=True, method="L-BFGS-B", options=options)
    x = start.copy()
    x[free] = found.x.reshape(-1, 3)
    return sim, x
