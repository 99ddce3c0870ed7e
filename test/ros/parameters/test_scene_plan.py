# SPDX-License-Identifier: Apache-2.0
"""Parameter values become the scene, the settings and the device that they describe."""

import dataclasses

import numpy as np
import pytest
from scene_values import NAMED, values
from visualization_msgs.msg import Marker

from cloth_sim_ros import parameters as table
from cloth_sim_ros.ros.inputs.pose_track import Pose
from cloth_sim_ros.ros.outputs.colliders import markers_of
from cloth_sim_ros.ros.parameters import names
from cloth_sim_ros.ros.parameters.plan import make_plan, material_values
from cloth_sim_ros.sim import (
    Box,
    Capsule,
    Cloth,
    Mesh,
    Plane,
    Rope,
    Settings,
    SignedDistance,
    Simulation,
    Sphere,
    Winch,
)  # fmt: skip
from cloth_sim_ros.sim.mesh_file import load_mesh
from cloth_sim_ros.sim.scene.materials import FABRICS


@pytest.mark.long
def test_the_defaults_make_a_simulation():
    plan = make_plan(values())
    assert not plan.problems and plan.scene.wind is None
    assert plan.settings == Settings()
    assert Simulation(plan.scene, plan.settings, device="cpu").time == 0.0


def test_dimensions_follow_solid_primitive():
    colliders = make_plan(values()).scene.colliders
    assert isinstance(colliders["ball"], Sphere) and colliders["ball"].radius == 0.3
    assert isinstance(colliders["rod"], Capsule)
    assert (colliders["rod"].half_length, colliders["rod"].radius) == (0.4, 0.1)
    assert isinstance(colliders["crate"], Box) and colliders["crate"].half_extents == (0.1, 0.2, 0.3)
    assert isinstance(colliders["ground"], Plane)


def test_presence_is_explicit():
    objects = make_plan(values()).scene.objects
    assert isinstance(objects["sheet"], Cloth) and objects["sheet"].shear_compliance == 3e-3
    assert isinstance(objects["line"], Rope)
    assert objects["sheet"].bend_compliance is None and objects["line"].bend_compliance is None
    changed = make_plan(
        values(sheet__shear=False, sheet__bending="dihedral", line__bending="angle", wind__enabled=True)
    ).scene
    assert changed.objects["sheet"].shear_compliance is None
    assert (changed.objects["sheet"].bending, changed.objects["sheet"].bend_compliance) == ("dihedral", 1.0)
    assert changed.objects["line"].bend_compliance == 100.0
    assert changed.wind is not None


def test_a_moved_collider_is_built_where_it_is():
    turned = Pose((1.0, 2.0, 3.0), (1.0, 0.0, 0.0, 0.0))
    moved = make_plan(values()).with_poses({"ball": turned, "ground": turned}).scene.colliders
    for name in ("ball", "ground"):
        assert (moved[name].position, moved[name].orientation) == (turned.position, turned.orientation)
    assert moved["ground"].normal == pytest.approx((0.0, 0.0, -1.0))


def test_a_file_becomes_a_collider(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    trimesh = pytest.importorskip("trimesh")
    file = str(tmp_path / "box.stl")
    trimesh.creation.box((100, 200, 300)).export(file)
    of_file = {"mesh": file, "scale": 1e-3, "position": (1.0, 0.0, 0.0), "static_friction": 0.9}
    for shape, kind in (("mesh", Mesh), ("signed_distance", SignedDistance)):
        plan = make_plan(values(ball__shape=shape, **{f"ball__{name}": value for name, value in of_file.items()}))
        ball = plan.scene.colliders["ball"]
        assert not plan.problems and isinstance(ball, kind) and ball.static_friction == 0.9
        assert ball.reach() == pytest.approx(np.sqrt(0.05**2 + 0.1**2 + 0.15**2), rel=0.05)
        moved = plan.with_poses({"ball": Pose((1.0, 2.0, 3.0), (1.0, 0.0, 0.0, 0.0))}).scene.colliders["ball"]
        assert moved.position == (1.0, 2.0, 3.0) and moved.content == ball.content
        (drawn,) = markers_of("ball", ball, Pose((1.0, 2.0, 3.0), (1.0, 0.0, 0.0, 0.0)))
        assert (drawn.type, drawn.mesh_resource) == (Marker.MESH_RESOURCE, f"file://{file}")
        assert (drawn.scale.x, drawn.pose.position.y) == (1e-3, 2.0)
        for path, sentence in (
            ("", f"ball.mesh is empty; a {shape} has a file"),
            ("/nowhere.stl", "ball.mesh is '/nowhere.stl'; no such file is in '/'; allowed are .obj, "),
        ):
            problems = make_plan(values(ball__shape=shape, ball__mesh=path)).problems
            assert problems.keys() == {"ball"} and problems["ball"].startswith(sentence)
    trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]).export(file)
    sentence = make_plan(values(ball__shape="mesh", ball__mesh=file)).problems["ball"]
    assert sentence.startswith("ball: Mesh of '") and "is open at 3 edges" in sentence


def test_what_has_no_file_is_drawn_by_its_triangles_or_cells():
    trimesh = pytest.importorskip("trimesh")
    box, pose = trimesh.creation.box((0.1, 0.2, 0.3)), Pose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    (drawn,) = markers_of("it", Mesh(box.vertices, box.faces, scale=2.0), pose)
    assert drawn.type == Marker.TRIANGLE_LIST and len(drawn.points) == 36
    assert max(point.z for point in drawn.points) == pytest.approx(0.3)
    ball = np.linalg.norm(np.indices((81,) * 3) - 40.0, axis=0) - 20.0
    (drawn,) = markers_of("it", SignedDistance(0.01 * ball, (-0.4,) * 3, 0.01), pose)
    assert drawn.type == Marker.CUBE_LIST and drawn.scale.x == pytest.approx(0.03)
    away = [np.linalg.norm((point.x, point.y, point.z)) for point in drawn.points]
    assert len(away) > 200 and min(away) > 0.2 - 0.03 and max(away) < 0.2 + 0.03


@pytest.mark.parametrize("name", ["ball", "rod", "crate"])
def test_wrong_dimensions_leave_the_collider_out(name):
    plan = make_plan(values(**{f"{name}__dimensions": (1.0, 1.0, 1.0, 1.0)}))
    assert name not in plan.scene.colliders and f"{name}.dimensions is [1.0, 1.0, 1.0, 1.0]" in plan.problems[name]


def test_a_hand_whose_object_is_left_out_is_left_out_with_it_and_both_are_told():
    hands = ("left", "right")
    rows = {name: row.default for name, row in names.scene_rows({**NAMED, "handles": hands}).items()}
    wrong = {"handles": hands, "sheet.material": "velvet", "left.object": "sheet", "right.object": "line"}
    plan = make_plan(rows | values() | wrong)
    assert plan.problems["sheet"].startswith("sheet.material is 'velvet'; allowed is one of cotton")
    assert plan.problems["left"] == "left.object is 'sheet', which is left out"
    assert set(plan.scene.handles) == {"right"} and "line" in plan.scene.objects
    assert not plan.without({"line"}).scene.handles


def test_a_mesh_file_becomes_a_cloth(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    box = trimesh.creation.box((1.0, 1.0, 1.0))
    file = tmp_path / "box.stl"  # a format that repeats every vertex in each of its triangles
    box.export(file)
    vertices, triangles = load_mesh(str(file), "sheet.mesh")
    assert vertices.shape == (8, 3) and triangles.shape == (12, 3)
    sheet = make_plan(values(sheet__mesh=str(file), sheet__pins=(0, 1))).scene.objects["sheet"]
    assert np.allclose(sheet.vertices, vertices) and sheet.pins == (0, 1)
    given = values(sheet__mesh=str(file), sheet__scale=0.01, sheet__pins="none", sheet__material="cotton")
    small = make_plan({**given, **material_values(given, {"sheet.mesh", "sheet.scale"})}).scene.objects["sheet"]
    assert np.ptp(small.vertices) == pytest.approx(0.01)
    assert small.mass == pytest.approx(FABRICS["cotton"].areal_mass * 6e-4)
    assert small.shear_compliance == pytest.approx(1.0 / FABRICS["cotton"].shear)
    woven = make_plan(values(sheet__mesh=str(file), sheet__pins="none", sheet__warp=(0.0, 1.0, 0.0)))
    assert tuple(woven.scene.objects["sheet"].warp) == (0.0, 1.0, 0.0)
    assert woven.scene.objects["sheet"].shear_compliance == 3e-3
    plain = make_plan(values(sheet__mesh=str(file), sheet__pins="none", sheet__shear=False)).scene.objects["sheet"]
    assert plain.shear_compliance is None


def test_a_part_of_a_file_becomes_a_cloth_with_the_warp_of_its_texture(tmp_path):
    square = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
    text = f"{square}vt 0 0\nvt 0 1\nvt -1 1\nvt -1 0\ng left\nf 1/1 2/2 3/3\ng right\nf 1/1 3/3 4/4\n"
    (tmp_path / "it.obj").write_text(text)
    file = f"{tmp_path / 'it.obj'}#right"
    given = values(sheet__mesh=file, sheet__pins="none", sheet__material="silk", sheet__uv=True)
    sheet = make_plan({**given, **material_values(given, {"sheet.mesh"})}).scene.objects["sheet"]
    assert sheet.warp == pytest.approx(np.array([[0.0, -1.0, 0.0]]))
    assert sheet.mass == pytest.approx(0.5 * FABRICS["silk"].areal_mass)
    wrong = make_plan(values(sheet__mesh=file.replace("right", "back"), sheet__pins="none"))
    assert wrong.problems["sheet"].endswith("which has no part 'back'; allowed are 'left, right'")


@pytest.mark.parametrize("content", ["", "solid nothing\nendsolid nothing\n", "\x00\x01garbage"])
def test_what_is_no_mesh_is_said_in_one_sentence(tmp_path, content):
    pytest.importorskip("trimesh")
    file = tmp_path / "bad.stl"
    file.write_text(content)
    with pytest.raises(ValueError, match=r"^sheet\.mesh is '.*, which [^\n]*$"):
        load_mesh(str(file), "sheet.mesh")


def test_a_path_lays_a_rope_along_its_corners():
    """Three sides of a square of 1 m in six segments; a material weighs its whole length."""
    corners = (0.0, 0.0, 1.0, 1.0, 0.0, 1.0, 1.0, 1.0, 1.0, 0.0, 1.0, 1.0)
    plan = make_plan(values(line__path=corners, line__segments=6))
    points = plan.scene.objects["line"].points
    wanted = [(0, 0), (0.5, 0), (1, 0), (1, 0.5), (1, 1), (0.5, 1), (0, 1)]
    assert not plan.problems and np.allclose(points, [(x, y, 1.0) for x, y in wanted])
    of = [
        values(line__material="steel cable", line__path=corners, line__segments=6),
        values(line__material="steel cable", line__start=(0.0, 0.0, 0.0), line__end=(3.0, 0.0, 0.0)),
    ]
    masses = [material_values(each, ())["line.mass"] for each in of]
    assert masses[0] == pytest.approx(masses[1])


def test_a_path_whose_corners_the_segments_cut_is_told_once(caplog):
    corners = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 0.0)
    for segments in (2, 2, 3, 60):
        plan = make_plan(values(line__path=corners, line__segments=segments))
        assert not plan.problems and plan.scene.objects["line"].segments == segments
    assert caplog.messages == [
        "line.path is 3 m long, but 2 segments along it cut its corners and have 2.24 m; more segments follow it"
    ]


@pytest.mark.parametrize(
    ("path", "said"),
    [
        ((0.0, 0.0, 1.0), "has 3 numbers; allowed are x y z of two corners or more"),
        ((0.0, 0.0, 1.0, 1.0), "has 4 numbers; allowed are x y z of two corners or more"),
        ((0.0,) * 6, "has the corner [0.0, 0.0, 0.0] twice in a row; allowed are corners apart"),
    ],
)
def test_a_path_that_is_none_leaves_the_rope_out(path, said):
    plan = make_plan(values(line__path=path))
    assert plan.problems == {"line": f"line.path {said}"} and "line" not in plan.scene.objects


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"start": (0.0, 0.0, 1.0), "end": (0.0, 0.0, 1.0)}, "points 0 and 1 both at [0.0, 0.0, 1.0]"),
        ({"path": (0.0,) * 3 + (2.5,) + (0.0,) * 5, "segments": 5}, "points 2 and 3 both at [2.0, 0.0, 0.0]"),
    ],
)
def test_a_segment_of_no_length_is_told_with_its_place(given, said):
    plan = make_plan(values(**{f"line__{name}": value for name, value in given.items()}))
    assert plan.problems == {"line": f"line has {said}; allowed are neighbours apart"}


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"line__twist": True}, "line has twist without bending; allowed is bending alone, or both"),
        ({"line__end_turn": 1.0}, "line.end_turn is 1 without twist; allowed is 0, or both"),
        (
            {"sheet__weft_bend_compliance": 2.0},
            "sheet.weft_bend_compliance is 2 without bending 'dihedral'; allowed is to leave it out, or both",
        ),
    ],
)
def test_what_needs_another_parameter_is_told_in_words_of_both(given, said):
    """Presence is a parameter of the node, such as twist, and a number or None in Python."""
    assert list(make_plan(values(**given)).problems.values()) == [said]


def test_what_a_path_or_a_mesh_replaces_has_no_effect():
    given = values(line__path=(0.0, 0.0, 0.0, 1.0, 0.0, 0.0), sheet__mesh="shirt.obj")
    for name, place in {"line.end": "line.path", "sheet.resolution": "sheet.mesh", "sheet.size": "sheet.mesh"}.items():
        assert names.idle(name, given) == f"{name} acts only where {place} is empty"
        assert not names.idle(name, values())


def test_a_file_has_no_effect_on_a_shape_of_numbers():
    given = values(ball__mesh="rock.stl", rod__shape="mesh", rod__mesh="rock.stl")
    assert names.idle("ball.mesh", given) == "ball.mesh has no effect on a sphere"
    assert not names.idle("rod.mesh", given) and not names.idle("sheet.mesh", values(sheet__mesh="shirt.obj"))


def test_an_orientation_that_is_none_is_called_by_its_parameter():
    rows = {name: row.default for name, row in names.scene_rows({**NAMED, "handles": ("hand",)}).items()}
    given = rows | values() | {"handles": ("hand",), "hand.orientation": (0.0, 0.0, 0.0, 0.0)}
    given |= {"ball.orientation": (0.0, 0.0, 0.0, 0.0), "line.orientation": (0.0, 0.0, 0.0, 0.0)}
    for name, problem in make_plan(given).problems.items():
        assert problem.startswith(f"{name}.orientation is [0.0, 0.0, 0.0, 0.0]; allowed is a finite quaternion")


def test_lengths_of_a_winch_are_called_as_parameters():
    given = {"pins": "start", "winch.enabled": True, "winch.shortest": 5.0, "winch.longest": 1.0}
    plan = make_plan({**values(), **{f"line.{name}": value for name, value in given.items()}})
    assert plan.problems["line"].startswith("line.winch.shortest is 5 with a longest of 1; allowed")


def test_the_rows_are_the_fields_of_the_scene():
    """Every row of the table under an object or collider ends up in the scene, or this test names it."""
    ours = {"type", "material", "mesh", "scale", "uv", "path", "shear", "bending", "twist", "shape"}
    ours |= {"dimensions"}
    for kind, description in (("cloth", Cloth), ("rope", Rope)):
        fields = {field.name for field in dataclasses.fields(description)}
        assert {row.name.partition(".")[0] for row in names.object_rows(kind)} - ours <= fields
    assert {row.name for row in table.WINCH} - {"enabled"} == {field.name for field in dataclasses.fields(Winch)}
