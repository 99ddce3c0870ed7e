# SPDX-License-Identifier: Apache-2.0
"""Ropes that are solved as a whole: arrays of a batch, and how many elements each has."""

import warp as wp

from cloth_sim_ros.sim.arrays.model import Counts, Features

NUMBERS = 2 * 37  # a particle: planes of the larger layout, each up to twice as long as there are particles

# Array -> what it has a row of; cleared where a body is put elsewhere.
FORGOTTEN = {"tensions": "segment", "chain_forces": "particle", "moments": "segment"}


@wp.struct
class Segment:
    """Scratch of a direct solve at one segment of a chain (see physics/chain.py)."""

    frame: wp.mat33
    admittance: wp.mat33
    compliance: wp.mat33
    free: wp.vec3
    missing: wp.vec3
    moved: wp.vec3
    held: float
    tension: float
    gap: float
    along: float
    across: float
    near: float
    far: float
    reach: float
    turn: float
    too_far: int
    overstretched: int
    unsettled: int
    pull: float


@wp.struct
class BeamRow:
    """Scratch of the solve of a rope's bending at one particle (see ropes/beam.py)."""

    pivot: float
    inverse: float
    first: float
    second: float
    move: wp.vec3
    turn: wp.vec3  # y of beam_rotation.py, where the rest shape is bent


@wp.struct
class RopeState:
    """Ropes that are solved as a whole; see State for the letters."""

    tensions: wp.array(dtype=float)  # (C,) [N]
    targets: wp.array(dtype=wp.vec3)  # (N,) where particles of a chain would be without it [m], chains alone
    solved: wp.array(dtype=wp.vec3)  # (N,) where its last solve put them [m], chains alone
    chain_forces: wp.array(dtype=wp.vec3)  # (N,) of a chain on its particles in the last substep [N], chains alone
    segments: wp.array(dtype=Segment)  # (C,)
    ladder: wp.array(dtype=wp.float64)  # scratch of the same on a CPU (see ropes/elimination.py)
    moments: wp.array(dtype=wp.vec3)  # (C,) bending moment [N m] behind each segment of a chain that bends
    beam: wp.array(dtype=BeamRow)  # (N,)
    bend_moves: wp.array(dtype=wp.vec3)  # (N,) [m] by bending so far in this substep, of ropes that are bent at rest
    overstretched: wp.array(dtype=int)  # (B,) whether a chain is in this substep, as a graph


def sizes(features: Features, n: Counts) -> dict[str, int]:
    """Array -> its elements in one world; 0 where the features do not need it."""
    return {
        "tensions": n.segments,
        "targets": n.particles if features.chain else 0,
        "solved": n.particles if features.chain else 0,
        "chain_forces": n.particles if features.chain else 0,
        "segments": n.segments,
        "ladder": NUMBERS * n.particles if features.chain and n.on_cpu else 0,
        "moments": n.joints,
        "beam": n.particles if features.beam else 0,
        "bend_moves": n.particles if features.bent else 0,
        "overstretched": n.bodies if features.chain else 0,
    }
