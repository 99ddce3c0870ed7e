# SPDX-License-Identifier: Apache-2.0
"""Cost of each feature of a scene: the same cloth with it and without it, taking turns in one run."""

from __future__ import annotations

import dataclasses

import numpy as np

from cloth_sim_ros.sim import Box, Capsule, Cloth, Plane, Scene, Settings, Simulation, Sphere, Wind
from cloth_sim_ros.study.timing import frame_time, quartiles

_FRAMES = 30  # in a turn
# Where a collider is: out of reach, or in the middle of the cloth.
AWAY, AMID = (0.0, 5.0, 0.0), (0.0, 0.05, 0.0)
_SHAPES = {
    "sphere": lambda position: Sphere(radius=0.2, position=position),
    "capsule": lambda position: Capsule(position=position),
    "box": lambda position: Box(position=position),
    "plane": lambda position: Plane(position=(0.0, 0.0, -5.0 if position == AWAY else -0.3)),
}


def variants(cloth: Cloth) -> dict[str, tuple[Scene, dict, str]]:
    """Return name -> (scene, settings, name of the variant to compare with); `cloth` has springs of all kinds."""
    plain = Scene({"cloth": cloth})
    bare = dataclasses.replace(cloth, shear_compliance=None, bend_compliance=None)
    found = {
        "all springs": (plain, {}, "all springs"),
        "threads alone": (Scene({"cloth": bare}), {}, "all springs"),
        "no bending": (Scene({"cloth": dataclasses.replace(cloth, bend_compliance=None)}), {}, "all springs"),
        "bending of a plate": (
            Scene({"cloth": dataclasses.replace(cloth, bending="dihedral", bend_compliance=1e3)}),
            {},
            "all springs",
        ),
        "damping": (Scene({"cloth": dataclasses.replace(cloth, damping=1e-4)}), {}, "all springs"),
        "wind": (Scene({"cloth": cloth}, wind=Wind((1.0, 0.5, 0.0))), {}, "all springs"),
        "order 2": (plain, {"order": 2}, "all springs"),
        "a second iteration": (plain, {"iterations": 2}, "all springs"),
    }
    for name, make in _SHAPES.items():
        found[f"{name}, away"] = (Scene({"cloth": cloth}, {"it": make(AWAY)}), {}, "all springs")
        found[f"{name}, touching"] = (Scene({"cloth": cloth}, {"it": make(AMID)}), {}, "all springs")
    return found


def hanging_cloth(resolution: int, constant: float = 1e3) -> Cloth:
    """A cloth of 1 m with all springs: stretch, shear and bending, hung by two corners."""
    return Cloth(
        resolution=(resolution, resolution),
        orientation=(np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)),
        pins=(resolution * (resolution - 1), resolution * resolution - 1),
        stretch_compliance=1.0 / constant,
        shear_compliance=3.0 / constant,
        bending="springs",
        bend_compliance=10.0 / constant,
    )


def measure(resolution: int, device: str, rounds: int) -> list[dict]:
    """Return a row for each variant: quartiles of ms a frame, and of the difference to the variant it is compared with.

    Variants take turns. All run one launch a frame, so that differences are those of the feature alone. The plain cloth
    is there twice: its own difference is the noise.
    """
    chosen = variants(hanging_cloth(resolution))
    plain = {"method": "xpbd", "order": 1, "substeps": 20, "iterations": 1}
    sims = {"": None}
    for name, (scene, settings, _) in chosen.items():
        sims[name] = Simulation(scene, Settings(**{**plain, **settings}), device=device)
    scene = chosen["all springs"][0]
    sims[""] = Simulation(scene, Settings(**plain), device=device)
    for sim in sims.values():
        for _ in range(3):  # compiles, captures
            sim.step()
    times = {name: [] for name in sims}
    for _ in range(rounds):
        for name, sim in sims.items():
            sim.reset()
            times[name].append(frame_time(sim, _FRAMES))
    rows = []
    for name, (_, _, base) in chosen.items():
        mine, without = np.array(times[name]), np.array(times["" if base == name else base])
        rows.append({"feature": name, "against": base, "ms": quartiles(mine), "cost": quartiles(mine - without)})
    return rows


def table(rows: list[dict]) -> str:
    """Return the rows as text; the first is the plain cloth against itself, which is the noise."""
    lines = [f"{'feature':<26}  {'ms a frame':>10}  {'more, and its quartiles':>32}"]
    for row in rows:
        cost = row["cost"]
        more = f"{cost['median']:+.4f} ({cost['low']:+.4f} to {cost['high']:+.4f}) ms"
        against = "" if row["against"] == "all springs" else f"  than {row['against']}"
        lines.append(f"{row['feature']:<26}  {row['ms']['median']:>10.4f}  {more:>32}{against}")
    return "\n".join(lines)
