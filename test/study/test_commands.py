# SPDX-License-Identifier: Apache-2.0
"""The commands of the study run, print what they promise and write their files."""

import json
import subprocess
import sys

import numpy as np
import pytest

from cloth_sim_ros.study import __main__, error, exact, figures, scenes
from cloth_sim_ros.study.cases import CASES
from cloth_sim_ros.study.contenders import CONTENDERS, Contender, Run


def command(monkeypatch, *arguments):
    monkeypatch.setattr(sys, "argv", ["study", *map(str, arguments)])
    return __main__.main()


@pytest.mark.long
def test_error_writes_table_and_figures(monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    options = ("--device", "cpu", "--resolution", 8, "--substeps", 20, 40, 80, "--iterations", 2, "--output", tmp_path)
    for sweeps in (0, 80):  # the second time from the cache, and with the methods in NumPy
        assert command(monkeypatch, "error", *options, "--numpy-sweeps", sweeps) == 0
    assert len(list((tmp_path / "cache").rglob("*.npz"))) == 1
    stem = "error_clamped_sheet_8_cpu"
    rows = json.loads((tmp_path / f"{stem}.json").read_text())["rows"]
    methods = {row["method"] for row in rows}
    assert methods == {contender.label for contender in CONTENDERS}
    assert any(row["front"] for row in rows)
    for method in ("XPBD, second order", "Verlet", "leapfrog Verlet (NumPy)"):
        errors = [row["position"] for row in rows if row["method"] == method]
        assert errors[0] > errors[1] > errors[2] and errors[2] < 1e-4
    for suffix in (".png", ".svg"):
        assert (tmp_path / (stem + suffix)).stat().st_size > 10_000
    assert "second order" in capsys.readouterr().out


def test_scenes_has_a_row_a_setting_and_its_error(monkeypatch, capsys):
    options = ("--device", "cpu", "--scene", "bare", "--resolution", 8, "--rounds", 1, "--reference", 160)
    assert command(monkeypatch, "scenes", *options) == 0
    lines = [line.strip("| ").split(" | ") for line in capsys.readouterr().out.splitlines() if line.startswith("| ba")]
    rows = {line[1]: line[2:] for line in lines}
    assert {*scenes.SETTINGS, "reference"} <= rows.keys() and rows["verlet"][0].startswith("verlet, ")
    errors = [float(rows[f"xpbd {substeps} x 1"][2]) for substeps in (10, 20)]
    assert errors[0] > 1.5 * errors[1] > 0.0


@pytest.mark.long
def test_scenes_tell_what_features_cost(monkeypatch, capsys):
    options = ("--device", "cpu", "--scene", "fold", "--resolution", 8, "--rounds", 2, "--reference", 40)
    assert command(monkeypatch, "scenes", *options, "--settings", "defaults", "--features") == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line for line in lines if line.startswith("all springs")] and len(lines) == 4 + 2 + 17
    assert sum(line.startswith("| fold 8 x 8 | ") for line in lines) == 2


def test_there_are_five_commands():
    assert len(__main__.COMMANDS) == 5


def test_error_of_a_rope_for_as_long_as_asked(monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    options = ("--case", "chain_1", "--resolution", 4, "--constant", 100, "--device", "cpu", "--substeps", 2, 4)
    options += ("--iterations", 1, "--numpy-sweeps", 0, "--output", tmp_path)
    assert command(monkeypatch, "error", *options, "--seconds", 0.2) == 0
    assert "load of 0.2 kg, 0.2 s, 4 segments, 100 N/m" in capsys.readouterr().out
    rows = json.loads((tmp_path / "error_chain_1_4_cpu.json").read_text())["rows"]
    errors = [row["position"] for row in rows if row["method"] == "XPBD, second order"]
    assert errors[1] < 0.5 * errors[0]
    assert command(monkeypatch, "error", "--case", "capstan", "--seconds", 1) == 2
    assert "allowed is 0.5 s" in capsys.readouterr().err


@pytest.mark.long
def test_elongation_has_a_row_a_sheet_and_a_peer(monkeypatch, capsys):
    pytest.importorskip("pypbd")
    options = ("--resolution", 16, "--substeps", 20, "--iterations", 1, 4, "--device", "cpu", "--peers")
    assert command(monkeypatch, "error", "--case", "elongation", *options) == 0
    rows = {line[:40].strip(): line[40:].split() for line in capsys.readouterr().out.splitlines()}
    ours, theirs = ([float(share.strip("%")) for share in rows[name]] for name in ("16 x 16", "16 x 16, pyPBD XPBD"))
    assert 1.0 < ours[0] < 5.0 and abs(ours[1]) < 1.0
    assert theirs[0] > ours[0] and theirs[0] > theirs[1]


def test_front_is_what_nothing_beats():
    rows = [{"ms": ms, "position": error, "relative": 0.1} for ms, error in ((1, 0.5), (2, 0.6), (3, 0.1), (3, 0.2))]
    rows.append({"ms": 0.1, "position": float("inf"), "relative": float("inf")})
    error.mark_front(rows)
    assert [row["front"] for row in rows] == [True, False, True, False, False]


def test_prices_name_the_cheapest_run_of_every_method_that_keeps_the_level():
    numbers = (("a", 3.0, 5e-4), ("a", 1.0, 9e-3), ("b", 2.0, 8e-4), ("b", 0.5, 0.1))
    rows = [
        {"method": m, "ms": ms, "position": x, "relative": x, "substeps": 5, "iterations": 1} for m, ms, x in numbers
    ]
    lines = error.prices(rows).splitlines()
    assert lines[0].split("m  ", 1)[1] == "a 5 x 1: 1 ms; b 5 x 1: 2 ms"
    assert lines[1].split("m  ", 1)[1] == "b 5 x 1: 2 ms; a 5 x 1: 3 ms"
    assert lines[3].endswith("no run")
    assert lines[4].split("of the motion  ", 1)[1] == "b 5 x 1: 0.5 ms; a 5 x 1: 1 ms"


def test_what_prices_name_is_timed_in_turns():
    """What was slow by chance the first time is found again, and what prices are far from is left alone."""
    order = []

    def simulate(wanted):
        order.append(wanted)
        return None, np.array([{"lucky": 2.0, "slow": 1.0, "far": 0.1, "lost": 0.1}[wanted]])

    rows = {
        name: {"method": "a", "ms": ms, "ms_p95": ms, "position": x, "relative": x, "substeps": 5, "iterations": 1}
        for name, ms, x in (("lucky", 1.5, 1e-6), ("slow", 1.8, 1e-6), ("far", 3.5, 1e-6), ("lost", 0.5, 0.5))
    }
    error.time_in_turns([(row, Contender(name, simulate), name) for name, row in rows.items()])
    assert order == ["lucky", "slow"] * error.ROUNDS
    assert [row["ms"] for row in rows.values()] == [1.5, 1.0, 3.5, 0.5]


@pytest.mark.parametrize("name", ["chain_1", "chain_100"])
def test_loaded_chain_stretches_as_meant(name):
    """At rest the load would stretch the chain by half to one percent; it starts at 45 degrees."""
    case = CASES[name]
    system, start = case.system(16, case.constant / 4.0)
    assert start[-1] == pytest.approx([np.sqrt(0.5), 0.0, -np.sqrt(0.5)])
    load = system.masses[-1]
    assert system.masses.sum() - load == pytest.approx(0.2, rel=0.05)
    assert 0.005 < load * 9.81 / (system.constant[0] / 16.0) < 0.0105


def test_unstable_runs_are_lost_not_fatal():
    case = CASES["clamped_sheet"]
    found = {contender.label: contender for contender in CONTENDERS}
    for label in ("Verlet", "forward Euler (NumPy)"):
        frames, _ = found[label].simulate(Run(case, 8, 1e6, "cpu", 5, 1))
        assert not np.isfinite(frames).all()


def test_bad_arguments_give_one_sentence(monkeypatch, capsys):
    assert command(monkeypatch, "error", "--device", "cuda:99", "--resolution", 8) == 2
    assert "cuda:99" in capsys.readouterr().err


def test_reference_of_a_case_is_trusted_to_its_end(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    found = exact.reference(CASES["clamped_sheet"], 8, 1000.0)
    assert found.frames.shape == (31, 64, 3) and found.trusted == 31


def test_fitted_order_is_the_slope():
    substeps = np.array([10, 20, 40])
    assert figures.fitted_order(substeps, 3.0 / substeps**2) == pytest.approx(2.0)


def test_study_does_not_import_ros():
    code = "import sys, cloth_sim_ros.study.__main__; sys.exit('rclpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
