# SPDX-License-Identifier: Apache-2.0
"""A few of the hard cases every time, all their kinds; `study stability` runs them all with ever new seeds."""

import dataclasses
import json
import sys

import numpy as np
import pytest

from cloth_sim_ros.sim import Rope, Scene, Settings, Simulation
from cloth_sim_ros.sim.executors.trial import Trial
from cloth_sim_ros.study import __main__, pass_map
from cloth_sim_ros.study.hard import judge, long_rest
from cloth_sim_ros.study.hard.bodies import BODY, Energy, make_body
from cloth_sim_ros.study.hard.cases import CASES

# One of every case, by settings that share few kernels; the loaded starts are the most violent.
CHOSEN = [
    ("end load", "rope", "xpbd 1", {"ratio": 1e5}),
    ("end load", "rope", "xpbd 2", {"ratio": 1e3}),
    ("bad start", "sheet", "xpbd 1", {"start": "random"}),
    *(("bad start", "sheet", "xpbd 1", {"start": start}) for start in ("stretched", "point", "mirrored")),
    ("bad start", "sheet with bending", "xpbd 1", {"start": "collapsed"}),
    ("bad start", "sheet", "verlet", {"start": "stretched"}),
    ("bad start, loaded", "rope", "xpbd 1", {"start": "random", "ratio": 1e5}),
    ("bad start, loaded", "rope", "xpbd 2", {"start": "stretched", "ratio": 100.0}),
    ("degenerate", "sheet with bending", "xpbd 1", {}),
    *(("compliance", "sheet", "xpbd 1", {"compliance": value}) for value in (0.0, 1e-9, 1e3)),
    ("compliance", "sheet with bending", "xpbd 1", {"compliance": 1e3}),
    ("compliance", "sheet", "xpbd 2", {"compliance": 0.0, "substeps": 40}),
    ("compliance", "sheet", "xpbd 2", {"compliance": 0.0, "substeps": 80, "iterations": 2}),
    ("compliance", "sheet", "verlet", {"compliance": 1e-9}),
    *(("compliance", "sheet", "auto", {"compliance": value, "iterations": 2}) for value in (0.0, 1e-2)),
    ("long step", "sheet", "xpbd 1", {"substeps": 1}),
    ("long step", "rope", "xpbd 1", {"substeps": 1}),
    *(("fast collider", "sheet", "xpbd 1", {"shape": shape, "speed": 20.0}) for shape in ("box", "sphere")),
    *(("teleport", "sheet", "xpbd 1", {"shape": "sphere", "where": where}) for where in ("into", "away")),
    ("squeeze", "sheet", "xpbd 1", {"shape": "plane"}),
    ("pulled pins", "rope", "xpbd 1", {}),
    ("pins in conflict", "sheet", "xpbd 1", {"compliance": 0.0}),
    ("sharp edge", "sheet", "xpbd 1", {"substeps": 20}),
    ("gusts", "sheet", "xpbd 1", {"pins": "none"}),
    *(("centre", "sheet", "xpbd 1", {"shape": shape}) for shape in ("sphere", "capsule", "box")),
    ("same bits", "sheet", "xpbd 1", {}),
    ("gone bad", "sheet", "xpbd 1", {"value": float("nan")}),
]


@pytest.mark.parametrize(("case", "kind", "method", "options"), CHOSEN)
@pytest.mark.long
def test_a_hard_case_keeps_its_promise(case, kind, method, options):
    options = {"substeps": 20, "iterations": 1, **options}
    verdict = judge.judge(judge.Combination(case, kind, method, options, seed=7), "cpu")
    refused = method == "verlet" and case == "compliance"
    assert verdict.outcome == ("refused" if refused else "held"), verdict.why
    assert refused or verdict.substeps > 20 or method != "verlet", "it asks for more"


def test_every_case_is_there_and_there_are_more_than_500():
    every = list(judge.combinations(seed=3))
    assert {each.case for each in every} == set(CASES) == {case for case, *_ in CHOSEN}
    assert len(every) >= 500 and len({str(each) for each in every}) == len(every)
    assert [str(each) for each in judge.combinations(seed=3)] == [str(each) for each in every]
    assert [str(each) for each in judge.combinations(seed=4)] != [str(each) for each in every]


def run_with(body, trial, method="verlet"):
    sim = Simulation(Scene({BODY: body}), Settings(order=1, method=method, substeps=40), device="cpu")
    return judge.watch(sim, dataclasses.replace(trial, scene=sim.scene))


def test_a_run_that_breaks_a_promise_fails(monkeypatch):
    """An unstable step, speed, rest and what is put back are all seen."""
    calm = CASES["compliance"].trial("sheet", {"compliance": 1e-3}, np.random.default_rng(0))
    soft, stiff = make_body("sheet", 1e-3), make_body("sheet", 1e-5)
    assert run_with(soft, calm).outcome == "held"
    assert "energy" in run_with(soft, dataclasses.replace(calm, slack=-0.5)).why
    assert "m/s" in run_with(soft, dataclasses.replace(calm, fastest=1.0)).why
    assert "strain" in run_with(soft, dataclasses.replace(calm, rest=-1.0)).why
    monkeypatch.setattr("cloth_sim_ros.sim.substeps.limits.explicit_substeps", lambda *_, **__: 1)
    monkeypatch.setattr(Trial, "advance", lambda trial: trial.explicit())
    assert "put back" in run_with(stiff, calm).why


def test_refusals_are_held_against_an_eigenvalue_of_their_own(monkeypatch):
    options = {"substeps": 1, "iterations": 1, "compliance": 1e-3}
    combination = judge.Combination("compliance", "sheet", "verlet", options, seed=1)
    assert (found := judge.judge(combination, "cpu")).outcome == "held" and found.substeps > 1
    monkeypatch.setattr("cloth_sim_ros.sim.substeps.limits.explicit_substeps", lambda *_: 400)
    assert "needs" in judge.judge(combination, "cpu").why


def test_what_was_refused_must_have_changed_nothing(monkeypatch):
    """A running simulation that takes too few substeps, or refuses but changes all the same, is found out."""
    sim = Simulation(Scene({BODY: make_body("sheet", 1e-3)}), Settings(method="verlet", substeps=200), device="cpu")
    assert judge.keeps_state(sim, 1) == "" and sim.settings.substeps == 200
    assert "not refused" in judge.keeps_state(sim, 150)

    def refuse_late(self, name, value):
        self.set_positions(BODY, 2.0 * self.rest_positions(BODY))
        raise ValueError("too late")

    monkeypatch.setattr(Simulation, "set", refuse_late)
    assert "changed by what was refused" in judge.keeps_state(sim, 1)


def test_a_shape_counts_as_recovered_only_where_it_is():
    """A hung sheet at rest; one with particles pulled out of their places, which its springs do not hold there."""
    trial = CASES["degenerate"].trial("sheet", {}, np.random.default_rng(0))
    sim = Simulation(trial.scene, Settings(method="xpbd", order=1, substeps=20, iterations=10), device="cpu")
    energy, x = Energy(sim), sim.rest_positions(BODY).astype(float)
    assert judge._shape(sim, trial, energy, x) == ("", 0.0)
    torn = x.copy()
    torn[44:56, 2] += 0.1
    assert "strain" in judge._shape(sim, trial, energy, torn)[0]
    assert energy.fold(torn) < 1e-2


def test_one_sweep_a_frame_brings_back_what_was_stretched():
    """A sheet at ten times its size, which stays strained by some 15 % where every frame is one substep."""
    options = {"substeps": 1, "iterations": 1, "start": "stretched"}
    verdict = judge.judge(judge.Combination("bad start", "sheet", "xpbd 1", options, 1230121886), "cpu")
    assert (verdict.outcome, verdict.fold) == ("held", 0.0), verdict.why


def test_energy_is_what_the_equations_say():
    """A swinging mass on a spring, by the exact method: what it holds stays."""
    rope = Rope(start=(0, 0, 0), end=(0.1, 0, 0), segments=1, particle_masses=[1, 1], stretch_compliance=1e-2)
    sim = Simulation(Scene({BODY: rope}), Settings(method="verlet", substeps=100), device="cpu")
    energy, found = Energy(sim), []
    for _ in range(60):
        sim.step()
        found.append(energy.of(sim.positions(BODY).astype(float), sim.velocities(BODY).astype(float)))
    found = np.array(found)
    assert np.ptp(found[:, 1]) > 1.0 and np.abs(found.sum(1)).max() < 2e-3


@pytest.mark.long
def test_the_command_counts_and_writes(monkeypatch, tmp_path, capsys):
    options = ("--device", "cpu", "--seed", "5", "--case", "degenerate", "--output", str(tmp_path))
    monkeypatch.setattr(sys, "argv", ["study", "stability", *options, "--method", "verlet", "xpbd 1", "--jobs", "2"])
    assert __main__.main() == 0
    text, progress = capsys.readouterr()
    assert not set("\r\33") & set(text + progress), "a log is no terminal"
    assert "10 combinations that need 8 sets of kernels, seed 5" in text
    assert "6 ran, of which 6 held and 0 failed; 4 refused" in text and "5 / 0 / 0" in text and "1 / 4 / 0" in text
    assert len(json.loads((tmp_path / "stability_cpu.json").read_text())["rows"]) == 10


@pytest.mark.long
@pytest.mark.parametrize("settings", long_rest.SETTINGS.values(), ids=long_rest.SETTINGS)
@pytest.mark.parametrize("scene", long_rest.SCENES)
def test_ten_minutes_can_begin(scene, settings):
    sim = Simulation(long_rest.SCENES[scene](), settings, "cpu")
    sim.step()
    assert sim.report()[BODY]["recoveries"] == 0


@pytest.mark.long
@pytest.mark.parametrize("scene", long_rest.SCENES)
def test_what_lies_lies_still(scene):
    """Two minutes here; ten by `stability --long`."""
    settings = long_rest.SETTINGS["xpbd 2, 20 x 1"]
    energy, drift, recoveries = long_rest.rest(Simulation(long_rest.SCENES[scene](), settings, "cpu"), minutes=2)
    assert energy < long_rest.MOST_ENERGY and drift < long_rest.MOST_DRIFT and recoveries == 0


def test_the_map_tells_what_holds_from_what_does_not():
    """Frames of a chain that falls as it may, stretches too far, gains height, is not finite, never ran."""
    system, start = pass_map.chain(1.0).system(pass_map.SEGMENTS, 1e4)
    fall = np.array([start * (1.0, 1.0, 1.0 + 1e-3 * k) for k in range(5)])
    seen = 1e9
    assert pass_map.outcome(fall, system, seen) == "holds"
    assert pass_map.outcome(start * np.linspace(1.0, 1.5, 200)[:, None, None], system, 0.0) == "stretched"
    assert pass_map.outcome(np.concatenate([fall, -fall]), system, seen) == "flies apart"
    assert pass_map.outcome(np.where(fall > fall.max() - 1e-9, np.nan, fall), system, seen) == "flies apart"
    assert pass_map.outcome(np.full_like(fall, np.nan), system, seen) == "refused"


def test_the_map_is_drawn(monkeypatch, tmp_path, capsys):
    for name, few in {
        "STIFFNESS": (1e2, 1e6, np.inf),
        "RATIOS": (1.0, 1e3),
        "SUBSTEPS": (20,),
        "ITERATIONS": (1,),
    }.items():
        monkeypatch.setattr(pass_map, name, few)
    monkeypatch.setattr(pass_map, "FRAMES", 20)
    monkeypatch.setattr(sys, "argv", ["study", "stability", "--map", "--device", "cpu", "--output", str(tmp_path)])
    assert __main__.main() == 0
    cells = json.loads((tmp_path / "map_cpu.json").read_text())["cells"]
    assert np.array(cells["XPBD, first order, 1 iterations"]).shape == (1, 2, 3)
    assert set(np.ravel(cells["XPBD, first order, 1 iterations"])) == {"holds"}
    assert np.ravel(cells["forward Euler (NumPy)"]).tolist() == ["holds", *["flies apart"] * 2] * 2
    assert np.ravel(cells["Verlet"]).tolist() == ["holds", "refused", "refused"] * 2
    assert (tmp_path / "map_cpu.png").stat().st_size > 5_000 and (tmp_path / "map_cpu.svg").exists()


def test_the_map_is_of_those_that_know_chains(monkeypatch):
    sheets_alone = dataclasses.replace(pass_map.CONTENDERS[0], label="a cloth alone", own_limit=True)
    both = [dataclasses.replace(sheets_alone, label="springs", own_limit=False), sheets_alone]
    monkeypatch.setattr(pass_map, "peers_on", lambda device: both)
    labels = {each.label for each, _ in pass_map.rows(True, "cpu")}
    assert "springs" in labels
    assert "a cloth alone" not in labels
