# SPDX-License-Identifier: Apache-2.0
"""Scenes for tests of saved states, all that can be told to them while they run, and what a file holds."""

import numpy as np

from cloth_sim_ros.sim import Box, Cloth, Handle, Rope, Scene, Settings, Simulation, Sphere, Winch, Wind

FRAMES = 30
BALL = Sphere(position=(0.0, 0.1, 0.9), radius=0.15)


def cloth_scene(**more):
    """A sheet that bends, in wind, over a ball, with a hand at a free corner and room for another collider."""
    cloth = Cloth(
        resolution=(8, 7),
        size=(0.7, 0.6),
        position=(0, 0, 1.1),
        damping=1e-3,
        **{"bending": "dihedral", "bend_compliance": 1e3, **more},
    )
    hand = Handle(position=(-0.35, -0.3, 1.1), reach=0.12, compliance=1e-4, break_force=50.0)
    return Scene({"cloth": cloth}, {"ball": BALL}, Wind((0.0, 2.0, 0.5)), handles={"hand": hand}, spare_colliders=1)


def ropes_scene():
    """A rope on a winch and one under twist, both over a ball, in wind."""
    winch = Winch(length=0.5, pay_out=0.3, max_rate=2.0, acceleration=3.0)
    cable = Rope(segments=10, start=(0, 0.1, 1.6), end=(0, 0.1, 0.6), end_mass=0.1, damping=1e-3, winch=winch)
    hose = Rope(
        segments=8,
        start=(-0.4, 0, 1.1),
        end=(0.4, 0, 1.1),
        pins=(0, 1, 7, 8),
        bend_compliance=50.0,
        twist_compliance=20.0,
        stretch_compliance=1e-3,
    )
    return Scene({"cable": cable, "hose": hose}, {"ball": BALL}, Wind((0.0, 2.0, 0.5)))


def torn_scene():
    """A sheet that can tear and a rope on a winch: their states hold indices."""
    cable = Rope(segments=5, winch=Winch(length=0.5))
    return Scene({"sheet": Cloth(resolution=(4, 4), tear_strain=0.1), "cable": cable})


def drive(sim, k):
    """What happens before frame k: everything that may be told to a simulation while it runs."""
    world = sim.worlds - 1
    sim.set_collider_pose("ball", (0.02 * np.sin(k), 0.1, 0.9 + 0.01 * k), (0, 0, np.sin(0.1 * k), np.cos(0.1 * k)))
    if k == 3:
        sim.set_wind((0.5, 4.0, 0.0), world)
        sim.set("gravity", (0.1, 0.0, -9.7), world)
    if k == 16:
        sim.set("solver.global_damping", 0.3)
    if "cloth" in sim.scene.objects:
        drive_cloth(sim, k, world)
    else:
        drive_ropes(sim, k)


def drive_cloth(sim, k, world):
    if "hand" in sim.scene.handles:
        drive_hand(sim, k, world)
    if k == 4:
        sim.set("cloth.stretch_compliance", 3e-3, world)
    if k == 6 and sim.scene.spare_colliders:
        sim.add_collider("box", Box(position=(0.2, -0.2, 1.0), half_extents=(0.1, 0.1, 0.05), static_friction=0.9))
    if k == 9:
        sim.set("cloth.pins", [0, 7, 49])
    if k == 13 and sim.settings.method == "auto":  # beyond what explicit steps are for
        sim.set_positions("cloth", 1.7 * sim.positions("cloth"))
    if k == 20:
        fast = np.zeros((56, 3))
        fast[10] = 5e5  # runs away, and is put back
        sim.set_velocities("cloth", fast, world)
    if k == 24 and sim.scene.spare_colliders:
        sim.remove_collider("box")


def drive_hand(sim, k, world):
    sim.set_handle_pose("hand", (-0.35, -0.3, 1.1 + 0.005 * k), world=world)
    if k == 4:
        sim.attach("hand")
    if k == 24:
        sim.set("hand.break_force", 0.01)


def drive_ropes(sim, k):
    sim.set("hose.end_turn", 0.1 * k)
    if k == 12:
        sim.set("cable.winch.pay_out", -1.5)
    if k == 18:
        sim.set("hose.bend_compliance", 20.0)


CASES = {
    "auto": (cloth_scene, {}, 1, None),
    "order 1, two worlds": (cloth_scene, {"method": "xpbd", "order": 1, "substeps": 8}, 2, None),
    "order 2, a launch a stage": (cloth_scene, {"method": "xpbd", "order": 2, "substeps": 8}, 1, "graph"),
    "verlet, two worlds": (cloth_scene, {"method": "verlet"}, 2, None),
    "ropes": (ropes_scene, {}, 1, None),
    "ropes, order 1": (ropes_scene, {"method": "xpbd", "order": 1, "substeps": 8}, 1, None),
}


def make(case, device):
    scene, settings, worlds, executor = CASES[case]
    return Simulation(scene(), Settings(**settings), device, worlds, executor=executor)


def run(sim, first, after=lambda k: None):
    """Frames from `first` to the last; after(k) is called when frame k has been told all, before it is computed."""
    for k in range(first, FRAMES):
        drive(sim, k)
        after(k)
        sim.step()


def contents(path):
    """Name -> type, shape and bytes of each array of a file."""
    with np.load(path, allow_pickle=False) as file:
        return {name: (file[name].dtype, file[name].shape, file[name].tobytes()) for name in file.files}


def saved(sim, path):
    sim.save(path)
    return contents(path)
