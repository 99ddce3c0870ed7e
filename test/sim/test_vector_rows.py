# SPDX-License-Identifier: Apache-2.0
"""Grids eight particles at a time: what one particle after the other gives, whatever the shape of the grid and whatever
lies beside it."""

import numpy as np
import pytest

from cloth_sim_ros.sim import Box, Cloth, Rope, Scene, Settings, Simulation, Sphere, Wind
from cloth_sim_ros.sim.executors.choose import forced_executor

SPRINGS = {"stretch_compliance": 1e-3, "shear_compliance": 1e-3}
MESH = Cloth.from_mesh(
    np.array([[0, 3, 0], [1, 3, 0], [0, 4, 0], [1, 4, 0.2]]), [(0, 1, 2), (1, 3, 2)], mass=1.0, stretch_compliance=1e-2
)


def both(things, substeps=60, worlds=1, iterations=1, frame_dt=1 / 60, **scene):
    """The same scene in vector rows, as a CPU takes it, and particle by particle."""
    things = things if isinstance(things, dict) else {"it": things}
    numbers = {"substeps": substeps, "iterations": iterations, "frame_dt": frame_dt, "global_damping": 0.3}
    return [
        simulation(Scene(things, **scene), Settings("verlet", **numbers), worlds, executor)
        for executor in (None, "block")
    ]


def simulation(scene, settings, worlds, executor):
    with forced_executor(executor):
        return Simulation(scene, settings, "cpu", worlds)


def states(sims, name="it"):
    return [np.hstack([sim.positions(name), sim.velocities(name)]) for sim in sims]


@pytest.mark.parametrize("damping", [0.0, 1e-4])
@pytest.mark.parametrize("more", [{}, {"bend_compliance": 0.1}, {"shear_compliance": None}])
@pytest.mark.parametrize("resolution", [(2, 2), (2, 9), (3, 3), (8, 8), (31, 17)])
def test_each_spring_pulls_as_it_does_alone(resolution, more, damping):
    """A step from a crumpled shape in motion: whatever a spring did otherwise would be a thousandth of the velocity."""
    cloth = Cloth(resolution=resolution, size=(1.0, 1.5), pins="corners", damping=damping, **(SPRINGS | more))
    sims = both(cloth, substeps=1, frame_dt=1e-4)
    for sim in sims:
        draw = np.random.default_rng(4)
        x = sim.positions("it")
        sim.set_positions("it", x + draw.normal(0.0, 0.1 / max(resolution), x.shape))
        sim.set_velocities("it", draw.normal(0.0, 1.0, x.shape))
        sim.step()
    found, wanted = states(sims)
    assert "vector rows" in sims[0].method and "block" in sims[1].method
    assert np.abs(found - wanted).max() < 2e-6 * np.abs(wanted).max()


@pytest.mark.parametrize("iterations", [1, 2])
@pytest.mark.long
def test_vector_rows_are_one_executor_of_many_in_a_busy_scene(iterations):
    things = {
        "sheet": Cloth(resolution=(12, 11), pins="top", damping=1e-4, bending="springs", **SPRINGS),
        "rope": Rope(segments=20, start=(0, 2, 0), end=(1, 2, 0), pins="both", stretch_compliance=1e-2),
        "mesh": MESH,
        "small": Cloth(resolution=(5, 4), position=(0, 5, 0), pins="corners", **SPRINGS),
    }
    colliders = {
        "ball": Sphere(radius=0.2, position=(0, 0, -0.22)),
        "box": Box(position=(0.3, 2, -0.3)),
        "pole": Sphere(radius=0.02, position=(0.125, 5.167, -0.0255)),  # just below a spring
    }
    sims = both(things, iterations=iterations, colliders=colliders, wind=Wind((1, 2, 0)))
    for frame in range(4):
        for sim in sims:
            sim.set_collider_pose("ball", (0, 0.02 * frame, -0.2), (0, 0, 0.05 * frame, 1))
            sim.step()
    for name in things:
        found, wanted = states(sims, name)
        assert np.abs(wanted - sims[0].rest_positions(name)[:, [0, 1, 2] * 2])[:, :3].max() > 1e-3
        if name in ("rope", "mesh"):
            assert np.array_equal(found, wanted)
        assert np.abs(found - wanted)[:, :3].max() < 1e-5  # ten roundings at 5 m, which contact lets grow
    alone = both({"sheet": things["sheet"]}, iterations=iterations, colliders=colliders, wind=Wind((1, 2, 0)))[0]
    for frame in range(4):
        alone.set_collider_pose("ball", (0, 0.02 * frame, -0.2), (0, 0, 0.05 * frame, 1))
        alone.step()
    assert np.array_equal(*states([alone, sims[0]], "sheet"))


@pytest.mark.long
def test_worlds_have_their_own_vector_rows():
    scene = {"it": Cloth(resolution=(9, 9), pins="top", **SPRINGS), "other": Cloth(resolution=(6, 3), **SPRINGS)}
    many, single = both(scene, worlds=3)[0], both(scene, gravity=(0, 0, -3.0))[0]
    many.set("gravity", (0, 0, -3.0), world=1)
    for sim in (many, single):
        sim.step(8)
    for name in scene:
        assert np.array_equal(many.positions(name, 1), single.positions(name))
        assert np.array_equal(many.positions(name, 0), many.positions(name, 2))
        assert not np.array_equal(many.positions(name, 0), many.positions(name, 1))
    many.set_velocities("other", np.full((18, 3), 5e5), world=2)
    many.step()
    assert [many.report(world)["other"]["recoveries"] for world in range(3)] == [0, 0, 1]


def test_a_body_gone_bad_is_put_back_alone_and_starts_anew():
    scene = {"it": Cloth(resolution=(9, 9), pins="top", **SPRINGS), "other": Cloth(resolution=(6, 3), **SPRINGS)}
    sim, beside = both(scene)[0], both(scene)[0]
    sim.step(3), beside.step(3)
    good, batch = sim.positions("it"), sim._bodies.batch["it"]
    positions = batch.worlds[0].state.positions[batch.span("it")]
    spoiled = positions.numpy()
    spoiled[40, 0] = np.nan
    positions.assign(spoiled)
    sim.step(), beside.step()
    assert np.array_equal(sim.positions("it"), good) and not sim.velocities("it").any()
    assert sim.report()["it"]["recoveries"] == 1 and sim.report()["other"]["recoveries"] == 0
    assert np.array_equal(sim.positions("other"), beside.positions("other"))
    from_rest = both(scene)[0]
    from_rest.set_positions("it", good)
    sim.step(), from_rest.step()
    assert np.abs(sim.positions("it") - from_rest.positions("it")).max() < 1e-6
    assert sim.report()["it"]["recoveries"] == 1 and np.abs(sim.positions("it") - good).max() > 1e-4
