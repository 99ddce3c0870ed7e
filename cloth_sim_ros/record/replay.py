# SPDX-License-Identifier: Apache-2.0
"""Replay a bag and report frame by frame if the same bits come out: `cloth_sim_replay BAG`."""

from __future__ import annotations

import argparse
import base64
import sys
import tempfile
import time
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import warp

from cloth_sim_ros.options import missing
from cloth_sim_ros.record.bag import Bag, Stamp
from cloth_sim_ros.ros.inputs.frames import Frames
from cloth_sim_ros.ros.inputs.pose_track import Pose
from cloth_sim_ros.ros.journal import ACTS
from cloth_sim_ros.ros.parameters.plugins import add_plugins_option, require_plugins
from cloth_sim_ros.ros.world import World
from cloth_sim_ros.sim import Readback
from cloth_sim_ros.sim.colliders import SHAPES

SAME, NONE = "the same bits", "no cloud is in the bag"


class Quiet:
    """A log that keeps only the last error."""

    def __init__(self):
        self.last = ""

    def info(self, sentence: str) -> None:
        """Ignore the sentence."""

    warning = info

    def error(self, sentence: str) -> None:
        """Keep the sentence."""
        self.last = sentence


class Replay:
    """A world that repeats the acts of a journal. Raises ValueError in one sentence for acts that it cannot."""

    def __init__(self, device: str = ""):
        self.world: World | None = None
        self.frames = 0  # simulated since the bag began
        self._device = device
        self._next: int | None = None  # sequence number that comes next

    def follow(self, entry: dict) -> str:
        """Repeat the acts of a message; return a sentence if the bag lacks messages before it, or ""."""
        lacks = self._next is not None and entry["sequence"] != self._next
        self._next = entry["sequence"] + 1
        try:
            self._do(entry, lacks)
        except (TypeError, LookupError, AttributeError) as error:  # an act of its own with arguments of no node
            raise ValueError(f"the journal of the bag is none of a cloth_sim node: {error!r}") from error
        return "messages of the journal are lost; nothing is compared until its next start" if lacks else ""

    def _do(self, entry: dict, lacks: bool) -> None:
        if "start" in entry:
            self._start(**entry["start"])
        elif "end" in entry or lacks:
            self.close()
        elif self.world is not None:
            for act, *arguments in entry["acts"]:
                self._act(act, arguments)

    def _start(self, parameters: dict[str, Any], poses: dict[str, list], state: str) -> None:
        values = {name: tuple(value) if isinstance(value, list) else value for name, value in parameters.items()}
        values |= {name: "" for name in values if name.endswith(".follow_frame")}  # the journal has where it went
        if self._device:
            values["device"] = self._device
        self.close()
        log = Quiet()
        world = World(values, log, Frames(values["frame_id"]))
        world.grippers.is_driven = False  # the journal has where their fingers went
        if not world.build(values):
            raise ValueError(f"the scene of the bag cannot be built here: {log.last}")
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "start"
            file.write_bytes(base64.b64decode(state))  # what is no base64 gives no state
            done, sentence, _ = world.load(file)
        if not done:
            raise ValueError(f"the start of the bag does not fit: {sentence}")
        world.in_effect, world.mounts = values, {}  # the journal has where links went
        for name, (position, orientation) in poses.items():
            world.tracks[name].rest(Pose(tuple(position), tuple(orientation)))
        self.world = world

    def close(self) -> None:
        """Drop the world, after its compilation has ended."""
        while self.world is not None and self.world.compiling.is_running:
            time.sleep(0.05)
        self.world = None

    def _act(self, act: str, arguments: list) -> None:
        world, values = self.world, [tuple(each) if isinstance(each, list) else each for each in arguments]
        if act not in ACTS:
            raise ValueError(f"the journal of the bag has {act!r}; allowed is one of {', '.join(ACTS)}")
        if act == "move":
            name, position, orientation = values
            world.tracks[name].place(Pose(position, orientation))
        elif act == "set_live":
            name, value = values
            if not name.endswith(".follow_frame"):
                world.set_live(name, value, {**world.in_effect, name: value})
        elif act == "put":
            name, fields = values
            fields = {key: tuple(each) if isinstance(each, list) else each for key, each in fields.items()}
            kinds = {kind.__name__: kind for kind in SHAPES.values()}
            world.put(name, kinds[fields.pop("shape")](**fields))
        else:
            getattr(world, act)(*values)
            self.frames += act == "advance"

    def difference(self, name: str, cloud: Any) -> str:
        """Return how an object differs from its recorded cloud, or SAME."""
        fields = [field.name for field in cloud.fields]
        has = {what: field in fields for what, field in (("normals", "normal_x"), ("velocities", "vx"))}
        readback = Readback(self.world.sim, name, tensions="tension" in fields, **has)
        readback.request()
        ours = np.ascontiguousarray(readback.particles(), "<f4")
        theirs = np.frombuffer(bytes(cloud.data), "<f4").reshape(-1, len(fields))
        if ours.shape != theirs.shape:
            return f"{len(ours)} particles, and {len(theirs)} in the bag"
        other = (ours.view(np.uint32) != theirs.view(np.uint32)).any(axis=1)
        if not other.any():
            return SAME
        far = np.abs(ours[other, :3].astype(np.float64) - theirs[other, :3]).max()
        return f"{other.sum()} of {len(ours)} particles differ, by up to {far:.2g} m"


def compared(bag: Bag, device: str = "") -> Iterator[tuple[int, str, str]]:
    """Yield (frame, object, sentence) for each cloud of a bag; the object is "" for a sentence on the bag.

    Frames are counted from the start of the bag, which is frame 0. Raises ValueError as Replay does.
    """
    replay = Replay(device)
    coming, seen = {name: _Clouds(bag.clouds(name)) for name in bag.objects}, set()
    for at, entry in enumerate(bag.journal):
        lost = replay.follow(entry)
        if lost:
            yield replay.frames, "", lost
        following = bag.journal[at + 1 : at + 2]
        now, then = entry["stamp"], _end(entry, following)
        if now == then:
            continue  # more acts before the next frame, while paused
        for name, clouds in coming.items():
            found = clouds.between(now, then)
            if replay.world is None or name not in replay.world.sim.scene.objects:
                continue
            # Before the first, nobody listened yet; of the last frame it may still have been under way.
            if not found and following and name in seen:
                yield replay.frames, name, NONE
            if found:
                seen.add(name)
            for cloud in found:
                yield replay.frames, name, replay.difference(name, cloud)
    for name in coming.keys() - seen:
        yield replay.frames, name, NONE
    replay.close()


def _end(entry: dict, following: list[dict]) -> Stamp:
    """Return the stamp until which the journal's message `entry` holds, as far as that is known."""
    seconds, nanoseconds = entry["stamp"]
    known = bool(following) and following[0]["sequence"] == entry["sequence"] + 1
    return following[0]["stamp"] if known else (seconds, nanoseconds + 1)


class _Clouds:
    """The clouds of one object, taken in the order of their stamps."""

    def __init__(self, clouds: Iterator[tuple[Stamp, Any]]):
        self._clouds = clouds
        self._next = next(clouds, None)

    def between(self, now: Stamp, then: Stamp) -> list[Any]:
        """Return the clouds sent from `now` on and before `then`; of several with one stamp only the last."""
        found: dict[Stamp, Any] = {}
        while self._next is not None and self._next[0] < then:
            stamp, cloud = self._next
            if stamp >= now:
                found[stamp] = cloud
            self._next = next(self._clouds, None)
        return list(found.values())


def main(arguments: list[str] | None = None) -> int:
    """Print how the frames compare; return 0 if all have the same bits, else 1."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("bag", type=Path, help="folder of a bag")
    parser.add_argument("--device", default="", help="where to compute; by default as the node was told")
    add_plugins_option(parser)
    options = parser.parse_args(arguments)
    warp.config.log_level = warp.LOG_WARNING
    if lack := missing("rosbags"):
        print(f"cloth_sim_replay: {lack}", file=sys.stderr)
        return 1
    try:
        require_plugins(options.plugins)
        bag = Bag(options.bag)
        if bag.cut_short:
            print(f"{options.bag} was not finished by its recorder; this is what it had written")
        return _print(compared(bag, options.device))
    except ValueError as error:
        print(f"cloth_sim_replay: {error}", file=sys.stderr)
        return 1


def _print(rows: Iterator[tuple[int, str, str]]) -> int:
    """Print a line for each series of frames with the same result, and a sum; return the exit status."""
    clouds = same = lost = 0
    for said, group in groupby(rows, lambda row: row[2] if row[2] == SAME else f"{row[1]}: {row[2]}".lstrip(": ")):
        group = list(group)
        first, last = group[0][0], group[-1][0]
        print(f"{f'frame {first}' if first == last else f'frames {first} to {last}'}: {said}", flush=True)
        clouds += sum(name != "" and sentence != NONE for _, name, sentence in group)
        same += len(group) if said == SAME else 0
        lost += sum(name == "" for _, name, _ in group)
    print(f"{clouds} clouds compared, {same} {SAME}, {clouds - same} not")
    return 0 if same == clouds > lost == 0 else 1


if __name__ == "__main__":
    sys.exit(main())
