# SPDX-License-Identifier: Apache-2.0
"""Colliders whose sizes differ between worlds: each world is what it would be built with that size."""

import dataclasses

import numpy as np
import pytest
from fixed_settings import fixed

from cloth_sim_ros.sim import (
    Box,
    Capsule,
    Cloth,
    Cylinder,
    Ellipsoid,
    Scene,
    SignedDistance,
    Simulation,
    Sphere,
    Variation,
)  # fmt: skip

WORLDS = 3
SIZES = {  # of which float32 has every digit
    "ball.radius": [0.25, 0.125, 0.1875],
    "box.half_extents": [[0.125, 0.125, 0.25], [0.0625, 0.25, 0.25], [0.125, 0.0625, 0.1875]],
    "pill.radius": [0.125, 0.0625, 0.25],
    "pill.half_length": [0.125, 0.1875, 0.0625],
    "can.radius": [0.0625, 0.125, 0.1875],
    "can.half_length": [0.25, 0.125, 0.1875],
    "egg.radii": [[0.25, 0.125, 0.125], [0.0625, 0.25, 0.125], [0.125, 0.25, 0.1875]],
}
CORNERS = {"ball": (-0.3, -0.3), "box": (0.3, -0.3), "pill": (-0.3, 0.3), "can": (0.3, 0.3), "egg": (0, 0)}


def scene(world=None):
    """A sheet a little above five shapes, of the sizes of a world or of their own."""
    shapes = {"ball": Sphere, "box": Box, "pill": Capsule, "can": Cylinder, "egg": Ellipsoid}
    colliders = {}
    for name, kind in shapes.items():
        own = {key.split(".")[1]: values for key, values in SIZES.items() if key.split(".")[0] == name}
        fields = {} if world is None else {field: values[world] for field, values in own.items()}
        colliders[name] = kind(position=(*CORNERS[name], -0.32), **fields)
    return Scene({"sheet": Cloth(resolution=(8, 8), pins="none")}, colliders)


def states(sim, world=0):
    return sim.positions("sheet", world), sim.velocities("sheet", world)


@pytest.mark.long
def test_each_world_is_what_it_would_be_built_with_its_sizes(device):
    many = Simulation(scene(), fixed(), device, worlds=WORLDS)
    alone = [Simulation(scene(w), fixed(), device) for w in range(WORLDS)]
    for name, values in SIZES.items():
        many.set(name, np.array(values))
        for w in range(WORLDS):
            assert many.get(name, w) == pytest.approx(values[w], rel=1e-7)
    for sim in (many, *alone):
        sim.step(20)
    for w in range(WORLDS):
        assert all(np.array_equal(a, b) for a, b in zip(states(many, w), states(alone[w]), strict=True)), w
        assert many.report(w)["sheet"]["contacts"] == alone[w].report()["sheet"]["contacts"] > 0
        assert not np.array_equal(states(many, w)[0], states(many, (w + 1) % WORLDS)[0]), "inputs differ"


@pytest.mark.long
def test_one_thin_world_has_colliders_kept_out_between_particles_in_all(device, tmp_path):
    """A ball that passes between the particles where it is small is tested against triangles."""
    sheet = Scene({"sheet": Cloth(resolution=(8, 8), pins="edges")}, {"ball": Sphere(5.0, position=(0, 0, -5.2))})
    sim, thin = Simulation(sheet, fixed(), device, worlds=WORLDS), np.array([False, True, False])
    assert not sim.choices["sheet"].surface
    sim.set("ball.radius", np.array([5.0, 0.02, 5.0]), thin)
    assert sim.choices["sheet"].surface
    sim.write("ball", "pose", np.tile([0.02, 0.03, -0.05, 0, 0, 0, 1], (WORLDS, 1)), thin, sweep=False)
    for frame in range(12):
        sim.write("ball", "pose", np.tile([0.02, 0.03, -0.05 + 0.01 * frame, 0, 0, 0, 1], (WORLDS, 1)), thin)
        sim.step()
    assert sim.report(1)["sheet"]["max_penetration"] < 5e-4, "it lifts the sheet between its particles"
    assert sim.positions("sheet", 1)[:, 2].max() > 0.05 > sim.positions("sheet", 0)[:, 2].max()
    sim.save(tmp_path / "state.npz")
    sim.set("ball.radius", 5.0)
    assert not sim.choices["sheet"].surface
    sim.load(tmp_path / "state.npz")
    assert sim.choices["sheet"].surface and [sim.get("ball.radius", w) for w in range(WORLDS)] == [5.0, 0.02, 5.0]
    sim.set("sheet.stretch_compliance", 2e-3)
    assert sim.choices["sheet"].surface, "sizes of the file count"


def test_reach_and_roundness_of_many_sizes_are_those_of_each():
    shapes = [Sphere(), Box(), Capsule(), Cylinder(), Ellipsoid()]
    sizes = np.random.default_rng(3).uniform(0.05, 0.5, (40, 3))
    for shape in shapes:
        many, each = shape.resized(sizes), [shape.resized(size) for size in sizes]
        assert np.array_equal(np.broadcast_to(many.reach(), 40), [one.reach() for one in each])
        roundness = [one.roundness() for one in each]
        assert np.array_equal(np.broadcast_to(many.roundness(), 40), roundness)
        assert shape.sharpest(sizes).roundness() == min(roundness)
    assert Box(half_extents=(0.2, 0.3, 0.6)).reach() == pytest.approx(0.7)
    assert Ellipsoid((0.1, 0.4, 0.2)).roundness() == pytest.approx(0.025)


@pytest.mark.long
def test_sizes_are_drawn(device):
    sim = Simulation(scene(), fixed(), device, worlds=WORLDS)
    vary = {"ball.radius": {"uniform": [0.1, 0.3]}, "egg.radii": {"log_uniform": [[0.1, 0.1, 0.1], [0.2, 0.2, 0.3]]}}
    drawn = Variation(vary, seed=4).apply(sim)
    assert drawn["ball.radius"].shape == (WORLDS,) and drawn["egg.radii"].shape == (WORLDS, 3)
    for w in range(WORLDS):
        assert sim.get("ball.radius", w) == pytest.approx(drawn["ball.radius"][w], rel=1e-6)
        assert sim.get("egg.radii", w) == pytest.approx(drawn["egg.radii"][w], rel=1e-6)
    with pytest.raises(ValueError, match=r"ball.radius has shape \(3,\) with values from -.*; allowed are .* 1e-06"):
        Variation({"ball.radius": {"normal": [-0.1, 0.01]}}).apply(sim)
    assert sim.get("ball.radius", 1) == pytest.approx(drawn["ball.radius"][1], rel=1e-6), "nothing has changed"


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("ball.radius", -0.1, "ball.radius is -0.1; allowed is a finite number from 1e-06 to 1e"),
        ("box.half_extents", (0.1, 0.1), r"box.half_extents is \[0.1, 0.1\]; allowed is 3 finite numbers"),
        ("box.half_extents", np.ones((2, 3)), r"box.half_extents has shape \(2, 3\).*; allowed are \(3, 3\)"),
        ("can.radii", 0.1, "no parameter 'can.radii'; allowed is one of .*radius, half_length"),
        ("lump.spacing", (1, 1, 1), "lump.spacing is fixed when a Simulation is built"),
    ],
)
@pytest.mark.long
def test_sizes_that_cannot_be_are_refused(name, value, words):
    grid = np.linalg.norm(np.stack(np.meshgrid(*[np.arange(-2, 3)] * 3), axis=-1), axis=-1) * 0.1 - 0.15
    lump = SignedDistance(values=grid, origin=(-0.2, -0.2, -0.2), spacing=0.1)
    described = dataclasses.replace(scene(), colliders={**scene().colliders, "lump": lump})
    sim = Simulation(described, fixed(), "cpu", worlds=WORLDS)
    with pytest.raises(ValueError, match=words):
        sim.set(name, value)
