# SPDX-License-Identifier: Apache-2.0
"""The speed of a device: measured once on a machine, kept, and what a budget pays follows from it."""

import json

import pytest
import warp as wp

from cloth_sim_ros.sim import Cloth, Scene, Settings, Simulation
from cloth_sim_ros.sim.substeps import speed

ASKS = dict(error=1e-6, budget=0.02)  # all that the budget pays


def towel(**settings) -> Simulation:
    return Simulation(Scene({"it": Cloth(resolution=(20, 20))}), Settings(**{**ASKS, **settings}), device="cpu")


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """A machine on which no speed was measured yet."""
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path))
    monkeypatch.delenv(speed.VARIABLE, raising=False)
    speed._kept.cache_clear()
    yield tmp_path / speed._FILE
    speed._kept.cache_clear()


def test_the_speed_is_measured_once_and_kept(cache):
    first = towel()
    kept = json.loads(cache.read_text())
    assert list(kept.values()) == [first._bodies.speed] and 0.01 < first._bodies.speed < 100.0
    speed._kept.cache_clear()  # another process
    cache.write_text(json.dumps({name: 4.0 * value for name, value in kept.items()}))
    second = towel()
    assert second._bodies.speed == 4.0 * first._bodies.speed
    assert second.choices["it"].most == pytest.approx(4.0 * first.choices["it"].most, rel=0.1)


@pytest.mark.parametrize(
    "text", ["", "[1]", "{", '{"CPU": "fast"}', '{"CPU": -1.0}', '{"CPU": 5000.0}', "[" * 200000, '{"CPU": NaN}']
)
def test_a_file_that_holds_no_speed_is_replaced(cache, text):
    cache.write_text(text)
    measured = towel()._bodies.speed
    assert measured > 0.0 and json.loads(cache.read_text())["CPU"] == measured


def test_a_cache_that_cannot_be_written_costs_a_measurement_at_each_start(cache):
    cache.mkdir()
    assert towel()._bodies.speed > 0.0
    assert [*cache.parent.glob(f"{cache.stem}*")] == [cache], "nothing is left beside it"


def test_the_speed_that_is_set_counts_before_any_other(cache, monkeypatch):
    monkeypatch.setenv(speed.VARIABLE, "0.5")
    assert towel()._bodies.speed == 0.5
    sim = towel(speed=2.0)
    assert sim._bodies.speed == 2.0 and not cache.exists()
    most = sim.choices["it"].most
    sim.set("solver.speed", 1.0)
    assert sim.choices["it"].most == pytest.approx(0.5 * most, rel=0.1)
    sim.set("solver.speed", 0.0)
    assert sim._bodies.speed == 0.5


def test_a_saved_state_keeps_the_speed(monkeypatch, tmp_path):
    sims = []
    for text in ("0.5", "2"):
        monkeypatch.setenv(speed.VARIABLE, text)
        sims.append(towel())
    sims[0].save(tmp_path / "state")
    sims[1].load(tmp_path / "state")
    assert sims[1]._bodies.speed == 0.5
    for sim in sims:
        sim.set("solver.budget", 0.05)
    assert sims[0].choices["it"].most == sims[1].choices["it"].most


def test_a_speed_that_cannot_be_had_changes_nothing(monkeypatch):
    sim = towel(speed=2.0)
    monkeypatch.setenv(speed.VARIABLE, "fast")
    with pytest.raises(ValueError, match="allowed is a number"):
        sim.set("solver.speed", 0.0)
    assert sim.get("solver.speed") == sim._bodies.speed == 2.0


@pytest.mark.parametrize("text", ["fast", "0", "-1", "nan", "inf", "1001"])
def test_a_wrong_variable_is_named(monkeypatch, text):
    monkeypatch.setenv(speed.VARIABLE, text)
    with pytest.raises(ValueError, match=f"{speed.VARIABLE} is '{text}'; allowed is a number above 0, at most 1000"):
        towel()
