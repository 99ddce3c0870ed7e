# SPDX-License-Identifier: Apache-2.0
"""`scenes`: what a frame of real scenes costs by the defaults and by set numbers, and how right it is.

The error is the RMS distance of all particles at all frames of half a second from XPBD of second order at many
substeps. The settings of a scene take turns, so that whatever else the machine does falls on all alike. Peers that are
installed have rows of the bare sheet.

`bare` is a level sheet held at two corners. `curtain` has a ball, wind, dashpots and bending springs. `wind` is a
curtain in nothing but wind. `plate` is a curtain in wind that bends as a plate of 1e-4 N m.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence

import numpy as np

from cloth_sim_ros.sim import Cloth, Scene, Settings, Simulation, Sphere, Wind
from cloth_sim_ros.study.case import BODY, Case
from cloth_sim_ros.study.contenders import Run
from cloth_sim_ros.study.norms import rms
from cloth_sim_ros.study.peers import PEERS
from cloth_sim_ros.study.timing import frame_time, machine, quartiles

FRAMES = 30  # of 1/60 s
SETTINGS = {
    "defaults": {},
    "error 1e-2": {"error": 1e-2},
    "xpbd 10 x 1": {"method": "xpbd", "substeps": 10, "iterations": 1},
    "xpbd 20 x 1": {"method": "xpbd", "substeps": 20, "iterations": 1},
    "verlet": {"method": "verlet"},
}
PEER_STEPS = {"substeps": 20, "iterations": 1}
WIND = Wind(velocity=(0.0, 3.0, 0.0))
BALL = {"ball": Sphere(radius=0.2, position=(0.0, -0.6, -0.2))}


def bare(resolution: int, constant: float = 1e3) -> Cloth:
    """A level sheet of 1 m that is held at two corners."""
    pins = (resolution * (resolution - 1), resolution**2 - 1)
    springs = {"stretch_compliance": 1.0 / constant, "shear_compliance": 3.0 / constant}
    return Cloth(resolution=(resolution, resolution), pins=pins, **springs)


def curtain(resolution: int, **more: object) -> Cloth:
    """A cloth of 1.2 m that hangs by its upper edge."""
    upright = (np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5))
    shape = {"resolution": (resolution, resolution), "size": (1.2, 1.2), "mass": 0.3, "thickness": 0.01}
    return Cloth(**shape, pins="top", orientation=upright, **more)


SCENES: dict[str, Callable[[int], Scene]] = {
    "bare": lambda n: Scene({BODY: bare(n)}),
    "curtain": lambda n: Scene({BODY: curtain(n, damping=1e-3, bend_compliance=0.1)}, BALL, WIND),
    "wind": lambda n: Scene({BODY: curtain(n)}, wind=WIND),
    "plate": lambda n: Scene({BODY: curtain(n, bending="dihedral", bend_compliance=1e4)}, wind=WIND),
}
BARE = Case("bare", "sheet held at two corners", bare, FRAMES, 1e-3, 32, 1e3)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command."""
    parser.add_argument("--device", default="cpu", help="cpu or cuda:0")
    parser.add_argument("--scene", choices=SCENES, nargs="+", default=list(SCENES))
    parser.add_argument("--resolution", type=int, nargs="+", default=[32], help="particles a side")
    parser.add_argument("--rounds", type=int, default=5, help="turns that each of the settings takes")
    parser.add_argument("--reference", type=int, default=800, help="substeps of what a scene is judged by")


def run(arguments: argparse.Namespace) -> int:
    """Measure, and print the table last."""
    rows = []
    for name in arguments.scene:
        for resolution in arguments.resolution:
            print(f"measuring {name}, {resolution} x {resolution} ...", file=sys.stderr, flush=True)
            rows += measure(name, resolution, arguments)
    where = machine(arguments.device)
    print(f"{where['name']} ({where['device']}); medians of {arguments.rounds} rounds, and quartiles")
    print("\n| scene | settings | chosen | ms a frame | error [m] |\n|---|---|---|---|---|")
    for row in rows:
        print("| " + " | ".join(row) + " |")
    return 0


def measure(name: str, resolution: int, arguments: argparse.Namespace) -> list[tuple[str, ...]]:
    """The rows of a scene: its settings, peers where they have it, and how well its reference is known."""
    scene, device = SCENES[name](resolution), arguments.device
    fine, half = (
        frames_of(Simulation(scene, Settings(method="xpbd", order=2, substeps=substeps), device))
        for substeps in (arguments.reference, arguments.reference // 2)
    )
    sims = {label: Simulation(scene, Settings(**chosen), device) for label, chosen in SETTINGS.items()}
    errors = {label: rms(frames_of(sim) - fine) for label, sim in sims.items()}
    times = {label: [] for label in sims}
    for _ in range(arguments.rounds):
        for label, sim in sims.items():
            sim.reset()
            times[label].append(frame_time(sim, FRAMES))
    found = []
    for label, sim in sims.items():
        choice = sim.choices[BODY]
        found.append((label, f"{choice.words}, {choice.substeps} x {choice.iterations}", times[label], errors[label]))
    for peer in PEERS if name == "bare" else ():
        problem = peer.why_not(device)
        if problem:
            print(problem, file=sys.stderr)
            continue
        frames, each = peer.simulate(Run(BARE, resolution, BARE.constant, device, **PEER_STEPS))
        found.append((peer.label, "{substeps} x {iterations}".format(**PEER_STEPS), each, rms(frames[1:] - fine)))
    size = f"{name} {resolution} x {resolution}"
    rows = [(size, label, chosen, spread(ms), f"{error:.1e}") for label, chosen, ms, error in found]
    return [
        *rows,
        (size, "reference", f"xpbd order 2, {arguments.reference} x 1", "", f"known to {rms(fine - half):.0e}"),
    ]


def frames_of(sim: Simulation) -> np.ndarray:
    """Positions (FRAMES, N, 3) [m] after each frame from the start."""
    found = []
    for _ in range(FRAMES):
        sim.step()
        found.append(sim.positions(BODY))
    return np.array(found, dtype=np.float64)


def spread(times: Sequence[float]) -> str:
    """Median and quartiles [ms] in a few characters."""
    numbers = quartiles(times)
    return f"{numbers['median']:.3g} ({numbers['low']:.3g}-{numbers['high']:.3g})"
