# SPDX-License-Identifier: Apache-2.0
"""The laboratory of fabrics: its shadows and meshes, and what it finds for fabrics that are known."""

import json
import math
import sys

import numpy as np
import pytest

from cloth_sim_ros.sim import Fabric, Settings
from cloth_sim_ros.sim.scene.materials import FABRICS
from cloth_sim_ros.study import __main__
from cloth_sim_ros.study.fabric import command, laboratory, meshes

STIFF = Fabric(0.2, 900.0, 600.0, 60.0, 0.2, 1e-4, 5e-5, 6e-5)


@pytest.mark.parametrize("kind", meshes.KINDS)
def test_a_flat_disc_casts_its_own_area_and_has_a_vertex_on_the_rim_of_its_support(kind):
    points, triangles = meshes.disc(kind, 0.15, 0.09, 0.01)
    area = np.abs(meshes.areas(points, triangles)).sum()
    assert area == pytest.approx(math.pi * 0.15**2, rel=2e-3)
    assert laboratory.shadow(np.column_stack([points, np.zeros(len(points))]), triangles) == pytest.approx(
        area, rel=3e-3
    )
    assert (np.abs(np.linalg.norm(points, axis=1) - 0.09) < 1e-9).sum() > 20


def test_a_tent_casts_the_shadow_of_its_rim():
    """Triangles above one another count once."""
    points, triangles = meshes.disc("ring", 0.12, 0.09, 0.01)
    x = np.column_stack([points, np.zeros(len(points))])
    twice = np.concatenate([x, x - (0.0, 0.0, 0.1)]), np.concatenate([triangles, triangles + len(x)])
    assert laboratory.shadow(*twice) == pytest.approx(math.pi * 0.12**2, rel=5e-3)


@pytest.mark.parametrize(("degrees", "wanted"), [(0.0, 1e-4), (45.0, 6e-5), (90.0, 5e-5)])
def test_a_strip_over_an_edge_has_the_rigidity_of_its_direction(degrees, wanted):
    found = laboratory.overhung(STIFF, "delaunay", degrees, 12, Settings(error=1e-2))
    assert found == pytest.approx(wanted, rel=0.03)


@pytest.mark.parametrize("degrees", [0.0, pytest.param(45.0, marks=pytest.mark.long)])
def test_a_strip_of_few_substeps_has_its_modulus(degrees):
    """The springs of an irregular mesh act in turn, which left it 17 % too soft."""
    found = laboratory.pulled(FABRICS["silk"], "delaunay", 0.008, degrees, Settings(substeps=140))
    assert found == pytest.approx(laboratory.modulus(FABRICS["silk"], degrees), rel=0.03)


@pytest.mark.long
@pytest.mark.parametrize("name", command.BANDS)
def test_presets_drape_as_published(name):
    """Silk draped stiffer than denim."""
    low, high, _ = command.BANDS[name]
    found = laboratory.drape(FABRICS[name], "ring", 0.01, 0.1, 4.0, Settings(budget=0.5))
    assert low <= found.coefficient <= high


@pytest.mark.long
@pytest.mark.parametrize("kind", ["one way", "hexagonal", "delaunay"])
def test_a_square_in_a_picture_frame_shears_by_its_modulus(kind):
    """An irregular mesh had 4.5 % less."""
    assert laboratory.sheared(STIFF, kind, 0.02, Settings()) == pytest.approx(STIFF.shear, rel=0.03)


@pytest.mark.long
def test_the_command_prints_a_table_and_writes_a_picture(monkeypatch, tmp_path, capsys):
    own = {name: value for name, value in vars(STIFF).items() if name != "source"}
    options = ("--own", json.dumps(own), "--mesh", "ring", "--spacing", 0.02, "--seconds", 1, "--output", tmp_path)
    monkeypatch.setattr(sys, "argv", ["study", "fabric", *map(str, options)])
    assert __main__.main() == 0
    rows = json.loads((tmp_path / "fabric.json").read_text())["rows"]
    drape, *moduli = rows
    assert 60.0 < drape["found"] < 100.0 and len(moduli) == 21
    assert all(abs(row["ratio"] - 1.0) < 0.03 for row in moduli)
    assert (tmp_path / "fabric.png").stat().st_size > 5_000
    assert "drape coefficient" in capsys.readouterr().out


def test_numbers_that_are_no_fabric_are_refused_in_one_sentence():
    with pytest.raises(ValueError, match="allowed is a JSON object with numbers of areal_mass"):
        command._own('{"warp": 3}')
