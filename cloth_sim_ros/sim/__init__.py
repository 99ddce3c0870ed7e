"""Cloth and rope simulation in NVIDIA Warp, usable without ROS."""

from cloth_sim_ros.sim.readback import EndReadback, Readback
from cloth_sim_ros.sim.scene import Box, Capsule, Cloth, Plane, Rope, Scene, Settings, Sphere, Winch, Wind
from cloth_sim_ros.sim.simulation import Simulation

__all__ = [
    "Box", "Capsule", "Cloth", "EndReadback", "Plane", "Readback", "Rope", "Scene", "Settings", "Simulation",
    "Sphere", "Winch", "Wind"
]  # fmt: skip
