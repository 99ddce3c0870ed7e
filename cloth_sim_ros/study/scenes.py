# SPDX-License-Identifier: Apache-2.0
"""`scenes`: what a frame of real scenes costs by the defaults and by set numbers, and how right it is.

The error is the RMS distance of all particles at all frames of half a second from XPBD of second order at many
substeps. The settings of a scene take turns, so that whatever else the machine does falls on all alike. Peers that are
installed have rows of the bare sheet.

`hands` is a towel of cotton of 0.5 m that two hands hold. `towel` falls on a ball and the floor, and `table` lies on a
table. `denim`, `silk` and `terry` fall as `towel` does, and `apart` is kept apart from itself. `tube` is a mesh of
jersey that hangs over a ball. `cable` is a steel cable of 1 m between two hands, in twice as many segments.

`bare` is a level sheet held at two corners, `clamped` by its whole edge. `curtain` has a ball, wind, dashpots and
bending springs. `wind` is a curtain in nothing but wind, `ball` one with a ball too, `finger` one with a ball of 3 cm
that facets have to keep out. `cotton` is `ball` of cotton. `plate` is a curtain in wind that bends as a plate of
1e-4 N m. `mesh` is irregular and hangs by two corners, `mesh ball` has ball and wind too. `fold` is a towel that falls
on its edge and is kept apart from itself, `fold through` the same without.

--halves has a row for each of the scenes that people have, at the defaults: both half seconds of its first second,
with the error that the simulation measures (halves.py).

--features adds what each feature of a scene costs, on a hung sheet with all springs, in turns.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Callable

import numpy as np
from scipy.spatial import Delaunay

from cloth_sim_ros.sim import Cloth, Handle, Plane, Rope, Scene, Settings, Simulation, Sphere, Wind
from cloth_sim_ros.study import feature_costs, halves
from cloth_sim_ros.study.case import BODY, Case
from cloth_sim_ros.study.contenders import Run
from cloth_sim_ros.study.norms import rms
from cloth_sim_ros.study.peers import PEERS
from cloth_sim_ros.study.timing import frame_time, machine, spread

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
FINGER = {"finger": Sphere(radius=0.03, position=(0.0, -0.05, -0.2))}
BALL = {"ball": Sphere(radius=0.2, position=(0.0, -0.6, -0.2))}


def bare(resolution: int, constant: float = 1e3) -> Cloth:
    """A level sheet of 1 m that is held at two corners."""
    pins = (resolution * (resolution - 1), resolution**2 - 1)
    springs = {"stretch_compliance": 1.0 / constant, "shear_compliance": 3.0 / constant}
    return Cloth(resolution=(resolution, resolution), pins=pins, **springs)


UPRIGHT = {"size": (1.2, 1.2), "thickness": 0.01, "pins": "top", "orientation": (np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5))}


def curtain(resolution: int, **more: object) -> Cloth:
    """A cloth of 1.2 m and 0.3 kg, unless `more` says so, that hangs by its upper edge."""
    return Cloth(resolution=(resolution, resolution), **{"mass": 0.3, **UPRIGHT, **more})


def mesh(resolution: int) -> Cloth:
    """An irregular mesh of resolution^2 vertices over 1.2 m x 1.2 m, upright, that hangs by its upper edge."""
    across = np.linspace(-0.6, 0.6, resolution)
    points = np.stack(np.meshgrid(across, across, indexing="ij"), axis=-1)
    inner = points[1:-1, 1:-1]
    inner += np.random.default_rng(5).uniform(-0.25, 0.25, inner.shape) * (across[1] - across[0])
    flat = points.reshape(-1, 2)
    vertices = np.insert(flat, 1, 0.0, axis=1)
    pins = tuple(np.flatnonzero(flat[:, 1] > 0.599))
    return Cloth.from_mesh(vertices, Delaunay(flat).simplices, mass=0.3, thickness=0.01, pins=pins)


def hand(x: float, y: float, z: float, reach: float = 0.02) -> Handle:
    """A hand that holds particles within its reach [m]."""
    return Handle(position=(x, y, z), reach=reach, attached=True)


def towel(resolution: int, height: float, material: str = "cotton", **more: object) -> Cloth:
    """A towel of 0.5 m that lies free at a height [m]."""
    fields = {"resolution": (resolution, resolution), "size": (0.5, 0.5), "position": (0, 0, height), **more}
    return Cloth.of(material, pins=None, **fields)


def falling(sheet: Cloth) -> Scene:
    """A sheet above a ball and the floor."""
    return Scene({BODY: sheet}, {"ball": Sphere(radius=0.12, position=(0, 0, 0.25)), "floor": Plane()})


def tube(around: int) -> Scene:
    """A tube of jersey, 0.6 m long, of `around` vertices a ring. Every sixth of its upper rim is held, over a ball."""
    along = around * 3 // 4
    turn, height = np.meshgrid(np.arange(around), np.linspace(0.6, 1.2, along), indexing="ij")
    angle = 2.0 * np.pi * turn / around
    vertices = np.stack([0.2 * np.cos(angle), 0.15 * np.sin(angle), height], axis=-1).reshape(-1, 3)
    number = np.arange(around * along).reshape(around, along)
    a, b = number, np.roll(number, -1, axis=0)
    corners = [a[:, :-1], b[:, :-1], b[:, 1:]], [a[:, :-1], b[:, 1:], a[:, 1:]]
    triangles = np.concatenate([np.stack(three, axis=-1).reshape(-1, 3) for three in corners])
    cloth = Cloth.from_mesh(vertices, triangles, material="jersey", pins=number[::6, -1].tolist())
    return Scene({BODY: cloth}, {"ball": Sphere(radius=0.1, position=(0, 0, 0.9))})


def fold(resolution: int, itself: bool) -> Scene:
    """A towel of cotton of 1 m that leans by 2 degrees on its edge 2 cm above the floor."""
    half = np.radians(44.0)
    upright = {"orientation": (np.sin(half), 0.0, 0.0, np.cos(half)), "position": (0.0, 0.0, 0.52)}
    sheet = Cloth.of("cotton", resolution=(resolution,) * 2, pins=None, thickness=2e-3, self_contact=itself, **upright)
    return Scene({BODY: sheet}, {"floor": Plane()})


SCENES: dict[str, Callable[[int], Scene]] = {
    "hands": lambda n: Scene(
        {BODY: towel(n, 0.5)}, handles={"left": hand(-0.25, 0.25, 0.5), "right": hand(0.25, 0.25, 0.5)}
    ),
    "towel": lambda n: falling(towel(n, 0.5)),
    "denim": lambda n: falling(towel(n, 0.5, "denim")),
    "silk": lambda n: falling(towel(n, 0.5, "silk")),
    "terry": lambda n: falling(towel(n, 0.5, "towel")),
    "apart": lambda n: falling(towel(n, 0.5, self_contact=True)),
    "tube": tube,
    "table": lambda n: Scene({BODY: towel(n, 0.002)}, {"table": Plane()}),
    "cable": lambda n: Scene(
        {BODY: Rope.of("steel cable", segments=2 * n, start=(0, 0, 0), end=(1, 0, 0), pins=None)},
        handles={"left": hand(0, 0, 0, 0.03), "right": hand(1, 0, 0, 0.03)},
    ),
    "bare": lambda n: Scene({BODY: bare(n)}),
    "curtain": lambda n: Scene({BODY: curtain(n, damping=1e-3, bend_compliance=0.1)}, BALL, WIND),
    "ball": lambda n: Scene({BODY: curtain(n)}, BALL, WIND),
    "finger": lambda n: Scene({BODY: curtain(n)}, FINGER, WIND),
    "cotton": lambda n: Scene({BODY: Cloth.of("cotton", resolution=(n, n), **UPRIGHT)}, BALL, WIND),
    "clamped": lambda n: Scene({BODY: dataclasses.replace(bare(n), pins="edges")}),
    "mesh": lambda n: Scene({BODY: mesh(n)}),
    "mesh ball": lambda n: Scene({BODY: mesh(n)}, BALL, WIND),
    "fold": lambda n: fold(n, True),
    "fold through": lambda n: fold(n, False),
    "wind": lambda n: Scene({BODY: curtain(n)}, wind=WIND),
    "plate": lambda n: Scene({BODY: curtain(n, bending="dihedral", bend_compliance=1e4)}, wind=WIND),
}
STANDARD = ["hands", "towel", "table", "cable", "cotton"]
BARE = Case("bare", "sheet held at two corners", bare, FRAMES, 1e-3, 32, 1e3)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument("--device", default="cpu", help="cpu or cuda:0")
    parser.add_argument("--scene", choices=SCENES, nargs="+", default=STANDARD)
    parser.add_argument("--resolution", type=int, nargs="+", default=[32], help="particles a side")
    parser.add_argument("--settings", choices=SETTINGS, nargs="+", default=list(SETTINGS))
    parser.add_argument("--worlds", type=int, default=1, help="copies of the scene in the same launches")
    parser.add_argument("--halves", action="store_true", help="both half seconds of all real scenes, at the defaults")
    parser.add_argument("--features", action="store_true", help="also what each feature costs, at the last resolution")
    parser.add_argument("--rounds", type=int, default=5, help="turns that each of the settings takes")
    parser.add_argument("--reference", type=int, default=800, help="substeps of what a scene is judged by")


def run(arguments: argparse.Namespace) -> int:
    """Measure, and print the table last."""
    if arguments.halves:
        print(halves.table(SCENES, arguments.device, arguments.rounds))
        return 0
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
    if arguments.features:
        print(feature_costs.table(feature_costs.measure(arguments.resolution[-1], arguments.device, arguments.rounds)))
    return 0


def measure(name: str, resolution: int, arguments: argparse.Namespace) -> list[tuple[str, ...]]:
    """Return the rows of a scene: its settings, peers if it has them, and the uncertainty of its reference."""
    scene, device = SCENES[name](resolution), arguments.device
    fine, half = (
        frames_of(Simulation(scene, Settings(method="xpbd", order=2, substeps=substeps), device))
        for substeps in (arguments.reference, arguments.reference // 2)
    )
    sims = {
        label: Simulation(scene, Settings(**SETTINGS[label]), device, arguments.worlds) for label in arguments.settings
    }
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
    size = f"{name} {resolution} x {resolution}" + f", {arguments.worlds} worlds" * (arguments.worlds > 1)
    rows = [(size, label, chosen, spread(ms), f"{error:.1e}") for label, chosen, ms, error in found]
    return [
        *rows,
        (size, "reference", f"xpbd order 2, {arguments.reference} x 1", "", f"known to {rms(fine - half):.0e}"),
    ]


def frames_of(sim: Simulation) -> np.ndarray:
    """Return positions (FRAMES, N, 3) [m] after each frame from the start."""
    found = []
    for _ in range(FRAMES):
        sim.step()
        found.append(sim.positions(BODY))
    return np.array(found, dtype=np.float64)
