# SPDX-License-Identifier: Apache-2.0
"""The arrays of a batch's state: their sizes for the batch's bodies, and the rows of one world.

arrays/state.py, and the file arrays.py of each feature, describe their contents.
"""

from __future__ import annotations

import os

import numpy as np
import warp as wp

from cloth_sim_ros.sim.arrays.masses import BYTES_A_PARTICLE
from cloth_sim_ros.sim.arrays.model import Counts, Features
from cloth_sim_ros.sim.arrays.model_arrays import ModelArrays
from cloth_sim_ros.sim.arrays.state import State
from cloth_sim_ros.sim.arrays.writing import view_of
from cloth_sim_ros.sim.executors import arrays as trial
from cloth_sim_ros.sim.features.air import arrays as air
from cloth_sim_ros.sim.features.collider_contact import arrays as contact
from cloth_sim_ros.sim.features.constraints import arrays as constraints
from cloth_sim_ros.sim.features.grasp import arrays as grasp
from cloth_sim_ros.sim.features.plate import arrays as plate
from cloth_sim_ros.sim.features.seams import arrays as seams
from cloth_sim_ros.sim.features.self_contact import arrays as self_contact
from cloth_sim_ros.sim.features.tearing import arrays as tearing
from cloth_sim_ros.sim.features.twist import arrays as twist
from cloth_sim_ros.sim.features.winch import arrays as winch
from cloth_sim_ros.sim.lines import arrays as lines
from cloth_sim_ros.sim.ropes import arrays as rope
from cloth_sim_ros.sim.substeps import arrays as control

_ALIGNED = 256  # bytes to whose multiple every array is aligned, as allocations are

# Field of State -> the module that owns its arrays. Its `sizes` returns the number of elements of each array in one
# world; 0 if the features do not need it.
OWNERS = {
    "lines": lines, "plate": plate, "rope": rope, "twist": twist, "air": air, "contact": contact,
    "self_contact": self_contact, "constraints": constraints, "seams": seams, "grasp": grasp, "tearing": tearing,
    "winch": winch, "trial": trial, "control": control,
}  # fmt: skip


def rows_by_array(table: str) -> dict[str, str]:
    """Array -> kind of its rows, from the tables FORGOTTEN or KEPT of all OWNERS.

    The kinds are "particle", "segment", "line", "stitch", "body" (a struct a body), "count" (a number a body), and
    "contact" for a row a particle and collider.
    """
    return {name: row for owner in OWNERS.values() for name, row in getattr(owner, table, {}).items()}


def _core_sizes(features: Features, n: Counts) -> dict[str, int]:
    """Sizes of the arrays that every body has."""
    second, looks_back = (n.particles if features.order == 2 else 0), (n.bodies if features.looks_back else 0)
    always = ("positions", "position_lo", "displacements", "velocities", "good_positions")
    return {
        **dict.fromkeys(always, n.particles),
        **dict.fromkeys(("last_velocities", "last_displacements"), second),
        **dict.fromkeys(("faulty", "recoveries", "relapses"), n.bodies),
        "history": looks_back,
        "events": 2 * looks_back,
    }


def make_states(
    arrays: ModelArrays, features: Features, colliders: int, worlds: int, device: wp.Device
) -> tuple[wp.array, dict[str, wp.array]]:
    """One zeroed buffer of bytes, and its parts for the bodies in `arrays` in every world.

    The parts are name in State, or in a struct of it, -> (worlds, size) array. Arrays that `features` do not need are
    empty. Raises ValueError if the device lacks the memory.
    """
    size = arrays.size
    counts = Counts(
        arrays.particles, len(arrays.bodies), colliders, size["line_nodes"], arrays.longest_row, size["segment_length"],
        size["joints"], size["panels"], size["curve_corners"], arrays.stitches[-1].stop, device.is_cpu, size,
    )  # fmt: skip
    sizes, types = _core_sizes(features, counts), dict(State.vars)
    for field, owner in OWNERS.items():
        sizes |= owner.sizes(features, counts)
        types |= State.vars[field].type.vars
    dtypes = {name: types[name].type.dtype for name in sizes}
    each = sum(size * wp.types.type_size_in_bytes(dtypes[name]) for name, size in sizes.items())
    _check_memory(2 * each + BYTES_A_PARTICLE * counts.particles, worlds, device)  # the buffer, and its copy for trials
    ends = np.cumsum(
        [-(-worlds * size * wp.types.type_size_in_bytes(dtypes[name]) // _ALIGNED) for name, size in sizes.items()]
    )
    buffer = wp.zeros(max(1, int(ends[-1])) * _ALIGNED, dtype=wp.uint8, device=device)
    found = {}
    for (name, size), start in zip(sizes.items(), [0, *ends[:-1]], strict=True):
        place = buffer.ptr + int(start) * _ALIGNED
        found[name] = view_of(buffer, place, (worlds, size), dtypes[name])  # may outlive the batch
    return buffer, found


def _check_memory(each: int, worlds: int, device: wp.Device) -> None:
    """Raise ValueError if the state of `worlds` worlds of `each` bytes does not fit the device's free memory."""
    free = device.free_memory if device.is_cuda else os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    if worlds * each > free:
        raise ValueError(
            f"worlds is {worlds} of {each / 1e6:.3g} MB each, more than the {free / 1e6:.4g} MB that are free on "
            f"{device.alias}; allowed are up to {free // each}"
        )


def state_of(states: dict[str, wp.array], world: int) -> State:
    """The State of one world: its row of every array."""
    state = State()
    for name, variable in State.vars.items():
        if name not in OWNERS:
            setattr(state, name, row_of(states[name], world))
            continue
        part = variable.type()
        for each in variable.type.vars:
            setattr(part, each, row_of(states[each], world))
        setattr(state, name, part)
    return state


def row_of(rows: wp.array, world: int) -> wp.array:
    """Row `world` of a (worlds, size) array; an empty row is a new array, as Warp cannot index one."""
    return rows[world] if rows.shape[1] else wp.zeros(0, dtype=rows.dtype, device=rows.device)
