# SPDX-License-Identifier: Apache-2.0
"""Tubes, charts and scales of sliders, against what they must be."""

import numpy as np
import pytest
import trimesh

from cloth_sim_ros.drawing.sheet import Shell, checks, strands
from cloth_sim_ros.drawing.tube import SIDES, tube_faces, tube_vertices
from cloth_sim_ros.viewer.curves import Curves
from cloth_sim_ros.viewer.window import Page, Window

HELIX = np.linspace(0.0, 12.0, 200)
PATHS = {
    "straight": np.linspace((0, 0, 0), (0, 0, 1), 9),
    "helix": np.stack([np.cos(HELIX), np.sin(HELIX), 0.1 * HELIX], axis=1),
    "folded back": np.array([[0, 0, 0], [0, 0, 1], [0, 0, 0.5]], float),
    "on a drum": np.array([[0, 0, 0], [0, 0, 0], [0, 0, 0], [0, 0, -1], [0.5, 0, -2]], float),
    "at one point": np.zeros((4, 3)),
}


@pytest.mark.parametrize("path", PATHS)
def test_a_tube_has_its_radius_everywhere(path):
    points = PATHS[path]
    vertices = tube_vertices(points, 0.02)
    rings = vertices[:-2].reshape(len(points), SIDES, 3)
    assert np.isfinite(vertices).all()
    assert np.allclose(np.linalg.norm(rings - points[:, None], axis=2), 0.02)
    assert np.allclose(rings.mean(axis=1), points)


def test_a_tube_does_not_twist():
    points = PATHS["helix"]
    rings = tube_vertices(points, 0.02)[:-2].reshape(len(points), SIDES, 3)
    step = np.linalg.norm(np.diff(rings, axis=0), axis=2)  # of each corner, along the tube
    assert step.max() < 1.05 * np.linalg.norm(np.diff(points, axis=0), axis=1).max()


def test_a_tube_is_closed():
    faces = tube_faces(7)
    assert len(faces) == 2 * SIDES * 6 + 2 * SIDES and faces.max() == 7 * SIDES + 1
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()


def test_a_chart_keeps_what_it_spans(server):
    chart = Curves(server.gui, "it", ["one", "two"], log=(1e-3, 80.0), span=5.0)
    for k in range(100):
        chart.add(0.1 * k, [k, -1.0])
    chart.draw()
    x, one, two = chart.data
    assert x[0] == pytest.approx(4.9) and x[-1] == pytest.approx(9.9)
    assert np.array_equal(one, np.arange(49, 81)), "it leaves the chart where it leaves the range"
    assert len(two) == 0
    chart.add(0.0, [1.0, 1.0])  # time has begun anew
    chart.draw()
    assert len(chart.data[0]) == 1


def test_a_chart_is_given_no_number_that_is_none(server):
    """uPlot takes nan for a number, and draws nothing then."""
    chart = Curves(server.gui, "it", ["late", "gap", "ends", "never"])
    rows = ([np.nan, 1, 1], [np.nan, np.nan, np.inf], [2, 3, np.nan])
    for k, (late, gap, ends) in enumerate(rows):
        chart.add(k, [late, gap, ends, np.nan])
    chart.draw()
    assert [list(curve) for curve in chart.data] == [[0, 1, 2], [2, 2, 2], [1, 1, 3], [1], []]


def test_a_page_that_is_chosen_replaces_the_one_before():
    class Ball(Page):
        def build(self):
            self.drawing.ball("ball", 0.1, np.zeros(3), (0, 0, 0))
            self.buttons(("press",), lambda label: None)

    class Empty(Page):
        pass

    window = Window("127.0.0.1", 18100, {"ball": Ball, "empty": Empty})
    window.advance()
    ball = window.page
    assert window.server.scene.get_handle_by_name("/page/ball") is not None
    window.choose("empty")
    window.advance()
    assert window.page is not ball and window.server.scene.get_handle_by_name("/page/ball") is None
    assert not ball.folder.visible
    ball.folder.order = 1.0  # which viser complains of where it is removed: updates may still be on their way
    window.choose("ball")
    window.advance()
    with pytest.warns(match="already removed"):
        ball.remove()
    window.close()


def test_a_shell_has_two_sides_and_a_hem_around_them():
    """A square of 3 x 3 particles: 8 triangles on each side, and 8 edges around it."""
    x, y = (each.ravel() for each in np.meshgrid(np.linspace(0, 1, 3), np.linspace(0, 1, 3)))
    points, index = np.stack([x, y, 0 * x], axis=1), np.arange(9).reshape(3, 3)
    lower = np.stack([index[:-1, :-1], index[:-1, 1:], index[1:, 1:]], axis=-1).reshape(-1, 3)
    upper = np.stack([index[:-1, :-1], index[1:, 1:], index[1:, :-1]], axis=-1).reshape(-1, 3)
    triangles = np.concatenate([lower, upper])
    shell = Shell(9, triangles, 0.01)
    body = trimesh.Trimesh(shell.vertices(points), np.concatenate([shell.front, shell.back, shell.hem]))
    assert body.is_watertight and body.volume == pytest.approx(1.0 * 0.02, rel=1e-6)
    assert len(shell.hem) == 2 * 8
    dark = checks(points, triangles)
    cells = dark[:4].reshape(2, 2)
    assert np.array_equal(dark[:4], dark[4:]), "both halves of a cell have a tone"
    assert cells[0, 0] == cells[1, 1] != cells[0, 1] == cells[1, 0]


def test_a_rope_has_two_strands_of_equal_size():
    faces = tube_faces(11)
    assert strands(faces, 11).mean() == pytest.approx(0.5, abs=0.02)
