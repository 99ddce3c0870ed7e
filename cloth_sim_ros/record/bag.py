# SPDX-License-Identifier: Apache-2.0
"""Read a bag for a replay: the journal of a node and its particle clouds, by cloth_sim_record or ros2 bag."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from cloth_sim_ros import parameters as table
from cloth_sim_ros.record.topics import CLOUD, Topics
from cloth_sim_ros.ros.journal import VERSION
from cloth_sim_ros.ros.parameters import names

MAKE_ONE = "make one with cloth_sim_record or `ros2 bag record -a`"

Stamp = tuple[int, int]  # seconds, nanoseconds


class Bag:
    """A recording of one node. Raises ValueError in one sentence if the bag is no such recording or is damaged.

    node: its full name; journal: its messages, as cloth_sim_ros/ros/journal.py says, from the first start on that
    clouds belong to; objects: those with clouds; cut_short: True if its recorder was killed.
    """

    def __init__(self, path: Path):
        self._path, self._topics = path, Topics(path)
        self.cut_short = self._topics.cut_short
        journals = {topic for topic in self._topics.types if topic.endswith("/journal")}
        clouds = {topic for topic, kind in self._topics.types.items() if kind == CLOUD}
        if len(journals) != 1:
            found = f"topics {', '.join(sorted(journals))}" if journals else "no topic /NODE/journal"
            raise ValueError(f"{path} has {found}; a replay needs one, which says when inputs acted: {MAKE_ONE}")
        (topic,) = journals
        self.node = topic.removesuffix("/journal")
        self._clouds = {
            cloud.removeprefix(f"{self.node}/").removesuffix("/particles"): cloud
            for cloud in sorted(clouds)
            if cloud.startswith(f"{self.node}/") and cloud.endswith("/particles")
        }
        if not self._clouds:
            raise ValueError(f"{path} has no topic {self.node}/OBJECT/particles to compare with; {MAKE_ONE}")
        self.objects = tuple(self._clouds)
        starts, acts = (
            deque(self._entry(message.data) for message in self._topics.messages(each))
            for each in (topic, f"{topic}/acts")
        )
        self.journal = self._with_clouds(_in_order(starts, acts))

    def clouds(self, name: str) -> Iterator[tuple[Stamp, Any]]:
        """Yield stamp and cloud of an object, in the order of the bag."""
        for message in self._topics.messages(self._clouds[name]):
            yield (message.header.stamp.sec, message.header.stamp.nanosec), message

    def _with_clouds(self, journal: list[dict]) -> list[dict]:
        """Return the journal without the messages before the start that the first cloud belongs to.

        Late listeners get such old messages. If clouds come before the journal starts, it begins with the first start
        after them. Raises ValueError if there is no start.
        """
        first = min((next(self.clouds(name), ((1 << 62, 0), None))[0] for name in self.objects), default=(0, 0))
        starts = [at for at, entry in enumerate(journal) if "start" in entry]
        if not starts:
            raise ValueError(f"{self._path} has no start in {self.node}/journal; {MAKE_ONE}, and let it run a while")
        for at in starts:
            self._check(journal[at]["start"]["parameters"])
        ends = [at for at, entry in enumerate(journal) if "end" in entry and entry["stamp"] <= first]
        running = [at for at in starts if not ends or at > ends[-1]] or starts[-1:]
        before = [at for at in running if journal[at]["stamp"] <= first]
        return journal[before[-1] if before else running[0] :]

    def _check(self, parameters: dict[str, Any]) -> None:
        """Raise ValueError if a version with other parameters made the recording."""
        rows = names.fixed_rows()
        if all(name in parameters for name in rows):
            rows |= names.scene_rows(parameters)
        lacks = sorted(set(rows) - set(parameters))
        if lacks:
            raise ValueError(
                f"{self._path} was recorded by another version of cloth_sim_ros, as it lacks the parameter {lacks[0]}; "
                "allowed are bags of this version"
            )
        for name, row in rows.items():
            table.check(row, parameters[name], f"{self._path}: {name}")

    def _entry(self, text: str) -> dict:
        try:
            entry = json.loads(text)
            version, entry["stamp"] = entry["version"], tuple(map(int, entry["stamp"]))
            sound = version != VERSION or _is_sound(entry)
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError, OverflowError):
            sound = False
        if not sound:
            raise ValueError(f"{self._path} has a {self.node}/journal that no cloth_sim node wrote")
        if version != VERSION:
            raise ValueError(f"{self._path} has a journal of version {version}; allowed is {VERSION}")
        return entry


def _is_sound(entry: dict) -> bool:
    """Return True if a message of a journal has the required fields."""
    start, acts = entry.get("start"), entry.get("acts")
    return (
        isinstance(entry["sequence"], int)
        and len(entry["stamp"]) == 2
        and sum(what in entry for what in ("start", "acts", "end")) == 1
        and (start is None or [type(start[key]) for key in ("parameters", "poses", "state")] == [dict, dict, str])
        and (acts is None or all(isinstance(act, list) and act and isinstance(act[0], str) for act in acts))
    )


def _in_order(starts: deque[dict], acts: deque[dict]) -> list[dict]:
    """Return the messages of two topics in the order of their sequence, which restarts if the node did."""
    found: list[dict] = []
    while acts and starts:
        wanted = found[-1]["sequence"] + 1 if found else 0
        heads = acts[0]["sequence"], starts[0]["sequence"]
        found.append((starts if heads[1] == wanted or heads[0] != wanted and heads[1] < heads[0] else acts).popleft())
    return [*found, *acts, *starts]
