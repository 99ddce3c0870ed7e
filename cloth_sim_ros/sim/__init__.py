# SPDX-License-Identifier: Apache-2.0
"""Cloth and rope simulation in NVIDIA Warp, usable without ROS. From what is described to what is read back:

- scene, objects, materials, colliders/, settings: what there is and how to compute it, checked against the one table;
- topology/: an object as particles and elements, in NumPy: grids, meshes, chains, lines, plates;
- model, state and rope_state: what kernels read and write, constant and varying; model_arrays, state_arrays and
  live_array make it; compiled: how kernels are compiled;
- physics/: formulas on plain values, one concept a file; intrinsics and simd: the little that Warp cannot say;
- stages/: what one particle, panel or contact does in a substep; lines/ and ropes/: each solved as a whole;
- methods/: the program of a substep, written once; what method, substeps and iterations an object is given, and why;
- executors/: how a program runs: a body in blocks, a launch a part; a frame as a trial;
- batch: all of that for objects that share kernels; report, tension, twist, winch, wrench, readback: what is read;
- torn, cuts: what has failed of sheets that tear, and what a polygon cuts; grippers: two fingers, moved from outside;
- saving, saved_file: the whole state in a file, and back; live_values: live numbers as they are now;
- mesh_file, mesh_reading: meshes in files; mesh_repair: what they lack; regular_file: which files are opened;
- tensors, writing: all worlds at once, by arrays and masks; variation: worlds that differ at random;
- simulation, composed of bodies, queries, rope_queries, hands, live, tensors and saving: the public face.
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
from cloth_sim_ros.sim.scene.objects import Cloth, Rope, Winch
from cloth_sim_ros.sim.scene.scene import Scene, Wind
from cloth_sim_ros.sim.scene.settings import Settings
from cloth_sim_ros.sim.simulation import Simulation

__all__ = [
    "Box", "Capsule", "Cloth", "Cylinder", "Ellipsoid", "EndReadback", "Gripper", "GripperDriver", "Handle", "Mesh",
    "Plane", "Readback", "Rope", "Scene", "Settings", "SignedDistance", "Simulation", "Sphere", "Surface", "Variation",
    "Winch", "Wind"
]  # fmt: skip
