# SPDX-License-Identifier: Apache-2.0
"""Cloth and rope simulation in NVIDIA Warp, usable without ROS. README.md beside this file is a map of it.

From the lowest layer to the highest, as test/test_layers.py holds:

- kernels/, physics/: what Warp needs, and formulas on plain values; input/: files and numbers, checked;
- colliders/, scene/, topology/: shapes, what there is and how to compute it, an object as particles and elements;
- arrays/, and arrays.py of each feature: what kernels read and write, constant and varying;
- features/: what one particle, panel or contact does in a substep; lines/ and ropes/: each solved as a whole;
- substeps/: the order, substeps and iterations of an object, and why; program, stage: a substep, written once;
- executors/: how a program runs; engine/: objects that share kernels, and their frames; access/: what is read and set;
- simulation: the public face; clients/: grippers, read-back, worlds that differ at random.
"""

from cloth_sim_ros.sim.clients.grippers import Gripper, GripperDriver
from cloth_sim_ros.sim.clients.readback import EndReadback, Readback, Surface
from cloth_sim_ros.sim.clients.variation import Variation
from cloth_sim_ros.sim.colliders.box import Box
from cloth_sim_ros.sim.colliders.capsule import Capsule
from cloth_sim_ros.sim.colliders.cylinder import Cylinder
from cloth_sim_ros.sim.colliders.ellipsoid import Ellipsoid
from cloth_sim_ros.sim.colliders.mesh import Mesh
from cloth_sim_ros.sim.colliders.plane import Plane
from cloth_sim_ros.sim.colliders.sphere import Sphere
from cloth_sim_ros.sim.colliders.volume import SignedDistance
from cloth_sim_ros.sim.scene.handles import Handle
from cloth_sim_ros.sim.scene.materials import Fabric
from cloth_sim_ros.sim.scene.objects import Cloth, Rope, Winch
from cloth_sim_ros.sim.scene.scene import Scene, Wind
from cloth_sim_ros.sim.scene.seams import Seam
from cloth_sim_ros.sim.scene.settings import Settings
from cloth_sim_ros.sim.simulation import Simulation

__all__ = [
    "Box", "Capsule", "Cloth", "Cylinder", "Ellipsoid", "EndReadback", "Fabric", "Gripper", "GripperDriver", "Handle",
    "Mesh", "Plane", "Readback", "Rope", "Scene", "Seam", "Settings", "SignedDistance", "Simulation", "Sphere",
    "Surface", "Variation", "Winch", "Wind"
]  # fmt: skip
