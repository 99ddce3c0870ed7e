"""Cloth and rope simulation in NVIDIA Warp, usable without ROS. From what is described to what is read back:

- scene, objects, materials, colliders/, settings: what there is and how to compute it, checked (checks) against the one
  table;
- topology/: an object as particles and elements, in NumPy; cells and tiling cut it into pieces;
- limits, choice: which method an object can take, and takes;
- model and state: what kernels read and write, constant and varying; model_arrays, state_arrays and live_array make it;
- physics/: one concept a file, on values; constraints/: these on the elements; schedules/: the order they run in;
- batch: all of that for objects that share kernels; poses: where colliders go; starts: what a hard start needs;
- report, tension, twist, winch, wrench: what is measured; readback: what messages hold;
- simulation, in parts bodies, queries, ropes and live: the public face.
"""

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
