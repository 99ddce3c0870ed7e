# SPDX-License-Identifier: Apache-2.0
"""Commands that README, tutorials and how-tos print: those for who has typed `make` are typed as printed.

They are in blocks that are indented by four, or of `sh`. Where a page names a file of the reader's own, a small one is
made here.
"""

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from functools import cache
from pathlib import Path
from textwrap import indent

import numpy as np
import pytest
from patience import patience, tries
from scipy.spatial.transform import Rotation

from cloth_sim_ros.identify.recording import Recording
from cloth_sim_ros.sim import Handle, Rope, Scene, Simulation
from cloth_sim_ros.study.scene_file import read_plan

ROOT = Path(__file__).parents[2]
PAGES = [
    ROOT / "README.md",
    *sorted((ROOT / "docs/tutorials").glob("*.md")),
    *sorted((ROOT / "docs/how-to").glob("*.md")),
]
HERE = "cloth_sim_ros."  # modules of ours
NOT_OURS = ("pip", "colcon")  # programs in .venv of others
MODULE = ".venv/bin/python -m cloth_sim_ros."

# What a program that goes on until Ctrl-C prints where all is well
UNTIL = {
    "make demo": "real-time factor",
    ".venv/bin/cloth_sim_node ": "simulating ",
    ".venv/bin/cloth_sim_viewer": "at http",
    ".venv/bin/cloth_sim_record ": "Recording into my_bag",
    ".venv/bin/cloth_sim_driver arm": "driving arm",
}
# What a program that ends by itself prints where all is well
ENDS = {
    f"{MODULE}study tune ": "which meets 0.01",
    f"{MODULE}identify ": "written: scene_identified.yaml",
    f"{MODULE}identify.fit_cable ": "written: cable.yaml",
    f"{MODULE}demo.latency ": "at real-time factor",
    ".venv/bin/cloth_sim_replay my_bag": ", 0 not",
    ".venv/bin/cloth_sim_export my_bag towel.glb": "towel.glb has ",
    ".venv/bin/cloth_sim_export my_bag towel.mp4": "towel.mp4 has ",
}
# What a program that acts on a running node has beside it
BESIDE = {
    ".venv/bin/cloth_sim_record ": ".venv/bin/cloth_sim_node --ros-args --params-file scene.yaml",
    ".venv/bin/cloth_sim_driver arm": ".venv/bin/cloth_sim_node --ros-args --params-file config/arm.yaml",
}
# Commands that no test types, by how they begin, and why
INDEX, ROS, SYSTEM = "asks the package index", "needs an installed ROS 2", "is of the system"
NOT_TYPED = {
    "make extras": INDEX,
    ".venv/bin/pip install ": INDEX,
    "python3 -m venv ": "comes before .venv",
    ".venv/bin/colcon build": ROS,
    "ros2 ": ROS,
    "PYTHONPATH=$PWD:$PYTHONPATH ros2 ": ROS,
    "rosdep ": ROS,
    "source ": ROS,
    "python3 drive.py": ROS,
    "export ": "sets a variable of the reader's shell",
    "sudo apt install ": SYSTEM,
    "docker ": SYSTEM,
    f"{MODULE}identify recording.npz --scene scene.yaml --fit towel.stretch_compliance --ray 10.": "needs that cluster",
}
# What blocks show that is no command: what programs print, by how it begins
SHOWN = (
    "[INFO] [", "[WARN] [", "[ERROR] [", "[RTPS_", "Warp CUDA warning", "error: ", "cloth_sim: ", "cloth_sim_node: ",
    "A module that was compiled", "device is ", "asked 0.", "each finger ", "both carry ", "while each ", "its middle ",
    "and falls ", "hand holds ", "the hand carries ", "frames 0 to ", "718 clouds ", "frame 41: ", "400 particles, ",
)  # fmt: skip


SHELL = re.compile(r"^```sh\n(.*?)^```$", flags=re.DOTALL | re.MULTILINE)


def lines():
    """(page, line) of all blocks of no language, with continued lines in one and without comments."""
    for page in PAGES:
        text = re.sub(r"^```(?!sh\n)\S+\n.*?^```$", "", page.read_text(), flags=re.DOTALL | re.MULTILINE)
        text = SHELL.sub(lambda block: indent(block[1], "    "), text)
        assert "```" not in text, f"{page.name} has a block without a language"
        for line in re.findall(r"^ {4}(?:.*\\\n)*.*$", text, flags=re.MULTILINE):
            yield page, re.sub(r"\s+#.*", "", line.replace("\\\n", " ")).strip()


def begins(line, table):
    """The key of `table` with which a line begins, the longest; None where there is none."""
    return max((key for key in table if line.startswith(key)), key=len, default=None)


LINES = list(lines())
COMMANDS = [
    pytest.param(line, id=f"{page.stem}: {line[:60]}") for page, line in LINES if re.match(r"make |\.venv/bin/", line)
]


def typed(table):
    """(page, command) of the lines that are typed and begin with a key of this table."""
    for page, line in LINES:
        if begins(line, table) and not begins(line, NOT_TYPED):
            yield pytest.param(page, line, id=f"{page.stem}: {line[:60]}")


@pytest.mark.parametrize(("page", "line"), [pytest.param(*each, id=each[1][:60]) for each in LINES])
def test_every_printed_line_has_a_place(page, line):
    """A new command goes into UNTIL or ENDS, which are typed, or into NOT_TYPED with its reason."""
    places = [begins(line, table) for table in (UNTIL, ENDS, NOT_TYPED, dict.fromkeys(SHOWN))]
    assert any(places), f"{page.name} prints a line that no test types"


@pytest.mark.parametrize("table", [UNTIL, ENDS, NOT_TYPED, dict.fromkeys(SHOWN)])
def test_no_place_is_left_of_a_line_that_is_gone(table):
    assert set(table) <= {begins(line, table) for _, line in LINES}


@cache
def help_of(*program):
    done = subprocess.run([*program, "--help"], cwd=ROOT, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize(("verb", "there"), [("run", "setup.py"), ("launch", "launch/cloth_sim.launch.py")])
def test_what_ros2_starts_is_there(verb, there):
    """Lines of ros2 are not typed, but name a program of setup.py or the launch file."""
    names = {name for _, line in LINES for name in re.findall(rf"ros2 {verb} cloth_sim_ros (\S+)", line)}
    programs = set(re.findall(r'"(\w+) = cloth_sim_ros\.programs:', (ROOT / there).read_text()))
    assert names and names <= programs | {Path(there).name}


@pytest.mark.parametrize("command", COMMANDS)
def test_a_printed_command_exists_with_its_options(command):
    first, *words = shlex.split(command)
    if first == "make":
        done = subprocess.run(["make", "--dry-run", *words], cwd=ROOT, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        scenes = [word.removeprefix("SCENE=") for word in words if word.startswith("SCENE=")]
        assert all((ROOT / f"config/{scene}.yaml").is_file() for scene in scenes)
        return
    program = first.removeprefix(".venv/bin/")
    if program in NOT_OURS:
        return
    if program == "python":
        if words[0] != "-m":
            return  # a file that the page has the reader write
        module, words = words[1], words[2:]
        assert module.startswith(HERE)
    else:
        module = re.search(rf'"{program} = {HERE}programs:(\w+)"', (ROOT / "setup.py").read_text())[0] and program
    options = {word.split("=")[0] for word in words if word.startswith("--") and len(word) > 2} - {"--ros-args"}
    if "--ros-args" in words:  # what follows is for rclpy
        options -= {word for word in words[words.index("--ros-args") :]}
    if not options and program != "python":
        return
    ours = (sys.executable, "-m", module) if program == "python" else (Path(sys.executable).parent / program,)
    told = help_of(*ours)
    commands = [word for word in words[:1] if re.search(rf"[{{,]{re.escape(word)}[,}}]", told)]
    if commands:
        told += help_of(*ours, *commands)
    assert options <= set(re.findall(r"--[a-z][a-z-]*", told))


class Typed:
    """A command that runs in a shell. What is left of it is killed at the end."""

    def __init__(self, folder, command):
        self._log = folder / f"log_{len(list(folder.glob('log_*')))}.txt"
        with self._log.open("w") as log:
            self.process = subprocess.Popen(
                command, shell=True, cwd=folder, env=ENV, stdout=log, stderr=subprocess.STDOUT, start_new_session=True
            )

    @property
    def said(self):
        return self._log.read_text()

    def until(self, words):
        """Waits until it says this."""
        for _ in tries(120.0, pause=0.05):
            if words in self.said:
                return
            assert self.process.poll() is None, self.said
        raise AssertionError(self.said)

    def end(self, seconds=0.0):
        """What it has said, after Ctrl-C where it still runs after these seconds."""
        try:
            for _ in tries(seconds, pause=0.05):
                if self.process.poll() is not None:
                    break
            if self.process.poll() is None:
                os.killpg(self.process.pid, signal.SIGINT)
            self.process.wait(patience(30.0))
        finally:
            if self.process.poll() is None:
                os.killpg(self.process.pid, signal.SIGKILL)
        assert "Traceback" not in self.said and "[ERROR]" not in self.said, self.said
        return self.said


# The domain is this process's own, and .venv imports this tree.
ENV = os.environ | {"ROS_DOMAIN_ID": str(1 + os.getpid() % 100), "PYTHONPATH": str(ROOT)}
SMALL = """
/**:
  ros__parameters:
    objects: [towel]
    handles: [hand]
    towel: {resolution: [5, 5], size: [0.3, 0.3], mass: 0.05, bending: dihedral, stretch_compliance: 0.02,
            bend_compliance: 100.0, damping: 0.003, pins: none}
    hand: {position: [0.0, 0.15, 0.0], reach: [0.2, 0.02, 0.02], attached: true}
    solver: {method: xpbd, order: 2, substeps: 10, iterations: 1}
"""
RESET = """
import rclpy; from std_srvs.srv import Trigger; rclpy.init(); node = rclpy.create_node("presser")
service = node.create_client(Trigger, "/cloth_sim/reset"); service.wait_for_service()
rclpy.spin_until_future_complete(node, service.call_async(Trigger.Request()))
"""


def source_tree(folder):
    """The source tree after `make`, with the files that pages have a reader save."""
    pytest.importorskip("rclpy")
    for name in ("Makefile", "setup.py", "setup.cfg", "pyproject.toml", "config", "cloth_sim_ros"):
        (folder / name).symlink_to(ROOT / name)
    (folder / ".venv").mkdir()
    for each in Path(sys.prefix).iterdir():
        if not each.name.startswith("ready"):
            (folder / ".venv" / each.name).symlink_to(each)
    (folder / ".venv/ready-to-run").touch()
    for name, page in (
        ("scene", "README.md"),
        ("first", "docs/tutorials/first-scene.md"),
        ("grasp", "docs/tutorials/grasp-a-towel.md"),
    ):
        text = (ROOT / page).read_text()
        (folder / f"{name}.yaml").write_text(re.findall(r"```yaml\n(.*?)```", text, flags=re.DOTALL)[0])
    shutil.copy(ROOT / "config/towel.yaml", folder)
    return folder


@pytest.fixture
def folder(tmp_path):
    return source_tree(tmp_path)


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """What cloth_sim_record writes of a node with the scene SMALL, with a reset in it."""
    pytest.importorskip("rosbags")
    folder = source_tree(tmp_path_factory.mktemp("recorded"))
    (folder / "scene.yaml").write_text(SMALL)
    (command,) = (line for _, line in LINES if "cloth_sim_record" in line)
    with_node = Typed(folder, BESIDE[begins(command, BESIDE)])
    recorder = Typed(folder, command)
    try:
        with_node.until("simulating ")
        recorder.until(UNTIL[begins(command, UNTIL)])
        subprocess.run([sys.executable, "-c", RESET], env=ENV, check=True, timeout=patience(60.0))
        path = folder / "my_bag"
        size = sum(each.stat().st_size for each in path.glob("*"))
        assert any(sum(each.stat().st_size for each in path.glob("*")) > size + 1e4 for _ in tries(60.0, pause=0.1))
    finally:
        recorder.end(), with_node.end()
    return path


def seen(path, frames=4):
    """Places of the particles (F, N, 3) of the towel in a scene after each frame, and their times [s]."""
    plan = read_plan(path)
    sim, rows = Simulation(plan.scene, plan.settings, "cpu"), []
    for _ in range(frames):
        sim.step()
        rows.append(sim.positions("towel"))
    return np.arange(1, frames + 1) * plan.settings.frame_dt, np.array(rows)


def write_robot_bag(folder):
    """A camera and a hand, in the frame of the scene, which starts 2.5 s after the first stamp."""
    robot_messages = pytest.importorskip("robot_messages")
    times, rows = seen(folder / "scene.yaml", frames=12)
    still = Rotation.identity()
    robot_messages.write(
        folder / "bag",
        {
            "/tf_static": [robot_messages.transforms(0, "world", "camera", still, np.zeros(3))],
            "/left_hand/pose": [
                robot_messages.pose(stamp, "world", [0.0, 0.15, 0.0], still) for stamp in np.arange(0.0, 3.0, 0.02)
            ],
            "/camera/towel": [
                robot_messages.cloud(2.5 + time, "camera", row) for time, row in zip(times, rows, strict=True)
            ],
        },
    )


def write_cable(path, seed):
    """Markers along a cable between two hands, which falls and swings: a row a frame."""
    points = np.zeros((25, 3))
    points[:, 0] = np.linspace(0.0, 0.6, 25)
    held = [0, 3, 21, 24]
    rope = Rope(points=points, mass=0.06, pins=None, stretch_compliance=1e-4, bend_compliance=250.0)
    handles = {f"h{k}": Handle(position=tuple(points[k]), reach=0.001, attached=True) for k in held}
    sim, rows, pulls = Simulation(Scene({"it": rope}, handles=handles), device="cpu"), [], []
    for frame in range(30):
        for k in held:
            way = 0.05 * np.sin(0.1 * frame * np.array([1.0, 0.7 + 0.2 * seed, 1.3])) + [0.002 * frame, 0.0, 0.0]
            sim.set_handle_pose(f"h{k}", points[k] + (way if k < 12 else -way))
        sim.step()
        rows.append([frame / 60.0, *sim.positions("it")[::3].ravel()])
        pulls.append(sum(sim.handle_wrench(f"h{k}")[0] for k in held[:2]))
    if path.suffix:
        np.savetxt(path, rows, delimiter=",")
    else:
        write_cable_bag(path, np.array(rows), pulls)


def write_cable_bag(path, rows, pulls):
    """The same as a bag: two clamps of two markers each, what is between them, and the force at the start."""
    robot_messages = pytest.importorskip("robot_messages")
    parts = {"/left_clamp": slice(0, 2), "/camera/markers": slice(2, -2), "/right_clamp": slice(-2, None)}
    topics = {
        topic: [robot_messages.array(row[0], "world", row[1:].reshape(-1, 3)[part]) for row in rows]
        for topic, part in parts.items()
    }
    wrenches = [robot_messages.wrench(row[0], "world", pull) for row, pull in zip(rows, pulls, strict=True)]
    robot_messages.write(path, topics | {"/left_wrist/wrench": wrenches})


def write_files(page, command, folder, request):
    """The files of the reader's own that a command names, small."""
    words = shlex.split(command)
    if page.stem in ("identify", "recording"):
        (folder / "scene.yaml").write_text(SMALL)
    if "recording.npz" in words:
        times, rows = seen(folder / "scene.yaml")
        Recording(times, positions={"towel": rows}).write(folder / "recording.npz")
    for name in {"my_bag", "bag"} & set(words) if "cloth_sim_record" not in command else ():
        if "--points" in words:
            write_robot_bag(folder)
        else:
            shutil.copytree(request.getfixturevalue("bag"), folder / name)
    for seed, name in enumerate(re.findall(r"run_\d(?:\.csv)?", command)):
        write_cable(folder / name, seed)


@pytest.mark.long
@pytest.mark.parametrize(("page", "command"), list(typed(UNTIL)))
def test_what_goes_on_until_ctrl_c_is_typed_as_printed(page, command, folder, request):
    if "arm" in command:
        pytest.importorskip("mujoco")
    write_files(page, command, folder, request)
    beside = begins(command, BESIDE)
    running = [Typed(folder, BESIDE[beside])] if beside else []
    try:
        for each in running:
            each.until("simulating ")
        running.append(Typed(folder, command))
        running[-1].until(UNTIL[begins(command, UNTIL)])
    finally:
        for each in reversed(running):
            each.end()


@pytest.mark.long
@pytest.mark.parametrize(("page", "command"), list(typed(ENDS)))
def test_what_ends_by_itself_is_typed_as_printed(page, command, folder, request):
    if "--ray" in command:
        pytest.importorskip("ray")
    write_files(page, command, folder, request)
    running = Typed(folder, command)
    told = running.end(300.0)
    assert running.process.returncode == 0 and ENDS[begins(command, ENDS)] in told, told


@pytest.mark.parametrize(
    "command", ["study tune a.yaml --error 1", "identify a.npz --scene a.yaml --fit towel.damping"]
)
def test_what_make_extras_adds_is_asked_for_in_one_sentence(tmp_path, command):
    """matplotlib stands for all: programs of README and tutorials miss it after `make` alone."""
    hide = "import runpy, sys; sys.modules['matplotlib'] = None; sys.argv = sys.argv[1:]; "
    module, *words = command.split()
    code = hide + f"runpy.run_module('cloth_sim_ros.{module}', run_name='__main__')"
    done = subprocess.run(
        [sys.executable, "-c", code, module, *words], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert (
        done.stderr == "error: matplotlib is not installed; make extras adds it, and so does pip install matplotlib\n"
    )


def test_no_page_prints_another_way_to_the_extras():
    for page in PAGES:
        assert not re.search(r"^ {4}pip install", page.read_text(), flags=re.MULTILINE), page.name
    assert len(COMMANDS) > 15
