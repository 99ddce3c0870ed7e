# SPDX-License-Identifier: Apache-2.0
"""What comes by a browser's websocket reaches the node, and the browser is shown what came of it."""

import numpy as np
import pytest

SCENE = """
/**:
  ros__parameters:
    objects: [cloth]
    colliders: [far]
    handles: [hand]
    cloth:
      {type: cloth, resolution: [6, 5], size: [0.5, 0.4], pins: top, position: [0, 0, 2], damping: 0.01, tear_strain: 9,
       bending: dihedral, bend_compliance: 76900.0}
    hand: {reach: [0.03], position: [0.4, 0, 1]}
    far: {shape: sphere, dimensions: [1.0], position: [0, 0, -9]}
    wind: {enabled: true}
    solver: {global_damping: 2.0}
"""
MESH = "/page/cloth/0"  # its front, in one of two tones


@pytest.fixture
def shown(start, viewer):
    """The viewer, which shows SCENE."""
    start(SCENE).ready()
    viewer.shows("cloth")
    viewer.until(lambda: viewer.page._content.visible)
    return viewer


@pytest.fixture
def browser(shown, browser_of):
    """A browser that has the page open."""
    found = browser_of(shown)
    labels = lambda: {each.get("label") for each in found.gui.values()}  # noqa: E731, it fills
    shown.until(lambda: found.look() or MESH in found.meshes and "x m/s" in labels())
    return found


def test_a_hundred_moves_of_sliders_reach_the_node_and_all_browsers_show_them(shown, browser, browser_of, client):
    other = browser_of(shown)
    for k in range(100):
        label, place = (("x m/s", 0.1 * k), ("stretch compliance", -5.0 + 0.03 * k))[k % 2]
        browser.slide(label, place)
        shown.spin_once()
    shown.until(lambda: browser.says("0.00933 m/N") and browser.says("76900 1/(N m)"))  # 10^-2.03
    shown.until(lambda: other.says("0.00933 m/N"))
    shown.until(lambda: client.get("cloth.stretch_compliance") == pytest.approx(10**-2.03, rel=1e-2))
    shown.until(lambda: client.get("wind.velocity")[0] == pytest.approx(9.8))
    assert browser.gui[browser.control("x m/s")]["kind"] == "GuiSliderMessage"
    browser.slide("x m/s", 20.0)  # as typed beside the slider
    shown.until(lambda: browser.says("wind.velocity: 20 is typed; allowed is -15 to 15, and 15 is taken."))
    shown.until(lambda: client.get("wind.velocity")[0] == 15.0)


def test_keys_reach_the_node_and_the_page_says_what_came_of_them(shown, browser):
    for label, words in (
        ("step", "pause it first"), ("pause or go on", "paused"), ("step", "one frame done"),
        ("reset", "at the start"), ("pause or go on", "running"),
    ):  # fmt: skip
        browser.press(label)
        shown.until(lambda words=words: browser.says(words))


def test_twenty_drags_move_the_cloth_that_is_seen(shown, browser, client):
    for k in range(20):
        side = (-1) ** k
        corner = browser.meshes[MESH]["vertices"][0].astype(float)
        browser.drag(MESH, "start", corner, corner)
        shown.until(lambda: shown.page.grasp.state == "holding" and client.get("hand.attached"))
        browser.drag(MESH, "update", corner, corner + (0.0, side, 0.0))
        shown.until(lambda c=corner, s=side: browser.look() or s * (browser.meshes[MESH]["vertices"][0] - c)[1] > 0.01)
        browser.drag(MESH, "end", corner, corner + (0.0, side, 0.0))
        shown.until(lambda: shown.page.grasp.state == "idle" and not client.get("hand.attached"))
        shown.until(lambda: browser.look() or browser.says("hand holds nothing"))


def test_two_clicks_cut_the_cloth_and_fewer_triangles_are_seen(shown, browser):
    eye = np.array([0.0, -2.0, 1.8])

    def seen() -> int:
        browser.look()
        return sum(len(browser.meshes.get(f"/page/cloth/{k}", {}).get("faces", ())) for k in (0, 1))  # those in front

    triangles = shown.page.scene.triangles
    whole = len(triangles["cloth"])
    shown.until(lambda: seen() == whole)
    positions = shown.page.scene.positions["cloth"]
    for vertex in (6, 11):
        browser.click(MESH, eye, positions[vertex])
    shown.until(lambda: browser.says("A cut goes through cloth."))
    shown.until(lambda: seen() == len(triangles["cloth"]) < whole)
