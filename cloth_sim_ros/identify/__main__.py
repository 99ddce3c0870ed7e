# SPDX-License-Identifier: Apache-2.0
"""`python -m cloth_sim_ros.identify RECORDING --scene SCENE.yaml --fit cloth.stretch_compliance ...`"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from cloth_sim_ros.identify.candidates import Candidates, bounds_of
from cloth_sim_ros.identify.fit import Estimate, identify
from cloth_sim_ros.identify.recording import Recording
from cloth_sim_ros.identify.report import draw, sentences
from cloth_sim_ros.identify.terminal import Progress, exit_status
from cloth_sim_ros.ros.parameters.plan import Plan  # noqa: TID251 (free of rclpy)
from cloth_sim_ros.status_line import show
from cloth_sim_ros.study.scene_file import read_plan, with_values


def main() -> int:
    """Parse the command line, identify, print and write; return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m cloth_sim_ros.identify", description="find values of a recording")
    parser.add_argument("recording", type=Path, help="an .npz file or a bag, see docs/how-to/identify.md")
    parser.add_argument("--scene", type=Path, required=True, help="the node's YAML file, with first guesses")
    parser.add_argument("--fit", nargs="+", required=True, metavar="NAME[=LOW:HIGH]", help="live numbers to be found")
    parser.add_argument("--worlds", type=int, default=64, help="candidates at a time")
    parser.add_argument("--device", help="cpu, cuda:0 or auto; else the file's")
    parser.add_argument("--ray", metavar="local|ADDRESS", help="spread candidates over a cluster: its GPUs, else CPUs")
    parser.add_argument("--seed", type=int, default=0, help="of the first candidates")
    parser.add_argument("--output", type=Path, help="YAML with what was found; else SCENE_identified.yaml; .png beside")
    topic = {"action": "append", "default": [], "metavar": "NAME=/topic"}
    parser.add_argument("--points", help="clouds of an object, in the bag of a robot; may be given again", **topic)
    parser.add_argument("--poses", help="poses of a collider or handle, likewise", **topic)
    parser.add_argument("--begin", type=float, default=0.0, help="start of the scene in that bag [s]")
    parser.add_argument("--delay", metavar="LOW:HIGH", help="by how much the camera may be late [s]; it is found")
    return exit_status(run, parser.parse_args())


def run(arguments: argparse.Namespace) -> Estimate:
    """Identify, print, draw and write; return the estimate. Raises ValueError in one sentence."""
    plan = read_plan(arguments.scene)
    recording = _read(arguments, plan)
    if arguments.delay:
        recording = recording.delayed(*bounds_of("--delay", arguments.delay))
    device = arguments.device or plan.device
    given = (plan.scene, plan.settings, recording, arguments.fit, arguments.worlds, device)
    candidates = _spread(arguments.ray, given) if arguments.ray else Candidates(*given)
    candidates.told = Progress(candidates)
    start, found = identify(candidates, arguments.seed)
    candidates.told = lambda frames: None
    show("")
    path = arguments.output or arguments.scene.with_name(f"{arguments.scene.stem}_identified.yaml")
    told = zip(candidates.live, found.values, found.felt, strict=False)
    values = {each.name: float(f"{value:.6g}") for each, value, felt in told if felt > 0.0}
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(with_values(arguments.scene, values))
    draw(candidates, start, found, path.with_suffix(".png"))
    written = f"written: {path} and {path.with_suffix('.png')}"
    print(candidates.sim.method, *sentences(candidates, found), written, sep="\n")
    return found


def _topics(option: str, texts: list[str]) -> dict[str, str]:
    """Return name -> topic from texts NAME=/topic. Raises ValueError for other texts and for a name given twice."""
    found: dict[str, str] = {}
    for text in texts:
        name, _, topic = text.partition("=")
        if not name or not topic.startswith("/") or name in found:
            raise ValueError(f"{option} {text} is given; allowed is NAME=/topic, once for each name")
        found[name] = topic
    return found


def _read(arguments: argparse.Namespace, plan: Plan) -> Recording:
    """Read the recording: an .npz file, a bag of the node, or a bag of a robot. Raises ValueError in one sentence."""
    path, robot = arguments.recording, bool(arguments.points)
    if not robot and (arguments.poses or arguments.begin):
        raise ValueError("--poses and --begin are of the bag of a robot; allowed are they with --points OBJECT=/topic")
    if path.suffix == ".npz":
        if robot:
            raise ValueError(f"--points names topics, and {path} is no bag; allowed is the folder of one")
        return Recording.read(path)
    try:
        if not robot:
            from cloth_sim_ros.identify.bag import recording_of

            return recording_of(path, plan.scene, plan.settings.frame_dt)
        from cloth_sim_ros.identify.robot import robot_recording

        points, poses = (_topics(f"--{which}", getattr(arguments, which)) for which in ("points", "poses"))
        found, said = robot_recording(path, plan, points, poses, arguments.begin)
    except ImportError as error:
        raise ValueError(f"{path} is a bag, and to read it {error.name} is missing; allowed are .npz files") from None
    if poses and not arguments.delay:
        said.append(
            "The clocks of camera and poses are taken to agree; --delay LOW:HIGH finds by how much they do not."
        )
    print(*said, sep="\n")
    return found


def _spread(address: str, given: tuple) -> Candidates:
    try:
        from cloth_sim_ros.identify.cluster import Spread
    except ImportError:
        raise ValueError("--ray needs the package ray; allowed is pip install 'cloth_sim_ros[cluster]'") from None
    return Spread(address, *given)


if __name__ == "__main__":
    sys.exit(main())
