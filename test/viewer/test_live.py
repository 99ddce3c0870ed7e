# SPDX-License-Identifier: Apache-2.0
"""The viewer beside a real node: what topics say is drawn, and what is done in the browser reaches the node."""

import numpy as np
import pytest
import rclpy
from client import fields
from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import PointCloud2

from cloth_sim_ros.demo.audience import Audience
from cloth_sim_ros.drawing.tube import SIDES
from cloth_sim_ros.viewer.drawing import Click, Drag
from cloth_sim_ros.viewer.live.grasp import LONGEST, NONE_FREE
from cloth_sim_ros.viewer.live.page import KEYS
from cloth_sim_ros.viewer.live.remote import NEWEST_ONLY
from cloth_sim_ros.viewer.live.scene import SHOWN

SCENE = """
/**:
  ros__parameters:
    objects: [cloth, rope]
    colliders: [ball]
    handles: [hand]
    cloth:
      {type: cloth, resolution: [6, 5], size: [0.5, 0.4], pins: top, position: [0, 0, 2], damping: 0.01, tear_strain: 9}
    rope: {type: rope, segments: 7, start: [0, 0.5, 2], end: [1, 0.5, 2], pins: start, radius: 0.02}
    ball: {shape: sphere, dimensions: [0.1], position: [0, 1, 0.5]}
    hand: {reach: [0.03], position: [0.4, 0, 1]}
    wind: {enabled: true}
    solver: {global_damping: 2.0}
"""
ROOM = (
    SCENE.replace("[ball]", "[floor, ball, box, bar]")
    + """
    floor: {shape: plane}
    box: {shape: box, dimensions: [0.1, 0.2, 0.3], position: [1, 1, 0.2], orientation: [0, 0, 0.6, 0.8]}
    bar: {shape: capsule, dimensions: [0.4, 0.05], position: [-1, 0, 0.5]}
"""
)
BARE = """
/**:
  ros__parameters:
    objects: [cloth]
    cloth: {type: cloth, resolution: [6, 5], size: [0.5, 0.4], pins: top, position: [0, 0, 2], damping: 0.01}
"""
CORNER = 0  # of the free edge, at (-0.25, -0.2, 2) when it lies flat


@pytest.fixture
def shown(start, viewer):
    """The viewer, which shows SCENE."""
    start(SCENE).ready()
    viewer.shows("cloth", "rope")
    viewer.until(lambda: "ball/0" in viewer.page.scene.bodies)
    return viewer


def particles(client, name: str) -> np.ndarray:
    """An object's next particles (N, 3), as another node hears them."""
    clouds = client.listen(PointCloud2, f"/cloth_sim/{name}/particles", 1)
    client.until(lambda: len(clouds) > 1)
    return fields(clouds[-1])[:, :3]


@pytest.mark.long
def test_objects_are_where_their_particles_are(shown, client):
    shown.page.press("pause")
    shown.until(lambda: shown.page.status == "paused")
    stamps = dict(shown.page.scene.stamps)
    shown.until(lambda: all(shown.page.scene.stamps[name] > stamps[name] for name in stamps))
    cloth, rope = shown.page.drawing.handles["cloth"], shown.page.drawing.handles["rope"]
    # Both sides, and the hem around them; the particles lie between.
    assert cloth.vertices.shape == (60, 3) and cloth.faces.shape == (2 * 2 * 5 * 4 + 2 * 2 * (5 + 4), 3)
    sides = cloth.vertices.reshape(2, 30, 3)
    assert np.allclose(sides.mean(axis=0), particles(client, "cloth"), atol=1e-6)
    thickness = client.get("cloth.thickness")
    assert np.allclose(np.linalg.norm(sides[0] - sides[1], axis=1), 2.0 * SHOWN * thickness, rtol=1e-3)
    assert rope.vertices.shape == (8 * SIDES + 2, 3)
    rings = rope.vertices[:-2].reshape(8, SIDES, 3)
    points = particles(client, "rope")
    assert np.abs(rings.mean(axis=1) - points).max() < 1e-6
    assert np.allclose(np.linalg.norm(rings - points[:, None], axis=2), 0.02, atol=1e-6)


@pytest.mark.long
def test_colliders_and_handles_are_where_they_are_and_as_large(start, viewer):
    start(ROOM).ready()
    viewer.shows("cloth", "rope")
    bodies = viewer.page.scene.bodies
    viewer.until(lambda: "bar/2" in bodies)
    assert set(bodies) == {"floor/0", "ball/0", "box/0", "bar/0", "bar/1", "bar/2", "hand/0"}
    assert np.allclose(np.linalg.norm(bodies["ball/0"].vertices - (0, 1, 0.5), axis=1), 0.1, atol=1e-6)
    hand = bodies["hand/0"].vertices - (0.4, 0, 1)  # whose fingers are where it grasps
    assert np.linalg.norm(hand, axis=1).min() < 0.03 and hand[:, 2].min() > -0.01
    corners = np.array([(x, y, z) for x in (-0.05, 0.05) for y in (-0.1, 0.1) for z in (-0.15, 0.15)])
    c, s = 0.8**2 - 0.6**2, 2 * 0.8 * 0.6  # of twice the half angle
    expected = corners @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + (1, 1, 0.2)
    found = bodies["box/0"].vertices
    assert np.linalg.norm(found[:, None] - expected, axis=2).min(axis=0).max() < 1e-6 and len(found) == 8
    tube = bodies["bar/0"].vertices - (-1, 0, 0.5)
    assert np.allclose(np.abs(tube[:, 2]), 0.2) and np.linalg.norm(tube[:, :2], axis=1).max() == pytest.approx(0.05)
    for name, z in (("bar/1", 0.3), ("bar/2", 0.7)):
        assert np.allclose(bodies[name].vertices.mean(axis=0), (-1, 0, z), atol=1e-6)
    assert np.allclose(bodies["floor/0"].position, (0, 0, -0.005))
    assert not viewer.page.scene._ground.visible  # the floor is one


@pytest.mark.long
def test_a_slider_sets_its_parameter(shown, client):
    sliders = shown.page.panel.sliders
    for name, value in {
        "cloth.stretch_compliance": 1e-2, "rope.bend_compliance": None, "rope.winch.pay_out": None,
        "ball.static_friction": 2.5, "solver.error": 3e-3, "solver.budget": 1.0, "solver.iterations": 3,
        "cloth.damping": 0.0,
    }.items():  # fmt: skip
        if value is None:
            assert name not in sliders  # the rope does not bend, and has no winch
            continue
        sliders[name][0].slide(value)
        shown.until(lambda name=name: not settled(shown, name))
        shown.until(lambda name=name: settled(shown, name))
        assert client.get(name) == pytest.approx(value, rel=2e-2)
    sliders["wind.velocity"][1].slide(-3.0)
    shown.until(lambda: not settled(shown, "wind.velocity"))
    shown.until(lambda: settled(shown, "wind.velocity"))
    assert list(client.get("wind.velocity")) == pytest.approx([0.0, -3.0, 0.0])


def settled(viewer, name: str) -> bool:
    """Whether nothing is on its way to a parameter."""
    panel = viewer.page.panel
    return name not in panel._asked and name not in panel._waiting


def test_a_hundred_moves_of_a_slider_end_at_the_last(shown, client):
    slider = shown.page.panel.sliders["wind.velocity"][0]
    for k in range(100):
        slider.slide(0.1 * k)
        shown.spin_once()
    shown.until(lambda: settled(shown, "wind.velocity") and shown.page.known.values["wind.velocity"][0] > 9.8)
    assert client.get("wind.velocity")[0] == pytest.approx(9.9)


def test_the_sliders_of_the_wind_show_what_a_topic_blows_and_set_the_rest_along(shown, client):
    sliders = shown.page.panel.sliders["wind.velocity"]
    client.blow((0.0, 1.5, -0.5))
    shown.until(lambda: sliders[1]._slider.value == pytest.approx(1.5, abs=0.1))
    assert [slider._slider.value for slider in sliders] == pytest.approx([0.0, 1.5, -0.5])
    sliders[0].slide(3.0)
    shown.until(lambda: not settled(shown, "wind.velocity"))
    shown.until(lambda: settled(shown, "wind.velocity"))
    assert list(client.get("wind.velocity")) == pytest.approx([3.0, 1.5, -0.5])


@pytest.mark.long
def test_a_slider_follows_what_others_set(shown, client):
    assert client.set("cloth.static_friction", 1.25).successful
    slider = shown.page.panel.sliders["cloth.static_friction"][0]
    shown.until(lambda: slider._slider.value == pytest.approx(1.25))
    assert client.get("cloth.static_friction") == 1.25


@pytest.mark.long
def test_twenty_drags_pull_by_a_spring_with_the_largest_force_and_let_go(shown, client):
    page, felt = shown.page, client.listen(WrenchStamped, "/cloth_sim/handles/hand/wrench", NEWEST_ONLY)
    for k in range(20):
        most = (0.5, 2.0)[k % 2]
        page._pull.slide(most)
        shown.until(lambda most=most: page._pull.value == pytest.approx(most, rel=0.1))
        corner = page.scene.positions["cloth"][CORNER].astype(float)
        pointer = corner + (0.0, 1.0 * (-1) ** k, 0.0)  # far beyond what the spring reaches
        page.dragged(Drag("cloth", "start", corner, corner))
        shown.until(lambda: page.grasp.state == "holding")
        page.dragged(Drag("cloth", "update", corner, pointer))
        shown.until(lambda c=corner, s=(-1) ** k: s * (page.grasp.vertex - c)[1] > 0.01)
        felt.clear()
        for _ in range(60):
            shown.spin_once(), client.spin(0.005)
        forces = [np.linalg.norm((each.wrench.force.x, each.wrench.force.y, each.wrench.force.z)) for each in felt]
        assert forces and 0.0 < max(forces) < 1.5 * most, "the vertex moves on between two messages"
        page.dragged(Drag("cloth", "end", corner, pointer))
        shown.until(lambda: page.grasp.state == "idle")
        assert client.get("hand.attached") is False
        assert client.get("hand.compliance") == pytest.approx(LONGEST / page._pull.value, rel=1e-6)


def test_two_clicks_cut_what_tears_between_them(shown):
    page, eye = shown.page, np.array([0.0, -2.0, 1.8])

    def click(name: str, vertex: int) -> None:
        way = page.scene.positions[name][vertex] - eye
        page.clicked(Click(name, eye, way / np.linalg.norm(way)))

    click("rope", 3)
    assert page.status == "rope cannot be cut. A cloth can with a tear_strain above 0."
    click("cloth", 6)
    assert page.status == "Click where the cut of cloth ends."
    click("cloth", 11)
    assert page.status == "A cut goes through cloth."
    drawn = lambda: page.drawing.handles.get("cloth")  # noqa: E731, it is drawn anew
    shown.until(lambda: drawn() and len(page.scene.triangles["cloth"]) <= 2 * 5 * 4 - 2 * 3)
    in_front = (drawn().faces < len(page.scene.positions["cloth"])).all(axis=1).sum()
    assert in_front == len(page.scene.triangles["cloth"])


@pytest.mark.long
def test_an_object_that_becomes_another_one_is_drawn_anew(shown, client):
    page = shown.page
    corner = page.scene.positions["cloth"][29].astype(float)
    page.dragged(Drag("cloth", "start", corner, corner))
    assert client.set("cloth.resolution", [4, 3]).successful and client.set("rope.segments", 3).successful
    shown.until(lambda: page.drawing.handles.get("cloth") and len(page.drawing.handles["cloth"].vertices) == 24)
    shown.until(
        lambda: page.drawing.handles.get("rope") and len(page.drawing.handles["rope"].vertices) == 4 * SIDES + 2
    )
    shown.until(lambda: page.grasp.state == "idle")
    assert len(page.scene.triangles["cloth"]) == 2 * 3 * 2


def test_buttons_call_the_services(shown, client, tmp_path):
    page = shown.page
    assert client.set("state_file", str(tmp_path / "state.npz")).successful
    for label, answer in {
        "step": "pause it first", "pause": "paused", "save": "is saved in", "load": "goes on at",
        "reset": "at the start", "go on": "running",
    }.items():  # fmt: skip
        page.press(label)
        shown.until(lambda answer=answer: answer in page.status)
    assert (tmp_path / "state.npz").exists()


def test_keys_pause_step_and_reset(shown):
    page, pressed = shown.page, dict(zip(KEYS, shown.page._commands, strict=True))
    assert {command.hotkey for command in pressed.values()} == {"space", "N", "R"}
    for key, answer in (("space", "paused"), ("N", "one frame done"), ("space", "running"), ("R", "at the start")):
        for trigger in pressed[key]._impl.trigger_cb:
            trigger(None)
        shown.until(lambda answer=answer: answer in page.status)


def test_a_scene_is_chosen_where_a_demonstration_runs(shown):
    demo = Audience(["cloth"], "towel", ["flag", "towel"])
    choice, spin = shown.page._scene, lambda: rclpy.spin_once(demo, timeout_sec=0.005)
    try:
        shown.until(lambda: spin() or choice._choice.visible)
        assert choice._choice.options == ("flag", "towel") and choice._choice.value == "towel"
        choice.choose("flag")
        shown.until(lambda: spin() or demo.scene == "flag")
    finally:
        demo.destroy_node()


def test_curves_hold_what_the_node_reports(shown):
    curves = shown.page.curves
    assert set(curves) == {"pace", "strain", "error", "tension", "force"}
    assert curves["strain"].labels == ("cloth", "rope") and curves["tension"].labels == ("rope/start", "rope/end")

    def last(key: str) -> np.ndarray:
        return np.array([row[-1] if len(row) else np.nan for row in curves[key].data[1:]])

    # The rope of 0.2 kg comes to hang from its start, and its end holds nothing.
    shown.until(lambda: len(curves["pace"].data[1]) > 1 and abs(last("tension")[0] - 0.2 * 9.81) < 0.02, timeout=60.0)
    assert abs(last("tension")[1]) < 1e-3
    assert last("pace")[0] > 0.0 and (last("strain") >= 0.0).all()


def test_a_drag_that_is_given_up_says_whether_anything_was_held(shown):
    corner, grasp = shown.page.scene.positions["cloth"][CORNER], shown.page.grasp
    for state, said in (("choosing", "cloth was not grasped."), ("holding", "cloth is not held any more.")):
        shown.page.dragged(Drag("cloth", "start", corner, corner))
        grasp.state, grasp._vertex = state, 10**6  # the cloth has fewer particles now
        grasp.advance()
        assert (shown.page.status, grasp.state) == (said, "idle")


def test_without_a_handle_the_page_says_what_is_missing(start, viewer):
    start(BARE).ready()
    viewer.shows("cloth")
    corner = viewer.page.scene.positions["cloth"][CORNER]
    viewer.page.dragged(Drag("cloth", "start", corner, corner))
    assert viewer.page.status == NONE_FREE
    assert set(viewer.page.curves) == {"pace", "strain", "error"}


def test_a_node_that_goes_is_waited_for(start, viewer):
    node = start(BARE).ready()
    viewer.shows("cloth")
    node.end()
    viewer.until(lambda: "has gone" in viewer.page.status)
    assert not viewer.page.drawing.handles
    start(SCENE).ready()
    viewer.shows("cloth", "rope")


@pytest.mark.long
def test_a_node_that_compiles_says_so_and_shows_no_sliders_until_it_runs(start, viewer, tmp_path, monkeypatch):
    monkeypatch.setenv("WARP_CACHE_PATH", str(tmp_path))
    start(BARE)
    viewer.until(lambda: viewer.page is not None and "compiling kernels" in viewer.page.status)
    assert not viewer.page._content.visible and "so far" in viewer.page.status
    viewer.until(lambda: viewer.page._content.visible)
    assert viewer.page.status == "/cloth_sim is there."
    viewer.shows("cloth")


def test_a_node_in_a_namespace_is_found_by_its_name(start, viewer_of):
    start(BARE, "-r", "__ns:=/robot").ready()
    viewer = viewer_of("/robot/cloth_sim")
    viewer.shows("cloth")
    assert len(viewer.page.scene.positions["cloth"]) == 30
    viewer.page.panel.sliders["cloth.static_friction"][0].slide(1.5)
    viewer.until(lambda: not settled(viewer, "cloth.static_friction"))
    viewer.until(lambda: settled(viewer, "cloth.static_friction"))
    viewer.page.press("pause")
    viewer.until(lambda: viewer.page.status == "paused")
