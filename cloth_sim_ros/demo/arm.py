# SPDX-License-Identifier: Apache-2.0
"""Drive the arm of config/arm.xml by MuJoCo, with the forces of the towel of config/arm.yaml in its hand."""

from __future__ import annotations

import math

from geometry_msgs.msg import WrenchStamped

from cloth_sim_ros.cosim.arm import Arm, mujoco
from cloth_sim_ros.demo.driver import SceneDriver
from cloth_sim_ros.shared_files import shared

THINGS = {"hand": "handles/hand", "upper": "colliders/upper", "lower": "colliders/lower"}  # site or geom -> its topics
LOAD = 0.2  # [kg] the towel
DELAY = 2.0  # delay in wrenches: a pose waits for the next one, and a frame for its time
LONGEST = 0.1  # [s] longest advance of MuJoCo at once
SWINGS = {"turn": (0.8, 0.1), "lift": (0.2, 0.2), "nod": (0.3, 0.25), "spin": (0.5, 0.15)}  # joint -> rad, Hz


class Driver(SceneDriver):
    """Advances MuJoCo by the time that has passed, sends the arm's poses, and passes wrenches on to it."""

    moves = tuple(THINGS.values())

    def __init__(self):
        super().__init__()
        model = mujoco.MjModel.from_xml_path(str(shared("config/arm.xml")))
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
        self.arm, self._home, self._then = Arm(model, data, THINGS, LOAD, delay=DELAY), data.ctrl.copy(), 0.0
        for name, thing in THINGS.items():
            act = lambda message, name=name: self.feel(name, message)  # noqa: E731
            self.create_subscription(WrenchStamped, f"{self.named}/{thing}/wrench", act, 10)

    def feel(self, name: str, message: WrenchStamped) -> None:
        """Take a wrench of the cloth."""
        force, torque = message.wrench.force, message.wrench.torque
        self.arm.feel(name, (force.x, force.y, force.z, torque.x, torque.y, torque.z))

    def drive(self, t: float) -> None:
        """Send the poses of the arm."""
        for joint, (amplitude, rate) in SWINGS.items():
            number = self.arm.model.actuator(joint).id
            self.arm.data.ctrl[number] = self._home[number] + amplitude * math.sin(2.0 * math.pi * rate * t)
        self.arm.advance(min(max(t - self._then, 0.0), LONGEST))
        self._then = t
        for name, (position, orientation) in self.arm.poses().items():
            self.move(THINGS[name], position, orientation)
