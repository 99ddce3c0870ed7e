"""Cloth and rope simulation in NVIDIA Warp, usable without ROS."""

from cloth_sim_ros.sim.colliders.box import Box
from cloth_sim_ros.sim.colliders.capsule import Capsule
from cloth_sim_ros.sim.colliders.plane import Plane
from cloth_sim_ros.sim.colliders.sphere import Sphere
from cloth_sim_ros.sim.objects import Cloth, Rope, Winch
from cloth_sim_ros.sim.readback import EndReadback, Readback
from cloth_sim_ros.sim.scene import Scene, Wind
from cloth_sim_ros.sim.settings import Settings
from cloth_sim_ros.sim.simulation import Simulation

__all__ = [
    "Box", "Capsule", "Cloth", "EndReadback", "Plane", "Readback", "Rope", "Scene", "Settings", "Simulation",
    "Sphere", "Winch", "Wind"
]  # fmt: skip
