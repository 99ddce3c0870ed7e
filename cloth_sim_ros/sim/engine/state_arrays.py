# SPDX-License-Identifier: Apache-2.0
"""The arrays of a batch's state: how large each has to be for what the batch holds, and what one world sees of them.

What they hold is said where kernels see them, in state.py.
"""

from __future__ import annotations

import os

import warp as wp

from cloth_sim_ros.sim.arrays.masses import BYTES_A_PARTICLE
from cloth_sim_ros.sim.arrays.model import Features
from cloth_sim_ros.sim.arrays.model_arrays import ModelArrays
from cloth_sim_ros.sim.arrays.state import State
from cloth_sim_ros.sim.features.collider_contact.broad_phase import EXTENT, words_of
from cloth_sim_ros.sim.features.collider_contact.sweep import SWEPT
from cloth_sim_ros.sim.features.self_contact.solve import ASKED
from cloth_sim_ros.sim.features.tearing.tear import LEFT
from cloth_sim_ros.sim.lines.solve import scratch_of
from cloth_sim_ros.sim.ropes.elimination import NUMBERS


def make_states(
    arrays: ModelArrays, features: Features, colliders: int, worlds: int, device: wp.Device
) -> dict[str, wp.array]:
    """Name in State -> zeroed (worlds, size) array, for the bodies in `arrays` in every world.

    Arrays that `features` do not need have no element. Raises ValueError where the device has not the memory.
    """
    particles, bodies = arrays.particles, len(arrays.bodies)
    second = particles if features.order == 2 else 0
    explicit = particles if features.method == "verlet" else 0
    sizes = {
        "positions": particles,
        "position_lo": particles,
        "displacements": particles,
        "velocities": particles,
        "last_velocities": second,
        "last_displacements": second,
        "line_multipliers": arrays.size["line_nodes"],
        "line_slips": arrays.size["line_nodes"] if features.order == 2 else 0,
        "tautness": particles if arrays.size["line_nodes"] else 0,
        "line_scratch": scratch_of(arrays.longest_row) if device.is_cpu else 0,
        "predicted": particles if features.plate else 0,
        "curve_normals": arrays.size["curve_corners"],
        "curve_pulls": arrays.size["curve_corners"],
        "tensions": arrays.size["segment_length"],
        "targets": particles if features.chain else 0,
        "solved": particles if features.chain else 0,
        "chain_forces": particles if features.chain else 0,
        "segments": arrays.size["segment_length"],
        "ladder": NUMBERS * particles if features.chain and device.is_cpu else 0,
        "moments": arrays.size["joints"],
        "beam": particles if features.beam else 0,
        "bend_moves": particles if features.bent else 0,
        "couples": arrays.size["joints"] if features.twist else 0,
        "twists": bodies if features.twist else 0,
        "good_twists": bodies if features.twist else 0,
        "ahead_positions": second if features.panels else 0,
        "ahead_velocities": second if features.panels else 0,
        "panel_forces": arrays.size["panels"] if features.panels else 0,
        "contacts": particles * colliders,
        "contact_forces": particles * colliders,
        "supports": particles if features.supported else 0,
        "presses": arrays.size["panels"] * colliders if features.surface else 0,
        "looks": arrays.size["panels"] * colliders if features.surface else 0,
        "close": particles if features.surface else 0,
        "pressed": particles if features.surface else 0,
        "facets_moved_in": bodies if features.surface else 0,
        "path_starts": particles if features.coupled else 0,
        "path_velocities": particles if features.coupled else 0,
        "pair_corrections": ASKED * particles if features.coupled else 0,
        "off_path": particles if features.coupled else 0,
        "ways_given_up": particles if features.coupled else 0,
        "sweeps": SWEPT * bodies * colliders,
        "near": bodies * words_of(colliders),
        "extents": EXTENT * bodies if colliders else 0,
        "boxes": 2 * bodies if colliders else 0,
        "grips": particles if features.handles else 0,
        "grip_pulls": particles if features.handles else 0,
        "grip_forces": particles if features.handles else 0,
        "held": bodies if features.handles else 0,
        **{name: arrays.size[name] if features.tears else 0 for name in LEFT},
        "tearing": bodies if features.tears else 0,
        "winches": bodies if features.winch else 0,
        "good_winches": bodies if features.winch else 0,
        "good_positions": particles,
        "start_positions": explicit,
        "start_position_lo": explicit,
        "start_velocities": explicit,
        "start_recoveries": bodies if explicit else 0,
        "strain_found": bodies if explicit else 0,
        "strain": bodies if explicit else 0,
        "rejected": bodies if explicit else 0,
        "redone": bodies if explicit else 0,
        "faulty": bodies,
        "recoveries": bodies,
        "relapses": bodies,
        "overstretched": bodies if features.chain else 0,
        "history": bodies if features.looks_back else 0,
        "events": 2 * bodies if features.looks_back else 0,
    }
    dtypes = {name: State.vars[name].type.dtype for name in sizes}
    each = sum(size * wp.types.type_size_in_bytes(dtypes[name]) for name, size in sizes.items())
    each += BYTES_A_PARTICLE * particles
    _check_memory(each, worlds, device)
    return {name: wp.zeros((worlds, size), dtype=dtypes[name], device=device) for name, size in sizes.items()}


def _check_memory(each: int, worlds: int, device: wp.Device) -> None:
    """Raise ValueError where the state of `worlds` worlds of `each` bytes does not fit the device's free memory."""
    free = device.free_memory if device.is_cuda else os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    if worlds * each > free:
        raise ValueError(
            f"worlds is {worlds} of {each / 1e6:.3g} MB each, more than the {free / 1e6:.4g} MB that are free on "
            f"{device.alias}; allowed are up to {free // each}"
        )


def state_of(states: dict[str, wp.array], world: int) -> State:
    """The State of one world: its row of every array."""
    state = State()
    for name, rows in states.items():
        setattr(state, name, row_of(rows, world))
    return state


def row_of(rows: wp.array, world: int) -> wp.array:
    """Row `world` of a (worlds, size) array; an empty row is an array of its own, which Warp's indexing lacks."""
    return rows[world] if rows.shape[1] else wp.zeros(0, dtype=rows.dtype, device=rows.device)
