# SPDX-License-Identifier: Apache-2.0
"""The camera of a narrow window: what it looks at stands above the panel, which covers the lower half."""

from types import SimpleNamespace

import numpy as np
import pytest

from cloth_sim_ros.viewer.look import FIELD_OF_VIEW, look_from

POSITION, AT = np.array((1.0, -2.0, 1.5)), np.array((0.1, 0.2, 0.3))


def framed(width):
    """Camera of a client whose window is as wide, after look_from."""
    client = SimpleNamespace(camera=SimpleNamespace(image_width=width, position=None, look_at=None))
    server = SimpleNamespace(initial_camera=SimpleNamespace(), get_clients=lambda: {0: client})
    look_from(server, tuple(POSITION), tuple(AT))
    return client.camera


def height_of(point, camera):
    """Height of a point in the window: 0 at its lower edge, 1 at its upper."""
    way = camera.look_at - camera.position
    across = np.cross(way, (0.0, 0.0, 1.0))
    up = np.cross(across, way) / np.linalg.norm(np.cross(across, way))
    off, ahead = point - camera.position, way / np.linalg.norm(way)
    return 0.5 + 0.5 * (off @ up) / (off @ ahead) / np.tan(0.5 * FIELD_OF_VIEW)


@pytest.mark.parametrize("width", [360, 420])
def test_the_scene_stands_in_the_upper_half_of_a_narrow_window(width):
    camera = framed(width)
    assert 0.6 < height_of(AT, camera) < 0.8
    ways = camera.look_at - camera.position, AT - POSITION
    assert np.cross(*ways) == pytest.approx(np.zeros(3), abs=1e-9), "it looks from elsewhere"


def test_a_wide_window_is_framed_as_it_was_set():
    camera = framed(1280)
    assert camera.position == pytest.approx(POSITION) and camera.look_at == pytest.approx(AT)
