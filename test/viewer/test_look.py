# SPDX-License-Identifier: Apache-2.0
"""Where the camera of a visitor is put, in windows of different shapes."""

import time
from types import SimpleNamespace

import numpy as np
import pytest

from cloth_sim_ros.viewer.live import page
from cloth_sim_ros.viewer.look import FIELD_OF_VIEW, look_from, welcome


def put(width, height, position, at=(0.0, 0.0, 0.5)):
    """The camera of a window of this many pixels, after it was told to look from `position` at `at` [m]."""
    camera = SimpleNamespace(image_width=width, image_height=height)
    client = SimpleNamespace(camera=camera)
    look_from(SimpleNamespace(initial_camera=SimpleNamespace(), get_clients=lambda: {0: client}), position, at)
    return camera


@pytest.mark.parametrize("size", [(1600, 900), (900, 1000)])
def test_in_a_wide_window_the_camera_is_where_it_was_put(size):
    camera = put(*size, (1.0, -2.0, 1.0))
    np.testing.assert_array_equal(camera.position, (1.0, -2.0, 1.0))
    np.testing.assert_array_equal(camera.look_at, (0.0, 0.0, 0.5))


@pytest.mark.parametrize("size", [(390, 844), (1170, 2532)], ids=["pixels of a desktop", "pixels of a phone"])
@pytest.mark.parametrize("position", [(1.0, -2.0, 1.0), (0.0, 0.0, 2.5), (0.0, 0.0, -1.5)])
def test_in_a_narrow_window_what_it_looks_at_stands_in_the_upper_part(size, position):
    camera, at = put(*size, position), np.array((0.0, 0.0, 0.5))
    way, seen = camera.look_at - camera.position, at - camera.position
    way /= np.linalg.norm(way)
    off = seen / (seen @ way) - way  # from the middle of the picture, one unit before the camera
    assert np.linalg.norm(off) / (2.0 * np.tan(0.5 * FIELD_OF_VIEW)) == pytest.approx(0.2, rel=1e-6)
    assert off[2] > 0.0 or abs(way[2]) > 0.99


def test_a_window_that_becomes_narrow_or_wide_is_framed_anew():
    position, at = (1.0, -2.0, 1.0), (0.0, 0.0, 0.5)
    heard = []
    camera = SimpleNamespace(image_width=1600, image_height=900, on_update=heard.append)
    server = SimpleNamespace(initial_camera=SimpleNamespace(position=position, look_at=at))
    welcome(server, SimpleNamespace(camera=camera))
    np.testing.assert_array_equal(camera.position, position)
    camera.position, camera.image_width = (3.0, 3.0, 3.0), 1200
    heard[0](camera)
    assert camera.position == (3.0, 3.0, 3.0), "who turned the camera keeps it"
    camera.image_width = 420
    heard[0](camera)
    np.testing.assert_array_equal(camera.position, put(420, 900, position, at).position)
    camera.image_width = 1600
    heard[0](camera)
    np.testing.assert_array_equal(camera.position, position)


def test_the_camera_is_put_once_all_of_the_scene_is_there(monkeypatch):
    """Clouds may come before the markers of colliders: a towel had fallen out of the window, to the floor below."""
    seen = []
    monkeypatch.setattr(page, "look_from", lambda server, position, at: seen.append((position, at)))
    live = page.LivePage.__new__(page.LivePage)
    names = {"objects": ["towel"], "colliders": ["floor"], "handles": []}
    live.known = SimpleNamespace(names=names.get, values={})
    live.scene = SimpleNamespace(
        positions={}, places={}, starts={}, cloud=lambda name, cloud: None, markers=lambda _: None
    )
    live.server, live._framed, live._begin = None, False, time.monotonic()
    live.scene.positions["towel"] = np.array([[0.0, 0.0, 1.0], [1.0, 1.0, 1.0]])
    live._cloud("towel", None)
    assert not seen
    live.scene.places["floor"] = np.zeros(3)
    live._markers(None)
    live._cloud("towel", None)
    ((_, at),) = seen
    np.testing.assert_allclose(at, (0.5, 0.5, 0.5))
