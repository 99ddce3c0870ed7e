# SPDX-License-Identifier: Apache-2.0
"""Messages of a robot, and bags of them, without ROS."""

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

TYPES = get_typestore(Stores.ROS2_JAZZY)
KINDS = TYPES.types
EMPTY = {"/hand": "geometry_msgs/msg/PoseStamped", "/tf_static": "tf2_msgs/msg/TFMessage"}


def of(kind, **fields):
    return KINDS[kind](**fields)


def header(stamp, frame):
    nanoseconds = round(stamp * 1e9)
    time = of("builtin_interfaces/msg/Time", sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
    return of("std_msgs/msg/Header", stamp=time, frame_id=frame)


def vector(kind, values):
    return of(f"geometry_msgs/msg/{kind}", **dict(zip("xyzw", map(float, values), strict=False)))


def transforms(stamp, parent, child, turn, place):
    inner = of(
        "geometry_msgs/msg/Transform",
        translation=vector("Vector3", place),
        rotation=vector("Quaternion", turn.as_quat()),
    )
    stamped = of(
        "geometry_msgs/msg/TransformStamped", header=header(stamp, parent), child_frame_id=child, transform=inner
    )
    return of("tf2_msgs/msg/TFMessage", transforms=[stamped])


def pose(stamp, frame, place, turn):
    inner = of(
        "geometry_msgs/msg/Pose", position=vector("Point", place), orientation=vector("Quaternion", turn.as_quat())
    )
    return of("geometry_msgs/msg/PoseStamped", header=header(stamp, frame), pose=inner)


def array(stamp, frame, points):
    still = of("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
    poses = [of("geometry_msgs/msg/Pose", position=vector("Point", each), orientation=still) for each in points]
    return of("geometry_msgs/msg/PoseArray", header=header(stamp, frame), poses=poses)


def wrench(stamp, frame, force):
    inner = of("geometry_msgs/msg/Wrench", force=vector("Vector3", force), torque=vector("Vector3", [9.0, 9.0, 9.0]))
    return of("geometry_msgs/msg/WrenchStamped", header=header(stamp, frame), wrench=inner)


def cloud(stamp, frame, points, layout="<f4", names="xyz", lost=0):
    """As a driver sends it: in two rows, with colours between, and points that the camera could not see. lost: bytes
    that are not there."""
    points = np.concatenate([points, np.full((2 + len(points) % 2, 3), np.nan)])
    data = np.zeros(len(points), f"{layout}, V4, {layout}, {layout}")
    for name, column in zip(("f0", "f2", "f3"), points.T, strict=True):
        data[name] = column
    kinds = dict(zip([names[0], "rgb", *names[1:]], [data.dtype.fields[f"f{k}"] for k in range(4)], strict=True))
    fields = [
        of("sensor_msgs/msg/PointField", name=name, offset=offset, datatype={4: 7, 8: 8}[kind.itemsize], count=1)
        for name, (kind, offset) in kinds.items()
    ]
    step, sent = data.dtype.itemsize, np.frombuffer(data.tobytes(), np.uint8)
    rest = {"height": 2, "width": len(points) // 2, "is_bigendian": layout[0] == ">", "is_dense": False}
    rest |= {"point_step": step, "row_step": step * len(points) // 2, "data": sent[: len(sent) - lost]}
    return of("sensor_msgs/msg/PointCloud2", header=header(stamp, frame), fields=fields, **rest)


def write(path, topics):
    """A bag: topic -> messages."""
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for topic, messages in topics.items():
            kind = messages[0].__msgtype__ if messages else EMPTY[topic]
            connection = writer.add_connection(topic, kind, typestore=TYPES)
            for k, message in enumerate(messages):
                writer.write(connection, k, TYPES.serialize_cdr(message, kind))
