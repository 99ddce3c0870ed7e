# SPDX-License-Identifier: Apache-2.0
"""Commands that README, tutorials and how-tos print for who has typed `make` exist, with all of their options.

Those that need nothing but the page are typed as printed. The others need a recording, a cluster or a package index.
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

import pytest
from patience import patience, tries

ROOT = Path(__file__).parents[2]
PAGES = [
    ROOT / "README.md",
    *sorted((ROOT / "docs/tutorials").glob("*.md")),
    *sorted((ROOT / "docs/how-to").glob("*.md")),
]
HERE = "cloth_sim_ros."  # modules of ours
NOT_OURS = ("pip", "colcon")  # programs in .venv of others


def printed():
    """(page, command) for each line of a block of code that begins with make or a program of .venv."""
    for page in PAGES:
        text = page.read_text()
        lines = re.findall(r"^ {4}(?:.*\\\n)*.*$", text, flags=re.MULTILINE)
        for line in (each.replace("\\\n", " ").strip() for each in lines):
            if re.match(r"make( [a-zA-Z-]+)*( |$)|\.venv/bin/", line) and not line.endswith((".", ",")):
                yield pytest.param(line.split("#")[0].strip(), id=f"{page.stem}: {line[:60]}")


COMMANDS = list(printed())


@cache
def help_of(*program):
    done = subprocess.run([*program, "--help"], cwd=ROOT, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 0, done.stderr
    return done.stdout


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


# What a program that goes on until Ctrl-C prints where all is well
UNTIL = {
    "make demo": "real-time factor",
    ".venv/bin/cloth_sim_node": "simulating ",
    ".venv/bin/cloth_sim_viewer": "at http",
}


def program_of(command):
    return next((start for start in UNTIL if command.values[0].startswith(start)), None)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The source tree after `make`, with the files that pages have a reader save."""
    pytest.importorskip("rclpy")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    for name in ("Makefile", "setup.py", "setup.cfg", "pyproject.toml", "config", "cloth_sim_ros"):
        (tmp_path / name).symlink_to(ROOT / name)
    (tmp_path / ".venv").mkdir()
    for each in Path(sys.prefix).iterdir():
        if not each.name.startswith("ready"):
            (tmp_path / ".venv" / each.name).symlink_to(each)
    (tmp_path / ".venv/ready-to-run").touch()
    for name, page in (
        ("scene", "README.md"),
        ("first", "tutorials/first-scene.md"),
        ("grasp", "tutorials/grasp-a-towel.md"),
    ):
        text = (ROOT / page if page == "README.md" else ROOT / "docs" / page).read_text()
        (tmp_path / f"{name}.yaml").write_text(re.findall(r"```yaml\n(.*?)```", text, flags=re.DOTALL)[0])
    shutil.copy(ROOT / "config/towel.yaml", tmp_path)
    return tmp_path


class Typed:
    """A command that runs in a shell. What is left of it is killed at the end."""

    def __init__(self, folder, command):
        self._log = folder / "log.txt"
        with self._log.open("w") as log:
            self.process = subprocess.Popen(
                command, shell=True, cwd=folder, stdout=log, stderr=subprocess.STDOUT, start_new_session=True
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

    def end(self):
        """What it has said, after Ctrl-C where it still runs."""
        try:
            if self.process.poll() is None:
                os.killpg(self.process.pid, signal.SIGINT)
            self.process.wait(patience(30.0))
        finally:
            if self.process.poll() is None:
                os.killpg(self.process.pid, signal.SIGKILL)
        assert "Traceback" not in self.said and "[ERROR]" not in self.said, self.said
        return self.said


@pytest.mark.long
@pytest.mark.parametrize("command", [each for each in COMMANDS if program_of(each)])
def test_what_goes_on_until_ctrl_c_is_typed_as_printed(folder, command):
    if "SCENE=arm" in command:
        pytest.importorskip("mujoco")
    typed = Typed(folder, command)
    try:
        typed.until(next(words for start, words in UNTIL.items() if command.startswith(start)))
    finally:
        typed.end()


@pytest.mark.long
def test_the_commands_of_a_recording_are_typed_as_printed(folder):
    pytest.importorskip("rosbags"), pytest.importorskip("pygltflib")
    record, replay, export = (
        next(each.values[0] for each in COMMANDS if each.values[0].startswith(f".venv/bin/cloth_sim_{what}"))
        for what in ("record", "replay", "export")
    )
    other = folder / "demo"
    other.mkdir()
    demo = subprocess.Popen([sys.executable, "-m", "cloth_sim_ros.demo", "towel", "--headless"], cwd=other)
    typed = Typed(folder, record)
    try:
        typed.until("Recording into my_bag")
        assert any(
            sum(each.stat().st_size for each in (folder / "my_bag").glob("*")) > 1e5 for _ in tries(60.0, pause=0.1)
        )
    finally:
        typed.end(), demo.terminate(), demo.wait(patience(30.0))
    typed = Typed(folder, replay)
    assert typed.process.wait(patience(120.0)) == 0 and ", 0 not" in typed.end()
    typed = Typed(folder, export)
    assert typed.process.wait(patience(120.0)) == 0 and (folder / "towel.glb").is_file()


@pytest.mark.long
def test_the_search_for_settings_is_typed_as_printed(folder):
    (command,) = (each.values[0] for each in COMMANDS if "study tune" in each.values[0])
    typed = Typed(folder, command)
    assert typed.process.wait(patience(300.0)) == 0 and "which meets 0.01" in typed.end()


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
