# SPDX-License-Identifier: Apache-2.0
"""Commands that README, tutorials and how-tos print for who has typed `make` exist, with all of their options."""

import re
import shlex
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

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


def test_no_page_prints_another_way_to_the_extras():
    for page in PAGES:
        assert not re.search(r"^ {4}pip install", page.read_text(), flags=re.MULTILINE), page.name
    assert len(COMMANDS) > 15
