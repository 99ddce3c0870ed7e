# SPDX-License-Identifier: Apache-2.0
"""Check if a plan can be computed, by NumPy on the host, without a device."""

from __future__ import annotations

from collections.abc import Iterable

import warp

from cloth_sim_ros.ros.parameters.plan import Plan
from cloth_sim_ros.sim.access.live import compliances_of
from cloth_sim_ros.sim.substeps.limits import check_explicit
from cloth_sim_ros.sim.topology import build as build_topology
from cloth_sim_ros.sim.topology.seams import stitches_of

MOST_SWEEPS = 100_000  # a frame: beyond it a frame of a small cloth takes seconds


def broken_meshes(plan: Plan, names: Iterable[str]) -> dict[str, str]:
    """Return name -> why the mesh of a cloth among `names` is no surface, in one sentence."""
    broken = {}
    for name in names:
        if getattr(plan.scene.objects.get(name), "vertices", None) is not None:
            try:
                build_topology(plan.scene.objects[name], name, False)
            except ValueError as error:
                broken[name] = str(error)
    return broken


def broken_seams(plan: Plan) -> dict[str, str]:
    """Return name -> why the seam cannot be sewn, in one sentence, of a plan whose meshes are sound."""
    sewn = {each: build_topology(plan.scene.objects[each], each, False) for each in plan.scene.sewn}
    broken = {}
    for name, seam in plan.scene.seams.items():
        try:
            stitches_of(name, seam, 0, sewn[seam.first], sewn[seam.second])
        except ValueError as error:
            broken[name] = str(error)
    return broken


def check_solver(plan: Plan) -> None:
    """Raise ValueError in one sentence if the plan cannot be computed.

    The device may be missing, explicit steps may be unstable, or a frame may have more than MOST_SWEEPS sweeps.
    """
    try:
        warp.get_device(None if plan.device == "auto" else plan.device)
    except Exception:
        known = ", ".join(device.alias for device in warp.get_devices())
        raise ValueError(f"device is {plan.device!r}; allowed is auto or one of {known}") from None
    settings = plan.settings
    sweeps = max(1, settings.substeps) * max(1, settings.iterations)
    if sweeps > MOST_SWEEPS:
        numbers = f"solver.substeps {settings.substeps} times solver.iterations {settings.iterations}"
        raise ValueError(f"{numbers} are {sweeps} sweeps a frame; allowed are at most {MOST_SWEEPS}")
    if settings.method == "verlet":
        for name, thing in plan.scene.objects.items():
            material = (compliances_of(thing), thing.damping)
            topology = build_topology(thing, name, False, plan.scene.wind is not None)
            check_explicit(plan.scene, settings, name, topology, [material])
