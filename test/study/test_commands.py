"""The commands of the study run, print what they promise and write their files."""

import json
import subprocess
import sys

import numpy as np
import pytest

from cloth_sim_ros.study import __main__, exact, figures
from cloth_sim_ros.study.cases import CASES


def command(monkeypatch, *arguments):
    monkeypatch.setattr(sys, "argv", ["study", *map(str, arguments)])
    return __main__.main()


def test_speed_measures_both_schedules(monkeypatch, tmp_path, capsys):
    file = tmp_path / "speed.json"
    options = ("--device", "cpu", "--resolution", 8, "--rounds", 2, "--seconds", 0.01, "--json", file)
    assert command(monkeypatch, "speed", *options) == 0
    row = json.loads(file.read_text())["rows"][0]
    assert row["resolution"] == 8 and 0.0 < row["resident"]["median"] < row["coloured"]["median"]
    assert row["ratio"]["low"] <= row["ratio"]["median"] <= row["ratio"]["high"] and row["ratio"]["median"] > 1.0
    assert "8 x 8" in capsys.readouterr().out


def test_error_writes_table_and_figures(monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    options = ("--device", "cpu", "--resolution", 8, "--substeps", 20, 40, 80, "--iterations", 2, "--output", tmp_path)
    for _ in range(2):  # the second time from the cache
        assert command(monkeypatch, "error", *options) == 0
    assert len(list((tmp_path / "cache").rglob("*.npz"))) == 1
    stem = "error_clamped_sheet_8_cpu"
    rows = json.loads((tmp_path / f"{stem}.json").read_text())["rows"]
    assert len(rows) == 6 and any(row["front"] for row in rows)
    second = [row["position"] for row in rows if "second" in row["method"]]
    assert second[0] > second[1] > second[2] and second[2] < 1e-4
    for suffix in (".png", ".svg"):
        assert (tmp_path / (stem + suffix)).stat().st_size > 10_000
    assert "second order" in capsys.readouterr().out


def test_bad_arguments_give_one_sentence(monkeypatch, capsys):
    assert command(monkeypatch, "speed", "--device", "cuda:99", "--resolution", 8) == 2
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
