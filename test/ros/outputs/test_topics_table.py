# SPDX-License-Identifier: Apache-2.0
"""The table of topics and services, in README and reference, is what a node with everything has."""

import re

from node_process import ROOT

SCENE = """
/**:
  ros__parameters:
    objects: [towel, cable]
    colliders: [ball]
    handles: [hand]
    grippers: [jaw]
    towel: {type: cloth, resolution: [4, 4]}
    cable: {type: rope, start: [0, 0, 2], end: [0, 0, 1], segments: 8, winch: {enabled: true, length: 0.5}}
    ball: {shape: sphere, dimensions: [0.1], position: [0, 0, -3]}
    hand: {position: [0, 0, 3]}
    wind: {enabled: true}
    spare_colliders: 1
    publish_clock: true
"""
NAMES = {
    "<object>": ("towel", "cable"),
    "<rope>": ("cable",),
    "<collider>": ("ball",),
    "<handle>": ("hand",),
    "<gripper>": ("jaw",),
}
EVERY_NODE = r"/(rosout|parameter_events|tf|tf_static|clock)|.*/(\w*parameter\w*|get_type_description)"


def rows(page):
    """(direction, name, type) of the table in a page, a row for each name in a cell."""
    found = set()
    for way, names, kind in re.findall(r"^\| (in|out|service) \| (.*?) \| (\w+/\w+) \|", page, flags=re.MULTILINE):
        found |= {(way, name, kind) for name in re.findall(r"`(.*?)`", names)}
    return found


def expanded(found):
    """With the names of SCENE, and ~ as the node."""
    for placeholder, names in NAMES.items():
        found = {
            (way, name.replace(placeholder, one), kind) for way, name, kind in found for one in names
        }  # names without a placeholder stay as they are
    return {(way, name.replace("~", "/cloth_sim"), kind) for way, name, kind in found}


def test_it_is_what_the_node_has(start, client):
    start(SCENE)
    node = client.node
    listed = rows((ROOT / "README.md").read_text())
    assert len(listed) > 20 and rows((ROOT / "docs/reference/ros.md").read_text()) == listed
    wanted = expanded(listed)

    def there():
        """What the graph says of the node."""
        asked = {
            "in": node.get_subscriber_names_and_types_by_node,
            "out": node.get_publisher_names_and_types_by_node,
            "service": node.get_service_names_and_types_by_node,
        }
        if ("cloth_sim", "/") not in node.get_node_names_and_namespaces():
            return set()
        return {
            (way, name, re.sub("/(msg|srv)/", "/", types[0]))
            for way, ask in asked.items()
            for name, types in ask("cloth_sim", "/")
            if not re.fullmatch(EVERY_NODE, name) or (way, name) == ("out", "/clock")
        }

    client.until(lambda: len(there()) >= len(wanted), timeout=60.0)
    assert there() == wanted
