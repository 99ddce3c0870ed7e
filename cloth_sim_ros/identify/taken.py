# SPDX-License-Identifier: Apache-2.0
"""Read positions and forces from a bag: the messages of a topic, and the pose of their frame by tf."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from cloth_sim_ros.identify.transforms import Track, Transforms, nanoseconds
from cloth_sim_ros.record.topics import Topics

LONGEST = 3600.0  # longest span of stamps [s]; those further apart come from different clocks
_FORMATS = {7: "f4", 8: "f8"}  # of sensor_msgs/PointField

Take = Callable[[Any, str], np.ndarray]  # takes a message and its topic, returns rows


@dataclass(frozen=True)
class Taken:
    """Rows of messages by stamp [ns], their frame, the track of its poses at these stamps, and the count of all
    messages."""

    topic: str
    frame: str
    rows: dict[int, Any]
    place: Track
    count: int

    def told(self, words: str, zero: int, first: int | None) -> str:
        """Return one sentence on the messages from stamp `first` on."""
        times = self.place.times if first is None else self.place.times[self.place.times >= first]
        span = f"from {1e-9 * (times[0] - zero):.3g} to {1e-9 * (times[-1] - zero):.3g} s " if len(times) else ""
        return f"{self.topic}: {len(times)} of {self.count} messages, {span}after the start, {words}."


def taken(bag: Topics, frames: Transforms, ours: str, topic: str, takes: Mapping[str, Take]) -> Taken:
    """Return all messages of a topic at whose stamps the pose of their frame in `ours` is known; "" is their own frame.

    takes: allowed type of the topic -> function that returns the rows of a message. Raises ValueError.
    """
    if bag.types.get(topic) not in takes:
        has = f"is {bag.types[topic]}" if topic in bag.types else "is not there"
        allowed = ", ".join(sorted(name for name, other in bag.types.items() if other in takes))
        kinds = " or ".join(takes)
        raise ValueError(f"{topic} {has} in {bag.path}; allowed is a topic of {kinds}: {allowed or 'it has none'}")
    take = takes[bag.types[topic]]
    rows, places, count = {}, set(), 0
    for message in bag.messages(topic):
        rows[nanoseconds(message.header)] = take(message, topic)
        places.add(message.header.frame_id)
        count += 1
    if len(places) != 1:
        has = f"messages in the frames {', '.join(sorted(places))}" if places else "no messages"
        raise ValueError(f"{topic} has {has} in {bag.path}; allowed are messages in one frame")
    if len(rows) < min(count, 2):
        raise ValueError(f"all {count} messages of {topic} have one stamp in {bag.path}; allowed are stamps that rise")
    stamps = np.array(sorted(rows), dtype=np.int64)
    (frame,) = places
    known, place = frames.place(frame, ours or frame, stamps)
    if not known.any():
        raise ValueError(
            f"{bag.path} has transforms between '{frame}' of {topic} and '{ours}' at other times only; "
            "allowed are messages between the first of them and the last"
        )
    return Taken(topic, frame, {stamp: rows[stamp] for stamp in stamps[known].tolist()}, place, count)


def points_of(cloud: Any, topic: str) -> np.ndarray:
    """Return the points (N, 3) of a cloud, in their order. Raises ValueError if x, y or z is missing or has another
    type."""
    fields = {each.name: each for each in cloud.fields}
    if not all(name in fields and fields[name].datatype in _FORMATS for name in "xyz"):
        raise ValueError(f"{topic} has clouds of {', '.join(fields)}; allowed are x, y and z of 32 or 64 bits")
    order = ">" if cloud.is_bigendian else "<"
    formats = [order + _FORMATS[fields[name].datatype] for name in "xyz"]
    try:
        layout = {"names": list("xyz"), "formats": formats, "offsets": [fields[name].offset for name in "xyz"]}
        dtype = np.dtype({**layout, "itemsize": cloud.point_step})
        lines = np.asarray(cloud.data).reshape(cloud.height, cloud.row_step)[:, : cloud.width * cloud.point_step]
        rows = np.ascontiguousarray(lines).reshape(cloud.height * cloud.width, cloud.point_step).view(dtype)
    except ValueError:
        raise ValueError(
            f"{topic} has a cloud of {len(cloud.data)} bytes that are not {cloud.height} rows of {cloud.width} points; "
            f"allowed are {cloud.row_step} bytes a row and {cloud.point_step} a point"
        ) from None
    return np.column_stack([rows[name].ravel() for name in "xyz"]).astype(np.float64)
