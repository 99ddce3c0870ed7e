"""The trials of the hard cases: what starts how, what is done to it, and what must hold."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from cloth_sim_ros.sim import Box, Capsule, Plane, Scene, Simulation, Sphere, Wind
from cloth_sim_ros.study.hard.bodies import BODY, SEGMENTS, inverse_mass, is_rope, make_body

SEPARATION = 3.0  # [m/s] at which the solver lets overlaps come apart; nothing may leave a resting collider faster
WHIP = 4.0  # times the speed at which a body is struck: what the exact motion of springs reaches at free ends
SETTLED = 4.0  # [1/s] of drag, of the 6.3 that a pendulum of 1 m takes to be critically damped
LYING = math.sqrt(0.5)
SHAPES: dict[str, Callable[..., Any]] = {
    "plane": lambda **place: Plane(**place),
    "sphere": lambda **place: Sphere(radius=0.15, **place),
    "capsule": lambda **place: Capsule(radius=0.05, half_length=0.3, orientation=(LYING, 0, 0, LYING), **place),
    "box": lambda **place: Box(half_extents=(0.3, 0.3, 0.002), **place),
}
TOP = {"plane": 0.0, "sphere": 0.15, "capsule": 0.05, "box": 0.002}  # [m] above the middle


def _nothing(sim: Simulation, frame: int = 0) -> None:
    pass


def _fine(sim: Simulation) -> str:
    return ""


@dataclass(frozen=True)
class Trial:
    """One run: `begin` once, then `drive` before every frame; and what it promises besides being finite.

    conserves: nothing outside does work but gravity and a collider that moves with `velocity`(frame) [m/s], so that
    energy never grows beyond that and the share `slack`; rest: strain at the end; fastest [m/s]: of any particle; jump
    [m]: of pins between frames, which takes particles along within a substep; outside: no particle ends a frame deeper
    than a tenth of a millimetre in a collider; finally_: "" or what went wrong.
    """

    scene: Scene
    frames: int = 120
    frame_dt: float = 1 / 60
    begin: Callable[[Simulation], None] = _nothing
    drive: Callable[[Simulation, int], None] = _nothing
    conserves: bool = False
    slack: float = 0.01
    velocity: Callable[[int], float] | None = None
    rest: float = math.inf
    fastest: float = math.inf
    jump: float = 0.0
    outside: bool = False
    finally_: Callable[[Simulation], str] = _fine


Options = dict[str, Any]


def _place(sim: Simulation, move: Callable[[np.ndarray], np.ndarray]) -> None:
    """Free particles go where `move` says; pinned ones stay."""
    rest = sim.rest_positions(BODY).astype(np.float64)
    x = move(rest.copy())
    held = inverse_mass(sim) == 0.0
    x[held] = rest[held]
    sim.set_positions(BODY, x)


STARTS: dict[str, Callable[[np.ndarray, np.random.Generator], np.ndarray]] = {
    "random": lambda x, random: random.uniform(-0.5, 0.5, x.shape),
    "stretched": lambda x, random: 10.0 * x,
    "collapsed": lambda x, random: 1e-6 * random.standard_normal(x.shape),
    "point": lambda x, random: np.zeros_like(x),
    "mirrored": lambda x, random: x * [-1.0, 1.0, 1.0],
}


def bad_start(kind: str, options: Options, random: np.random.Generator) -> Trial:
    """Damped as a rope or cloth is, with a load near critically as a pendulum, so that it can be at rest two seconds
    later: a load that is flung about jerks its rope."""
    ratio = options.get("ratio", 0.0)
    compliance = _by_load(ratio, 2e-3) if ratio else float(random.choice([0.0, 1e-6, 1e-5, 1e-4]))
    body = make_body(kind, compliance, ratio, damping=float(random.choice([2e-3, 1e-2])))
    start = STARTS[options["start"]]
    scene = Scene({BODY: body})

    def begin(sim: Simulation) -> None:
        sim.set("solver.global_damping", SETTLED if ratio else 2.0)
        _place(sim, lambda x: start(x, random))

    return Trial(scene, begin=begin, conserves=True, rest=0.02)


def _by_load(ratio: float, strain: float) -> float:
    """The compliance [m/N] at which a hanging load of `ratio` times the rope strains its springs by `strain`."""
    return strain / SEGMENTS / (0.2 * (1.0 + ratio) * 9.81)


def end_load(kind: str, options: Options, random: np.random.Generator) -> Trial:
    """Let go from the side: the pull is up to three weights, and twice that where it comes as a wave."""
    scene = Scene({BODY: make_body(kind, _by_load(options["ratio"], 0.01), options["ratio"])})

    def strained(sim: Simulation) -> str:
        strain = sim.report()[BODY]["max_strain"]
        return f"strain {strain:.3g} under a load that strains by 0.01" if strain > 0.07 else ""

    return Trial(scene, conserves=True, finally_=strained)


def degenerate(kind: str, options: Options, random: np.random.Generator) -> Trial:
    """A third of the particles lie exactly on their neighbours: springs of no length, triangles of no area."""

    def begin(sim: Simulation) -> None:
        def onto(x: np.ndarray) -> np.ndarray:
            some = random.choice(len(x) - 1, len(x) // 3, replace=False)
            x[some] = x[some + 1]
            return x

        sim.set("solver.global_damping", 2.0)
        _place(sim, onto)

    return Trial(Scene({BODY: make_body(kind, 1e-5, damping=5e-3)}), begin=begin, conserves=True, rest=0.02)


def compliance(kind: str, options: Options, random: np.random.Generator) -> Trial:
    """From rigid to a thousandth of a newton per metre, falling into its pins, the residual reported."""

    def residual(sim: Simulation) -> str:
        found = sim.report()[BODY]["residual"]
        return "" if math.isfinite(found) else "no residual is reported"

    scene = Scene({BODY: make_body(kind, options["compliance"])})
    return Trial(scene, frames=60, conserves=True, finally_=residual)


def long_step(kind: str, options: Options, random: np.random.Generator) -> Trial:
    """A frame of a tenth of a second in few substeps, undamped, let go a hundredth of a millimetre from rest."""
    body = make_body(kind, float(random.choice([0.0, 1e-6, 1e-3, 1e-2])))

    def begin(sim: Simulation) -> None:
        _place(sim, lambda x: x + 1e-5 * random.standard_normal(x.shape))

    return Trial(Scene({BODY: body}), frames=60, frame_dt=0.1, begin=begin, conserves=True)


def fast_collider(kind: str, options: Options, random: np.random.Generator) -> Trial:
    """Straight up through a free body within a few frames, then it stands still.

    It gives its speed times the momentum of the body, and nothing is launched. In few substeps contact stretches
    springs before they can pull, and what they then give back came to 6 % more than that once: a tenth is allowed.
    """
    shape, speed, radius = options["shape"], options["speed"], 0.005
    middle = 0.0 if is_rope(kind) else 0.05  # where a particle is
    collider = SHAPES[shape](position=(middle, middle, -0.2 - TOP[shape]))
    body = make_body(kind, pins="none", thickness=radius, damping=5e-3)
    scene = Scene({BODY: body}, {"it": collider}, gravity=(0, 0, 0))
    path, strokes = speed / 60.0, 3 if speed < 10.0 else 2
    left = [False]

    def drive(sim: Simulation, frame: int) -> None:
        z = collider.position[2] + path * min(frame + 1, strokes)
        if frame < strokes:
            sim.set_collider_pose("it", (middle, middle, z), collider.orientation)
        elif frame == strokes:  # later it may rightly slide off
            way = np.linalg.norm(sim.rest_positions(BODY) - [middle, middle, 0.0], axis=1) < 0.02
            left[0] = sim.positions(BODY)[way, 2].min() < z

    def velocity(frame: int) -> float:
        return speed if frame < strokes else 0.0

    def ahead(sim: Simulation) -> str:
        return "the particle in its way was left behind" if left[0] else ""

    promises = {"conserves": True, "slack": 0.1, "velocity": velocity, "outside": True, "finally_": ahead}
    return Trial(scene, frames=8, drive=drive, fastest=WHIP * speed, **promises)


def teleport(kind: str, options: Options, random: np.random.Generator) -> Trial:
    """A collider placed into the body, past it, or taken away from below it: placed, not moved, it has no speed."""
    shape, where = options["shape"], options["where"]
    height = {"into": -0.3 * TOP[shape], "through": 0.05 if shape == "plane" else 0.5, "away": -0.01 - TOP[shape]}[
        where
    ]
    start = (0.0, 0.0, height if where == "away" else -1.0)
    scene = Scene({BODY: make_body(kind, pins="both", damping=2e-3)}, {"it": SHAPES[shape](position=start)})
    orientation = scene.colliders["it"].orientation

    def drive(sim: Simulation, frame: int) -> None:
        if frame == 10:
            goal = (0.0, 0.0, -5.0) if where == "away" else (0.0, 0.0, height)
            sim.set_collider_pose("it", goal, orientation, sweep=False)

    # A plane above it leaves the body below: it has to come out, and does so at the speed of separation.
    finally_ = _fine if where == "through" and shape == "plane" else out
    return Trial(scene, frames=60, drive=drive, fastest=WHIP * SEPARATION, finally_=finally_)


def out(sim: Simulation) -> str:
    """No particle is left in or behind a collider."""
    depth = sim.report()[BODY]["max_penetration"]
    return f"still {depth:.3g} m deep" if depth > 1e-4 else ""


def squeeze(kind: str, options: Options, random: np.random.Generator) -> Trial:
    """Two faces close on the body until half of what it needs is left between them, hold and open again."""
    shape, radius = options["shape"], 0.01
    body = make_body(kind, pins="none", thickness=radius, damping=2e-3)
    above = SHAPES[shape](position=(0.0, 0.0, 0.1 + TOP[shape]))
    if shape == "plane":
        above = Plane(normal=(0, 0, -1), point=(0.0, 0.0, 0.1))
    scene = Scene({BODY: body}, {"below": Plane(position=(0.0, 0.0, -0.02)), "above": above})
    closed, opened = -0.02 + radius + above.position[2] - 0.1, above.position[2]

    def drive(sim: Simulation, frame: int) -> None:
        share = np.clip(min(frame, 100 - frame) / 20.0, 0.0, 1.0)
        sim.set_collider_pose("above", (0.0, 0.0, opened + share * (closed - opened)), above.orientation)

    return Trial(scene, drive=drive, fastest=WHIP * SEPARATION, rest=0.02)


def _drag(sim: Simulation, goal: Callable[[np.ndarray], np.ndarray]) -> None:
    """Pinned particles go to `goal` of their rest positions; all others stay where they are, with their velocities."""
    held, x, v = inverse_mass(sim) == 0.0, sim.positions(BODY).astype(np.float64), sim.velocities(BODY)
    x[held] = goal(sim.rest_positions(BODY)[held].astype(np.float64))
    sim.set_positions(BODY, x)
    sim.set_velocities(BODY, v)


def _drag_on(sim: Simulation) -> None:
    sim.set("solver.global_damping", 2.0)


def pulled_pins(kind: str, options: Options, random: np.random.Generator) -> Trial:
    """Both sides are pulled apart to twice their distance within half a second, held, and brought back."""
    body = make_body(kind, float(random.choice([0.0, 1e-6, 1e-4])), pins="both", damping=2e-3)
    jump = 0.5 / 30.0

    def drive(sim: Simulation, frame: int) -> None:
        share = float(np.clip(min(frame, 90 - frame) / 30.0, 0.0, 1.0))
        _drag(sim, lambda x: x * [1.0 + share, 1.0, 1.0])

    return Trial(Scene({BODY: body}), frames=210, drive=drive, begin=_drag_on, jump=jump, rest=0.02)


def pins_in_conflict(kind: str, options: Options, random: np.random.Generator) -> Trial:
    """Every frame the pins of a rigid or stiff body jump to other places that its springs cannot meet."""
    body = make_body(kind, options["compliance"], pins="both", damping=2e-3)

    def drive(sim: Simulation, frame: int) -> None:
        jump = 0.05 if frame < 60 else 0.0
        _drag(sim, lambda x: x + jump * random.uniform(-1.0, 1.0, x.shape))

    return Trial(Scene({BODY: body}), frames=180, drive=drive, begin=_drag_on, jump=0.1 * math.sqrt(3.0), rest=0.02)


def sharp_edge(kind: str, options: Options, random: np.random.Generator) -> Trial:
    """Dragged over the edge of a box that is five times finer than the springs are long."""
    half, radius, spacing = np.array([0.2, 0.6, 0.2]), 0.02 if not is_rope(kind) else 0.4 / SEGMENTS, 0.1
    body = make_body(kind, pins="none", thickness=radius, edge_contact=True, position=(0.25, 0.0, 0.2 + 1.1 * radius))
    scene = Scene({BODY: body}, {"it": Box(half_extents=tuple(half))})
    deepest = [0.0]

    def drive(sim: Simulation, frame: int) -> None:
        middle = np.array([-0.1 * (1.0 - math.cos(math.pi * frame / 20.0)), 0.0, 0.0])
        sim.set_collider_pose("it", middle)
        if frame:
            deepest[0] = max(deepest[0], _depth(sim, sim_middle[0], half, radius))
        sim_middle[0] = middle

    sim_middle = [np.zeros(3)]

    def shallow(sim: Simulation) -> str:
        return f"the edge lies {deepest[0]:.3g} m deep" if deepest[0] > 0.1 * spacing else ""

    return Trial(scene, frames=60, drive=drive, outside=True, finally_=shallow)


def _depth(sim: Simulation, middle: np.ndarray, half: np.ndarray, radius: float) -> float:
    x, t = sim.positions(BODY) - middle, np.linspace(0.0, 1.0, 21)[:, None, None]
    kinds = sim.springs(BODY)
    pairs = np.concatenate([kind[0] for name, kind in kinds.items() if name != "bending"])
    q = np.abs(x[pairs[:, 0]] * (1.0 - t) + x[pairs[:, 1]] * t) - half
    return radius - float((np.linalg.norm(np.maximum(q, 0.0), axis=-1) + np.minimum(q.max(-1), 0.0)).min())


def gusts(kind: str, options: Options, random: np.random.Generator) -> Trial:
    """100 m/s that turns around every frame; lift across it and springs that snap back may add their share."""
    direction = random.standard_normal(3)
    direction /= np.linalg.norm(direction)
    scene = Scene({BODY: make_body(kind, pins=options["pins"], damping=1e-3)}, wind=Wind((0, 0, 0)))

    def drive(sim: Simulation, frame: int) -> None:
        sim.set_wind(tuple((-1.0) ** frame * 100.0 * direction))

    return Trial(scene, frames=60, drive=drive, fastest=200.0)


def centre(kind: str, options: Options, random: np.random.Generator) -> Trial:
    """A particle exactly where the nearest surface has no direction: middle of a ball, axis of a capsule, box."""
    middle = (0.05, 0.05, 0.0) if not is_rope(kind) else (0.0, 0.0, 0.0)
    shape = {
        "sphere": Sphere(radius=0.04, position=middle),
        "capsule": Capsule(radius=0.03, half_length=0.05, position=middle),
        "box": Box(half_extents=(0.03, 0.03, 0.03), position=middle),
    }[options["shape"]]
    scene = Scene({BODY: make_body(kind, pins="both", damping=2e-3, compliance=1e-3)}, {"it": shape})

    return Trial(scene, frames=60, fastest=WHIP * SEPARATION, finally_=out)


def same_bits(kind: str, options: Options, random: np.random.Generator) -> Trial:
    """Dropped over a ball: again after a reset, and again by another simulation, to the bit."""
    middle = (0.05, 0.02, -0.2)
    scene = Scene({BODY: make_body(kind, pins="none", damping=2e-3)}, {"it": Sphere(radius=0.15, position=middle)})

    def again(sim: Simulation) -> str:
        found = []
        for each in (sim, sim, Simulation(sim.scene, sim.settings, sim.device)):
            each.reset()
            each.step(40)
            found.append(np.concatenate([each.positions(BODY), each.velocities(BODY)]))
        same = all(np.array_equal(found[0], other) for other in found[1:])
        return "" if same else "the same again gave other bits"

    return Trial(scene, frames=40, finally_=again)


def gone_bad(kind: str, options: Options, random: np.random.Generator) -> Trial:
    """One of three bodies gets a value that is not finite: it alone is put back; the others stay as without, to the
    bit."""
    body = make_body(kind, pins="hung", damping=2e-3)
    names = ("first", BODY, "last")
    scene = Scene({name: body for name in names})
    bad, victim = options["value"], int(random.integers(2, 10))

    def alone(sim: Simulation) -> str:
        runs = [Simulation(scene, sim.settings, sim.device) for _ in range(2)]
        for run in runs:
            run.step(10)
        good = runs[0].positions(BODY)
        arrays, span, _ = runs[0].device_arrays(BODY)
        rows = arrays.state.velocities[span].numpy()
        rows[np.flatnonzero(inverse_mass(runs[0]))[victim], 1] = bad
        arrays.state.velocities[span].assign(rows)
        for run in runs:
            run.step()
        report = runs[0].report()
        if not np.array_equal(runs[0].positions(BODY), good) or report[BODY]["recoveries"] != 1:
            return f"not put back: {report[BODY]['recoveries']} recoveries"
        runs[0].step(5), runs[1].step(5)
        same = all(np.array_equal(runs[0].positions(name), runs[1].positions(name)) for name in ("first", "last"))
        return "" if same and np.isfinite(runs[0].positions(BODY)).all() else "its neighbours changed"

    return Trial(Scene({BODY: body}), frames=1, finally_=alone)
