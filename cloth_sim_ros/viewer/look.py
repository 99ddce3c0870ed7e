# SPDX-License-Identifier: Apache-2.0
"""Look of the page: light, shadow, ground and camera."""

from __future__ import annotations

import numpy as np
import viser

BRAND = (46, 112, 176)
FIELD_OF_VIEW = 0.7  # [rad]
# Width over height of a window below which the panel covers its lower half, as on a phone upright. Its width alone
# tells nothing, as phones have up to three pixels where a desktop has one.
NARROW = 0.7
RAISED, FARTHER = 0.2, 1.8  # shifts for a narrow window: up by this share of it, and farther away by this factor


LINES = {  # of the ground, and of any plane
    "cell_size": 0.1,
    "section_size": 0.5,
    "cell_color": (226, 229, 234),
    "section_color": (196, 202, 210),
    "fade_distance": 12.0,
    "shadow_opacity": 0.28,
}


def furnish(server: viser.ViserServer) -> None:
    """Add light from the sky, one lamp with shadow, a ground with lines at every half metre, and a docked panel."""
    scene, gui = server.scene, server.gui
    scene.set_up_direction("+z")
    scene.configure_environment_map("studio", environment_intensity=0.45)
    scene.configure_default_lights(enabled=True, cast_shadow=True)
    scene.add_light_directional("/lamp", intensity=0.6, position=(-1.5, -2.5, 1.5))  # shows folds of what hangs
    scene.world_axes.visible = False
    scene.add_grid("/ground", infinite_grid=True, **LINES)
    gui.configure_theme(brand_color=BRAND, show_logo=False, show_share_button=False, control_width="large")
    server.initial_camera.fov = FIELD_OF_VIEW
    server.on_client_connect(lambda client: welcome(server, client))
    gui.set_panel_label("cloth_sim")
    gui.main_panel.dock_right()


def look_from(server: viser.ViserServer, position: tuple, at: tuple) -> None:
    """Place the camera of all present and future visitors at `position` [m], looking at `at` [m]."""
    server.initial_camera.position, server.initial_camera.look_at = position, at
    for client in server.get_clients().values():
        _frame(client, position, at)


def welcome(server: viser.ViserServer, client: viser.ClientHandle) -> None:
    """Place the camera of a new visitor, and again when the window becomes narrow or wide."""
    begin = server.initial_camera
    was_narrow = _is_narrow(client.camera)

    def look_again(camera: viser.CameraHandle) -> None:
        nonlocal was_narrow
        if _is_narrow(camera) != was_narrow:
            was_narrow = not was_narrow
            _frame(client, begin.position, begin.look_at)

    client.camera.on_update(look_again)
    _frame(client, begin.position, begin.look_at)


def _is_narrow(camera: viser.CameraHandle) -> bool:
    return camera.image_width < NARROW * camera.image_height


def _frame(client: viser.ClientHandle, position: tuple, at: tuple) -> None:
    """Place the camera of one client; in a narrow window its target stands above the panel."""
    position, at = np.asarray(position, dtype=float), np.asarray(at, dtype=float)
    if _is_narrow(client.camera):
        way = FARTHER * (at - position)
        across = np.cross(way, (0.0, 0.0, 1.0))
        across = across if across.any() else np.array((1.0, 0.0, 0.0))  # straight down or up
        up = np.cross(across, way)
        down = -2.0 * RAISED * np.tan(0.5 * FIELD_OF_VIEW) * np.linalg.norm(way) * up / np.linalg.norm(up)
        position, at = at - way + down, at + down
    client.camera.position, client.camera.look_at = position, at
