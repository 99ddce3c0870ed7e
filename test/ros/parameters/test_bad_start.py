# SPDX-License-Identifier: Apache-2.0
"""What is wrong in a parameter file is said in one sentence each, and the node lives."""

import subprocess
import sys

import pytest
from client import fields
from node_process import ROOT
from patience import patience
from sensor_msgs.msg import PointCloud2

MISTAKES = """
cloth_sim:
  ros__parameters:
    objects: [cloth, torn, cable, silky, "two words", cloth, LONG, "new\\nline"]
    colliders: [ball, cloth]
    seams: [hem]
    rate: 60                              # a whole number for a decimal
    gravity: [0, 0, -9.81]                # both in one list
    wind: {enabled: "windy"}
    cloth:
      resolution: [1, 1]
      size: [1, 1]
      mass: heavy
      stretch_compliance: -1
      pins: [0, 5]
      colour: red
      masss: 1.0
      bending:
    torn: {mesh: /nowhere/shirt.obj}
    cable: {type: rop, segments: 4}
    silky: {material: silk, resolution: [3, 3], thickness: -1, density: 3, sise: [2, 2]}
    hem: {first: cloth, second: silky, first_particles: [2000], second_particles: [0]}
    ball: {shape: cube, dimensions: [[1, 2], [3, 4]], position: [0, 0, five]}
    solver: {substeps: 20.0, iterations: many}
"""

MISTAKES = MISTAKES.replace("LONG", 300 * "n")

SENTENCES = [
    f"objects holds '{36 * 'n'}...{39 * 'n'}', left out: a name has at most 100 letters",
    "objects holds 'new\\nline', left out",
    "objects holds 'two words', left out",
    "objects holds 'cloth', left out: the name is already taken",
    "colliders holds 'cloth', left out: the name is already taken",
    "wind.enabled is 'windy'; allowed is true or false; using the default False",
    "cloth.resolution is [1, 1]; allowed is 2 whole numbers from 2 to 2048; using the default [32, 32]",
    "cloth.mass is 'heavy'; allowed is a finite number from 1e-09 to 1e+06 [kg]; using the default 0.2",
    "cloth.stretch_compliance is -1; allowed is a finite number from 0",
    "there is no parameter cloth.colour",
    "there is no parameter cloth.masss; did you mean cloth.mass? Its value is ignored, and cloth.mass is 0.2.",
    "there is no parameter silky.sise; did you mean silky.size? Its value is ignored, and silky.size is [1.0, 1.0].",
    "cloth.bending has no value and is ignored",
    "torn.mesh is '/nowhere/shirt.obj'; no such file is in '/nowhere', which is no folder; allowed are .obj, .off, "
    ".ply, .stl, .glb and what else trimesh reads; it is left out until that is mended",
    "cable.type is 'rop'; allowed is one of cloth, rope; it is left out until that is mended",
    "hem.first_particles has 2000; allowed is 0 to 1023, those of cloth; it is left out until that is mended",
    "silky.thickness is -1; allowed is a finite number from 0 to 1 [m]; using that of the material, 7.5e-05",
    "there is no parameter silky.density. Its value is ignored",
    "ball.shape is 'cube'; allowed is one of plane, sphere, capsule, box",
    "ball.dimensions is no list of one type and is ignored",
    "ball.position is no list of one type and is ignored",
    "solver.iterations is 'many'; allowed is a whole number from 0 to 1000; using the default 0",
]


def test_every_mistake_is_said_and_the_rest_works(start, client):
    node = start(MISTAKES, "-p", "publish.velocities:=1").ready()
    for sentence in [*SENTENCES, "publish.velocities is 1; allowed is true or false"]:
        matching = [line for line in node.log.splitlines() if sentence in line]
        assert len(matching) == 1, f"{sentence}\n{node.log}"
    assert "Traceback" not in node.log and "cable.segments" not in node.log
    assert client.get("rate") == 60.0
    assert list(client.get("cloth.pins")) == [0, 5]
    assert list(client.get("gravity")) == [0.0, 0.0, -9.81]
    clouds = client.listen(PointCloud2, "/cloth_sim/cloth/particles", 1)
    client.until(lambda: clouds)
    assert len(fields(clouds[0])) == 32 * 32


def test_a_name_without_parameters_is_said(start):
    text = "objects: [towel, cord]\n    towle: {material: cotton}\n    cord: {size: [1, 1]}\n    colliders: [rock]"
    node = start(f"cloth_sim:\n  ros__parameters:\n    {text}\n").ready()
    lines = [line for line in node.log.splitlines() if "no parameter is set for it" in line]
    assert len(lines) == 2
    assert "objects holds 'towel'" in lines[0] and lines[0].endswith("so all have defaults; did you mean towle?")
    assert "colliders holds 'rock'" in lines[1] and lines[1].endswith("so all have defaults")


def test_a_mesh_can_be_mended_while_the_node_runs(start, client, tmp_path):
    pytest.importorskip("trimesh")
    node = start("cloth_sim:\n  ros__parameters:\n    objects: [shirt]\n    shirt: {mesh: /nowhere/shirt.obj}\n")
    node.wait_for("shirt.mesh is '/nowhere/shirt.obj'")
    file = tmp_path / "shirt.obj"
    file.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3\nf 2 4 3\n")
    assert client.set("shirt.mesh", str(file)).successful
    clouds = client.listen(PointCloud2, "/cloth_sim/shirt/particles", 1)
    client.until(lambda: clouds)
    assert len(fields(clouds[0])) == 4


def test_what_a_material_makes_of_a_size_may_be_beyond_the_range(start):
    objects = "long: {material: cotton, size: [5000, 5000]}\n"
    objects += "    short: {type: rope, material: steel cable, start: [0, 0, 1], end: [0, 0, 1]}"
    node = start(f"cloth_sim:\n  ros__parameters:\n    objects: [long, short]\n    {objects}\n").ready()
    for said in ("long.mass is 3250000.0; allowed is", "short.mass is 0.0; allowed is"):
        (line,) = [line for line in node.log.splitlines() if said in line]
        assert "it is left out until that is mended" in line
    assert "Traceback" not in node.log


def test_a_device_that_is_not_there(start, client):
    node = start("cloth_sim:\n  ros__parameters:\n    objects: [cloth]\n    device: cuda:77\n")
    node.wait_for("cannot build the simulation: device is 'cuda:77'; allowed is auto or one of")
    assert client.set("device", "auto").successful
    node.ready()


def test_what_stands_outside_of_the_parameters_is_told_and_the_rest_acts(start):
    inside = "objects: [rope]\n    rope: {type: rope, segments: 3}"
    node = start(f"/**:\n  ros__parameters:\n    {inside}\n  rate: 30.0\n  gravity: [0, 0, 1]\n").ready()
    for name, line in (("rate", 5), ("gravity", 6)):
        assert f"line {line}: {name} stands outside of ros__parameters and is ignored" in node.log.replace("/**.", "")
    assert "rope (4 particles)" in node.log


def test_what_has_no_effect_is_told_but_for_what_the_file_switches_off(start):
    scene = "objects: [a, b]\n    a: {resolution: [2, 2], bend_compliance: 3.0}\n"
    scene += "    b: {resolution: [2, 2], bending: none, bend_compliance: 3.0}\n    wind: {velocity: [3, 0, 0]}\n"
    log = start(f"/**:\n  ros__parameters:\n    {scene}").ready().log
    assert "wind.velocity acts only where wind.enabled is not false" in log
    assert "a.bend_compliance acts only where a.bending is not none" in log and "b.bend_compliance" not in log


def test_an_empty_scene_waits(start, client):
    node = start("cloth_sim:\n  ros__parameters:\n    objects: []\n").ready()
    assert client.get("rate") == 60.0 and node.alive()


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (None, "cannot be read"),
        ("a: [1,\n", ", line 2, is not valid YAML: expected the node content, but found '<stream end>'"),
        ("just words", "holds no parameters"),
        ("objects: [a]\na: {type: cloth}\n", "begin with a node's name, such as /**:, and ros__parameters: below"),
        ("/**:\n  objects: [a]\n", "holds no parameters"),
        ("ros__parameters:\n  objects: [a]\n", "holds no parameters"),
        ("/**:\n  ros__parameters: {objects: [a, b], a: &it {type: rope}, b: *it}\n", "line 2: *it is not known here"),
    ],
)
def test_files_that_are_no_parameter_files(tmp_path, text, sentence):
    file = tmp_path / "parameters.yaml"
    if text is not None:
        file.write_text(text)
    command = [sys.executable, "-m", "cloth_sim_ros.ros", "--ros-args", "--params-file", str(file)]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=patience(60), check=False)
    assert result.returncode == 1
    assert sentence in result.stderr and "Traceback" not in result.stderr


@pytest.mark.parametrize(
    ("program", "given", "sentence"),
    [
        ("ros", ["--params-file", "a.yaml"], "--params-file a.yaml are not known; allowed is --ros-args and what"),
        ("demo.driver", ["../config/curtain"], "../config/curtain has no driver; allowed is one of arm, bag, "),
        ("demo.driver", ["driver"], "driver has no driver; allowed is one of"),
    ],
)
def test_what_a_program_cannot_take_is_one_sentence(program, given, sentence):
    command = [sys.executable, "-m", f"cloth_sim_ros.{program}", *given]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=patience(60), check=False)
    assert result.returncode == 1
    assert sentence in result.stderr and result.stderr.count("\n") == 1
