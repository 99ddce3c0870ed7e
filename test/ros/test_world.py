# SPDX-License-Identifier: Apache-2.0
"""What the thread that simulates does with values, poses and resets, without any message."""

import logging
import re
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from scene_values import COLLIDERS, NAMED, small, values

from cloth_sim_ros.ros.inputs.pose_track import Pose
from cloth_sim_ros.ros.outputs.diagnostics import diagnostics
from cloth_sim_ros.ros.outputs.log import Reported
from cloth_sim_ros.ros.parameters import names
from cloth_sim_ros.ros.time.frame_clock import Pace
from cloth_sim_ros.ros.world import World


@pytest.mark.long
def test_reset_brings_objects_back_and_leaves_colliders_where_their_senders_put_them():
    world = World(small(ball__dimensions=(0.3,)), logging.getLogger("test"))
    assert world.build(world.values)
    start = world.sim.positions("sheet")
    there = Pose((0.0, 0.0, 0.3), (0.0, 0.0, 0.0, 1.0))
    world.tracks["ball"].push(1.0, there, arrival=0.0)
    for _ in range(10):
        world.advance()
    moved = world.sim.positions("sheet")
    assert np.abs(moved - start).max() > 0.1
    world.reset()
    assert np.array_equal(world.sim.positions("sheet"), start)
    assert world.tracks["ball"].pose == there and world.resets == 1
    world.advance()
    pushed = world.sim.positions("sheet")
    assert pushed[:, 2].max() > 0.02, "the ball still reaches into the sheet and pushes it up at once"


def test_the_measured_error_is_in_the_diagnostics():
    world = World(small(), logging.getLogger("test"))
    assert world.build(world.values)
    for _ in range(20):
        world.advance()
    told = {
        each.key: each.value
        for each in diagnostics("cloth_sim", world, Pace(1.0, 1.0, 0.5, 1), False, 0).status[0].values
    }
    page = (Path(__file__).parents[2] / "docs/reference/ros.md").read_text().split("## Diagnostics")[1].split("##")[0]
    words = {word.rpartition(".")[2] for word in re.findall(r"`([^`]+)`", page)}
    assert {key.rpartition(".")[2] for key in told} <= words, "the reference tells all values"
    assert 0.0 < float(told["sheet.error_per_frame"]) < 0.1
    assert 0.0 < float(told["sheet.expected_error"]) < 1.0


def test_a_frame_beyond_its_budget_is_told_where_substeps_are_chosen():
    world = World(small(), logging.getLogger("test"))
    assert world.build(world.values)
    allowed = 1e3 * world.sim.settings.budget * world.sim.settings.frame_dt

    def message(share):
        return diagnostics("cloth_sim", world, Pace(1.0, share * allowed, 0.0, 60), False, 0).status[0].message

    assert "a frame takes 1.5 times solver.budget" in message(1.5)
    assert message(1.1) == "running"
    world.sim.set("solver.substeps", 20)
    assert message(1.5) == "running"
    assert world.build(small(objects=[]))
    assert message(1.5) == "running", "an empty scene has no budget"


def test_an_object_that_goes_bad_is_named_in_log_and_diagnostics(caplog):
    world = World(small(), logging.getLogger("test"))
    assert world.build(world.values)
    arrays, span, _ = world.sim.device_arrays("line")
    rows = arrays.state.velocities[span].numpy()
    rows[5] = np.nan
    arrays.state.velocities[span].assign(rows)
    world.advance()
    status = diagnostics("cloth_sim", world, Pace(1.0, 1.0, 0.5, 1), False, 0).status[0]
    assert status.level == DiagnosticStatus.WARN and "line (1 times)" in status.message
    assert [r.message for r in caplog.records if "put back" in r.message] == [
        "line was not finite or ran away and was put back, at rest, 1 times"
    ]
    assert np.isfinite(world.sim.positions("line")).all()
    world.reset()
    assert diagnostics("cloth_sim", world, Pace(1.0, 1.0, 0.5, 1), False, 0).status[0].level == DiagnosticStatus.OK


def test_a_method_that_needs_more_substeps_than_asked_is_refused_and_the_simulation_goes_on(caplog):
    world = World(small(), logging.getLogger("test"))
    assert world.build(world.values)
    before = world.sim
    assert not world.build(small(solver__method="verlet", solver__substeps=5))
    assert world.sim is before and "solver.substeps is 5 with method 'verlet'" in caplog.text
    assert "the simulation before goes on" in caplog.text
    world.advance()


def build(changes):
    world = World(values(device="cpu", **changes), logging.getLogger("test"))
    assert world.build(world.values)


@pytest.mark.long
def test_what_starts_inside_of_a_collider_or_crosses_itself_is_told_at_once(caplog):
    """A ball of 0.3 m has its middle in the sheet of 5 mm, which can be moved or not. Then it is away, and a rope goes
    through the sheet."""
    apart = {f"{name}__position": (10.0 * k, 10.0, -5.0) for k, name in enumerate(COLLIDERS)}
    build({**apart, "ball__position": (0.0, 0.0, 0.0)})
    told = "sheet starts 0.31 m deep in a collider"
    assert f"{told} and was moved out by up to 0.66 m; start them apart" in caplog.text
    assert "line starts" not in caplog.text and "hard" not in caplog.text
    caplog.clear()
    build({**apart, "ball__position": (0.0, 0.0, 0.0), "sheet__pins": "edges"})
    assert f"{told}, which pushes it out hard; start them apart" in caplog.text and "moved" not in caplog.text
    caplog.clear()
    build({**apart, "line__start": (0.01, 0.02, 0.5), "line__end": (0.01, 0.02, -0.51), "object_contact": True})
    assert "deep in a collider" not in caplog.text
    assert "line intersects itself at the start (1 edges) and may stay so; start it unfolded" in caplog.text


def test_a_loaded_state_brings_its_poses_and_parameters_and_no_old_news(caplog, tmp_path):
    first, second = (World(small(), logging.getLogger("test")) for _ in range(2))
    assert first.build(first.values) and second.build(second.values)
    there = Pose((0.0, 0.0, 0.25), (0.0, 0.0, 0.0, 1.0))
    first.tracks["ball"].push(1.0, there, arrival=0.0)
    assert first.set_live("sheet.stretch_compliance", 1.0 / 300.0, first.values)
    arrays, span, _ = first.sim.device_arrays("line")
    arrays.state.velocities[span].fill_(np.nan)
    for _ in range(5):
        first.advance()
    first.report()
    file, caught = tmp_path / "state.npz", len(caplog.records)
    first.sim.save(file, {"by": "a program"})  # without the notes of a node
    done, sentence, told = second.load(file)
    assert done and sentence == f"the simulation goes on at 0.0833333 s from {file}"
    assert second.tracks["ball"].pose == there and second.poses()["ball"] == there
    assert told == {"sheet.stretch_compliance": 0.0033333334, "ball.position": (0.0, 0.0, 0.25)}
    assert {name: second.in_effect[name] for name in told} == told
    assert first.load(file) == (True, sentence, {"ball.position": (0.0, 0.0, 0.25)}), "the rest is as it was"
    assert second.report()["line"]["recoveries"] > 0
    assert not [each for each in caplog.records[caught:] if "put back" in each.message]
    for world in (first, second):
        world.advance()
    assert first.sim.positions("sheet").tobytes() == second.sim.positions("sheet").tobytes()
    assert second.load(tmp_path / "none.npz")[0] is False


@pytest.mark.parametrize(
    "notes",
    [
        None,
        [1],
        {"node": 5},
        {"node": {"wind": None, "rates": {}, "waiting": {"sheet.mass": 1.0}}},
        {"node": {"wind": ["a"], "rates": {}, "waiting": {}}},
        {"node": {"wind": None, "rates": {"line": [1e9, 0.0]}, "waiting": {}}, "grippers": {}},
        {"node": {"wind": None, "rates": {}, "waiting": {}}, "grippers": 7},
        {"node": {"wind": None, "rates": {}, "waiting": {}}, "grippers": {"g": ["opening", float("nan")]}},
    ],
)
def test_notes_that_no_node_wrote_are_none(tmp_path, notes):
    world = World(small(), logging.getLogger("test"))
    assert world.build(world.values)
    before = dict(world.in_effect)
    world.sim.save(tmp_path / "state.npz", notes)
    assert world.load(tmp_path / "state.npz") == (
        True,
        f"the simulation goes on at 0 s from {tmp_path / 'state.npz'}",
        {},
    )
    assert world.in_effect == before and world.notes()["node"]["wind"] is None and world.grippers.asked == {}
    world.advance()


@pytest.mark.long
def test_a_hand_that_should_hold_something_and_does_not_is_told(caplog):
    far = small(handles=("hand",))
    rows = names.prefixed("hand", names.HANDLE)
    far |= {name: row.default for name, row in rows.items()} | {"hand.attached": True, "hand.position": (0, 0, 7.0)}
    world = World(far, logging.getLogger("test"))
    assert world.build(world.values)
    assert "hand holds nothing: the nearest particle is of line, 6 m away, and lies beyond its reach" in caplog.text
    world.sim.set("hand.object", "sheet")
    assert "the nearest particle is of sheet, 6.81 m away" in world.grasps.set(world.sim, "hand", True)[1]
    for corner, said in ((-1, "away, and is pinned or held already"), (0, "hand holds 1 particle")):
        world.sim.set_handle_pose("hand", world.sim.positions("sheet")[corner], sweep=False)
        assert said in world.grasps.set(world.sim, "hand", True)[1]


def test_a_slider_that_is_moved_does_not_fill_the_log(caplog):
    """Each place of it is another value, with other bounds of the substeps."""
    caplog.set_level(logging.INFO)
    world = World(small(**{"wind.enabled": False}), logging.getLogger("test"))
    assert world.build(world.values)
    caplog.clear()
    bounds = set()
    for error in np.geomspace(1e-2, 1e-4, 20):
        assert world.set_live("solver.error", float(error), {**world.values, "solver.error": float(error)})
        assert world.set_live("wind.velocity", (float(error), 0.0, 0.0), world.values)
        bounds.add(world.sim.choices["sheet"].least)
    assert len(bounds) > 5

    def said(beginning: str) -> list[str]:
        return [text for record in caplog.records if (text := record.getMessage()).startswith(beginning)]

    assert len(said("wind.velocity is noted for the next rebuild")) == 1 and not said("sheet is computed by")
    for _ in range(2):
        world.report()
    assert said("sheet is computed by") == [f"sheet {world.sim.choices['sheet'].reason}"], "where it ends is told"


@pytest.mark.parametrize(
    ("changes", "is_told"),
    [({}, True), ({"line__position": (0.0, 0.0, 50.0)}, True), ({"line__position": (9.0, 0.0, 0.0)}, False)],
)
def test_objects_that_may_meet_and_pass_through_one_another_are_told_once(caplog, changes, is_told):
    """The rope may fall on the sheet from above, and not from 9 m aside."""
    caplog.set_level(logging.INFO)
    world = World(small(**changes), logging.getLogger("test"))
    assert world.build(world.values) and world.build(world.values)
    told = [record for record in caplog.records if "object_contact" in record.message]
    sentence = "sheet and line pass through one another where they meet, as object_contact is false; "
    assert [(each.levelno, each.message) for each in told] == is_told * [
        (logging.INFO, sentence + "true keeps objects apart")
    ]


@pytest.mark.parametrize(
    ("setting", "level", "remedy"),
    [
        ({"solver__error": 1.0}, logging.INFO, "nothing need be done"),
        ({"solver__substeps": 6}, logging.WARNING, "raise solver.substeps, or set it to 0"),
    ],
)
def test_frames_that_are_computed_again_are_a_warning_only_where_substeps_are_set(caplog, setting, level, remedy):
    """The sheet starts in the ball and leaves it fast."""
    caplog.set_level(logging.INFO)
    world = World(small(**setting), logging.getLogger("test"))
    assert world.build(world.values)
    for _ in range(12):
        world.advance()
    times = world.report()["sheet"]["redone"]
    (record,) = [each for each in caplog.records if "computed again" in each.message]
    sentence = f"{times} frames of sheet were computed again with more substeps, as it moved hard; {remedy}"
    assert times > 0 and (record.levelno, record.message) == (level, sentence)


def test_substeps_that_are_picked_anew_each_second_do_not_fill_the_log(caplog):
    caplog.set_level(logging.INFO)
    world = World(small(), logging.getLogger("test"))
    assert world.build(world.values)
    substeps = set()
    for _ in range(6):
        for _ in range(5):
            world.advance()
        world.report()
        substeps.add(world.sim.choices["sheet"].substeps)
    said = [record.getMessage() for record in caplog.records if record.getMessage().startswith("sheet is computed by")]
    assert len(substeps) > 1 and len(said) == len(set(said)) <= 2, said


def test_stitches_that_break_are_counted_in_log_and_diagnostics(caplog):
    """The rope hangs from a corner of the sheet by a stitch that bears less than its weight."""
    caplog.set_level(logging.INFO)
    rows = names.scene_rows({**NAMED, "seams": ("tie",)})
    tie = {"first": "sheet", "second": "line", "first_particles": (0,), "second_particles": (0,), "strength": 1e-3}
    given = {name: row.default for name, row in rows.items() if name.startswith("tie.")} | {"seams": ("tie",)}
    given |= {f"tie.{name}": value for name, value in tie.items()} | {"line.pins": "none"}
    world = World(small(ball__position=(0, 0, -9), sheet__pins="edges") | given, logging.getLogger("test"))
    assert world.build(world.values)
    for _ in range(240):  # the stitch closes first
        world.advance()
    for _ in range(2):
        status = diagnostics("/cloth_sim", world, Pace(1.0, 1.0, 0.5, 1), False, 0).status[0]
    assert {each.key: each.value for each in status.values}["tie.broken"] == "1"
    said = [record.message for record in caplog.records if "stitch" in record.message]
    assert said == ["1 stitch of tie is broken: loads were larger than tie.strength, 0.001 N"]


@pytest.mark.parametrize(("compliance", "level"), [(0.0, logging.WARNING), (0.01, logging.INFO)])
def test_what_a_soft_finger_lets_in_is_no_warning(caplog, compliance, level):
    caplog.set_level(logging.INFO)
    measures = {"max_penetration": 0.006, "particle_penetration": 0.0, "recoveries": 0, "redone": 0}
    soft = {"ball.compliance": compliance}
    Reported(logging.getLogger("test")).report({"sheet": measures}, small() | soft)
    (record,) = caplog.records
    assert record.levelno == level and "0.006 m deep in a collider between its particles; " in record.message
    assert ("one with a compliance gives way like that; else more substeps" in record.message) == (compliance > 0.0)
