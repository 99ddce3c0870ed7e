# SPDX-License-Identifier: Apache-2.0
"""A scene that takes all kinds of inputs, for tests of saved states and recordings, and a box that is added to it."""

from visualization_msgs.msg import Marker, MarkerArray

SCENE = """
/**:
  ros__parameters:
    objects: [cloth, cable]
    colliders: [ball]
    handles: [hand]
    spare_colliders: 1
    wind: {enabled: true}
    cloth: {type: cloth, resolution: [7, 6], size: [0.6, 0.5], pins: corners, position: [0, 0, 1], damping: 0.001,
            bending: dihedral, bend_compliance: 1000.0}
    cable: {type: rope, segments: 8, start: [1, 0, 2], end: [1, 0, 1], end_mass: 0.1,
            winch: {enabled: true, length: 0.5, acceleration: 4.0, timeout: 0.2}}
    ball: {shape: sphere, dimensions: [0.15], position: [0, 0, 0.83]}
"""


def box(action):
    """What adds the collider box/3 on ~/scene, or takes it away."""
    marker = Marker(type=Marker.CUBE, action=action, ns="box", id=3)
    marker.pose.position.x, marker.pose.position.y, marker.pose.position.z = 0.15, -0.15, 0.88
    marker.pose.orientation.w = 1.0
    marker.scale.x = marker.scale.y = marker.scale.z = 0.2
    return MarkerArray(markers=[marker])
