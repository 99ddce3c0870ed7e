# SPDX-License-Identifier: Apache-2.0
"""Worlds that differ at random: as distributed as is asked for, and the same for the same seed."""

import numpy as np
import pytest
import yaml
from fixed_settings import fixed
from scipy import stats

from cloth_sim_ros.sim import Cloth, Handle, Plane, Rope, Scene, Simulation, Sphere, Variation, Winch, Wind

MANY = 20000
TRUTH = {
    "uniform": ([2.0, 5.0], stats.uniform(2, 3)),
    "log_uniform": ([1e-4, 1e-2], stats.loguniform(1e-4, 1e-2)),
    "normal": ([-1.0, 2.0], stats.norm(-1, 2)),
    "log_normal": ([1e-3, 0.5], stats.lognorm(0.5, scale=1e-3)),
}


@pytest.mark.parametrize("kind", TRUTH)
def test_draws_are_distributed_as_asked(kind):
    numbers, truth = TRUTH[kind]
    rows = Variation({"x": {kind: numbers}}, seed=5).draw({"x": 3}, MANY)["x"]
    assert rows.shape == (MANY, 3)
    for column in rows.T:
        assert stats.kstest(column, truth.cdf).pvalue > 1e-3
    ranks = stats.spearmanr(rows).statistic
    assert np.abs(ranks[np.triu_indices(3, 1)]).max() < 0.03, "components are drawn on their own"
    assert abs(stats.spearmanr(rows[:-1, 0], rows[1:, 0]).statistic) < 0.03, "and worlds too"


def test_a_world_draws_the_same_whatever_is_around_it():
    both = {"a": {"normal": [0, 1]}, "b": {"uniform": [0, 1]}}
    few = Variation(both, seed=1).draw({"a": 2, "b": 1}, 5)
    many = Variation(both, seed=1).draw({"a": 2, "b": 1}, 500)
    alone = Variation({"b": both["b"]}, seed=1).draw({"b": 1}, 7)
    assert np.array_equal(few["a"], many["a"][:5]) and np.array_equal(few["b"], many["b"][:5])
    assert np.array_equal(alone["b"], many["b"][:7])
    for other in (Variation(both, seed=2).draw({"a": 2, "b": 1}, 5), Variation(both, 1).draw({"a": 2, "b": 1}, 5, 1)):
        assert not np.intersect1d(other["a"], few["a"]).size
    seen = Variation({"x": {"uniform": [[0, 10], [1, 11]]}}).draw({"x": 2}, 100)["x"]
    assert (seen.min(axis=0) >= [0, 10]).all() and (seen.max(axis=0) <= [1, 11]).all()


VARY = """
vary:
  sheet.stretch_compliance: {log_uniform: [1e-3, 1e-2]}
  ball.kinetic_friction: {uniform: [0.1, 0.9]}
  ball.position: {normal: [[0, 0, -0.3], [0.05, 0.05, 0]]}
  wind.velocity: {normal: [[1, 0, 0], 0.5]}
  gravity: {uniform: [[0, 0, -10], [0, 0, -9]]}
"""


@pytest.mark.long
def test_worlds_of_a_simulation_get_what_is_drawn(device):
    colliders = {"ball": Sphere(radius=0.2), "floor": Plane(position=(0, 0, -9))}
    scene = Scene({"sheet": Cloth(resolution=(6, 6), pins="top")}, colliders, Wind())
    sim = Simulation(scene, fixed(), device, worlds=4)
    drawn = Variation(yaml.safe_load(VARY)["vary"], seed=3).apply(sim)
    for name, rows in drawn.items():
        for w in range(4):
            assert np.allclose(sim.get(name, w), rows[w], rtol=1e-6), name
    assert np.ptp(drawn["ball.position"][:, 2]) == 0 and np.ptp(drawn["ball.position"][:, 0]) > 0
    sim.step(3)
    assert not any(np.array_equal(sim.positions("sheet", 0), sim.positions("sheet", w)) for w in range(1, 4))
    mask = np.array([False, True, False, False])
    again = Variation(yaml.safe_load(VARY)["vary"], seed=3).apply(sim, mask, episode=1)
    friction = [sim.get("ball.kinetic_friction", w) for w in range(4)]
    wanted = np.where(mask, again["ball.kinetic_friction"], drawn["ball.kinetic_friction"])
    assert np.allclose(friction, wanted, rtol=1e-6) and not np.allclose(friction, drawn["ball.kinetic_friction"])


def started(position=(0, 0, 0), orientation=(0, 0, 0, 1), rope=(0, 2, 0), hand=(0.5, -0.5, 0)):
    """A sheet, held by a pinned row and a hand, and a rope on a winch, where they may start elsewhere."""
    sheet = Cloth(resolution=(6, 6), pins="top", position=position, orientation=orientation)
    line = Rope(segments=8, bend_compliance=1.0, winch=Winch(0.6), position=rope)
    return Scene({"sheet": sheet, "rope": line}, handles={"hand": Handle(hand, reach=0.25, attached=True)})


STARTS = {
    "sheet.position": {"uniform": [[-0.1, -0.1, -0.1], [0.1, 0.1, 0.1]]},
    "sheet.orientation": {"normal": [[0, 0, 0, 1], 0.05]},
    "rope.position": {"normal": [[0, 2, 0], 1.0]},
    "hand.position": {"uniform": [[0.45, -0.55, -0.05], [0.55, -0.45, 0.05]]},
}


@pytest.mark.long
def test_objects_start_where_is_drawn_as_in_a_scene_that_puts_them_there(device):
    many = Simulation(started(), fixed(), device, worlds=3)
    many.step(4)
    many.reset()
    drawn = Variation(STARTS, seed=2).apply(many)
    turned = drawn["sheet.orientation"] / np.linalg.norm(drawn["sheet.orientation"], axis=1)[:, None]
    places = zip(drawn["sheet.position"], turned, drawn["rope.position"], drawn["hand.position"], strict=True)
    alone = [Simulation(started(*map(tuple, each)), fixed(), device) for each in places]
    assert np.ptp(many.positions("sheet", None), axis=0).min() > 1e-3
    for w, sim in enumerate(alone):
        for name in ("sheet", "rope"):
            assert many.positions(name, w) == pytest.approx(sim.positions(name), abs=1e-6)
            assert not many.velocities(name, w).any()
        assert many.held("hand", w) == sim.held("hand") > 0
    for sim in (many, *alone):
        sim.step(10)
    for w, sim in enumerate(alone):
        for name in ("sheet", "rope"):
            assert many.positions(name, w) == pytest.approx(sim.positions(name), abs=2e-5)
    one = Simulation(started(), fixed(), device)
    Variation(STARTS, seed=2).apply(one)
    one.step(10)
    assert np.array_equal(one.positions("sheet"), many.positions("sheet", 0)), "each world is what it is alone"


def test_other_worlds_keep_their_start(device):
    whole = started()
    many = Simulation(Scene({"sheet": whole.objects["sheet"]}, handles=whole.handles), fixed(), device, worlds=3)
    starts = {name: each for name, each in STARTS.items() if not name.startswith("rope")}
    mask = np.array([False, True, False])
    many.release("hand", 2)
    held = many.held("hand")
    Variation(starts, seed=2).apply(many, mask)
    assert many.held("hand").tolist() == held.tolist() and held[2] == 0 < held[0]
    moved = [not np.array_equal(many.positions("sheet", w), many.rest_positions("sheet")) for w in range(3)]
    assert moved == mask.tolist()
    many.reset()
    assert np.array_equal(many.positions("sheet", 1), many.rest_positions("sheet"))


@pytest.mark.parametrize(
    ("vary", "words"),
    [
        ({"sheet.position": {"uniform": [[2e4, 0, 0], [3e4, 0, 0]]}}, "sheet.position has shape .* to 10000"),
        ({"sheet.position": {"uniform": [[0, 0], [1, 1]]}}, "vary.sheet.position has vectors .*; allowed are 3"),
        ({"sheet.orientation": {"uniform": [0, 0]}}, "sheet.orientation is .* in row 0; allowed"),
        ({"sheet.size": {"uniform": [1, 2]}}, "no live parameter 'sheet.size'"),
        ({"sheet.damping": {"normal": [0]}}, "vary.sheet.damping is .*; allowed is one of uniform, log_uniform"),
        ({"sheet.damping": {"gamma": [0, 1]}}, "vary.sheet.damping is .*; allowed"),
        ({"sheet.damping": {"log_uniform": [0, 1]}}, "vary.sheet.damping is .*above 0 for logarithms"),
        ({"sheet.damping": {"uniform": [1, 0]}}, "vary.sheet.damping is .*; allowed"),
        ({"sheet.damping": 3}, "vary.sheet.damping is 3; allowed"),
        ([1], r"vary is \[1\]; allowed is a mapping"),
        ({"flag.damping": {"uniform": [0, 1]}}, "no live parameter 'flag.damping'"),
        ({"sheet.damping": {"uniform": [[0, 0], 1]}}, "vary.sheet.damping has vectors .*; allowed are 1"),
        ({"sheet.damping": {"normal": [0, 1]}}, "sheet.damping has shape .*; allowed are .* from 0 to 1000"),
    ],
)
def test_what_cannot_vary_is_refused(vary, words):
    sim = Simulation(Scene({"sheet": Cloth(resolution=(6, 6), pins="top")}), fixed(), "cpu", worlds=4)
    with pytest.raises(ValueError, match=words):
        Variation(vary).apply(sim)
    with pytest.raises(ValueError, match="episode is -1; allowed"):
        Variation({}).apply(sim, episode=-1)
    with pytest.raises(ValueError, match="seed is -1; allowed"):
        Variation({}, seed=-1)
