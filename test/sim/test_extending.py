# SPDX-License-Identifier: Apache-2.0
"""A collider shape and a force from outside the package, as docs/how-to/extending.md writes them."""

import os
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import warp as wp
from fixed_settings import fixed

from cloth_sim_ros.sim import Cloth, Rope, Scene, Settings, Simulation
from cloth_sim_ros.sim.colliders import SHAPES
from cloth_sim_ros.sim.colliders.collider import Collider, length
from cloth_sim_ros.sim.scene.forces import FORCES


@dataclass(frozen=True)
class Pipe(Collider):
    """An endless pipe of `radius` [m] along the local y axis."""

    radius: float = 0.1
    dimensions = (length("radius"),)

    def reach(self):
        return 1e6


@wp.func
def pipe_distance(p: wp.vec3, size: wp.vec3) -> wp.vec4:
    away = wp.vec3(p[0], 0.0, p[2])
    far = wp.length(away)
    n = wp.where(far > 1.0e-9, away / wp.max(far, 1.0e-9), wp.vec3(0.0, 0.0, 1.0))
    return wp.vec4(n[0], n[1], n[2], far - size[0])


@dataclass(frozen=True)
class Tether:
    """A spring of `constant` [N/m] a kilogram and a dashpot of `rate` [1/s] from every particle to height `z` [m]."""

    z: float
    constant: float
    rate: float

    def numbers(self):
        return (self.z, self.constant, self.rate, 0.0)


@wp.func
def tether_force(x: wp.vec3, v: wp.vec3, mass: float, numbers: wp.vec4) -> wp.vec4:
    pull = mass * (numbers[1] * (numbers[0] - x[2]) - numbers[2] * v[2])
    return wp.vec4(0.0, 0.0, pull, mass * numbers[2])


@pytest.fixture
def extended(monkeypatch):
    """Shape and force are known, and forgotten afterwards."""
    monkeypatch.setitem(SHAPES, "pipe", (Pipe, pipe_distance))
    monkeypatch.setitem(FORCES, "tether", (Tether, tether_force))


@pytest.mark.long
def test_a_shape_from_outside_holds_a_rope(extended, device):
    rope = Rope(start=(-0.6, 0.0, 0.5), end=(0.6, 0.0, 0.5), segments=48, pins="none", static_friction=1.0)
    scene = Scene({"rope": rope}, {"pipe": Pipe(radius=0.15, static_friction=1.0, kinetic_friction=1.0)})
    sim = Simulation(scene, Settings(global_damping=2.0), device=device)
    sim.step(120)
    x = sim.positions("rope")
    away = np.hypot(x[:, 0], x[:, 2])
    assert away.min() > 0.15 + rope.radius - 1e-3 and x[:, 2].min() < 0.1 and sim.report()["rope"]["recoveries"] == 0


@pytest.mark.parametrize("settings", [{"method": "verlet", "substeps": 100}, {"order": 1}, {"order": 2}])
@pytest.mark.parametrize("executor", ["block", pytest.param("graph", marks=pytest.mark.long), None])
def test_a_force_from_outside_swings_a_sheet_as_the_closed_form(extended, device, settings, executor):
    """Mean height of a free sheet: z + g/k (cos(omega t) - 1) with damping, from rest; every executor alike."""
    scene = Scene({"sheet": Cloth(resolution=(9, 9), pins="none")}, forces={"up": Tether(0.0, 40.0, 1.0)})
    sim = Simulation(scene, fixed(**{"substeps": 60, **settings}), device=device, executor=executor)
    frames = 30
    sim.step(frames)
    t, omega2, decay = frames / 60, 40.0, 0.5
    omega = np.sqrt(omega2 - decay**2)
    swing = np.exp(-decay * t) * (np.cos(omega * t) + decay / omega * np.sin(omega * t))
    exact = 9.81 / omega2 * (swing - 1.0)
    masses = sim.masses("sheet")
    height = (sim.positions("sheet")[:, 2] * masses).sum() / masses.sum()
    assert height == pytest.approx(exact, rel=5e-3 if settings.get("order") != 1 else 2e-2)


def test_a_force_that_nobody_knows_is_refused():
    with pytest.raises(ValueError, match="Scene.forces has .*; allowed are"):
        Scene({"rope": Rope()}, forces={"odd": Tether(0.0, 1.0, 0.0)})


PAGE = Path(__file__).parents[2] / "docs/how-to/extending.md"
BLOCKS = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(), flags=re.DOTALL | re.MULTILINE)


@pytest.mark.parametrize("block", BLOCKS, ids=range(len(BLOCKS)))
def test_each_piece_of_code_of_the_page_runs_alone(block, tmp_path):
    (tmp_path / "piece.py").write_text(block)
    done = subprocess.run(
        [sys.executable, tmp_path / "piece.py"], cwd=PAGE.parents[2], env={**os.environ, "PYTHONPATH": "."},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
