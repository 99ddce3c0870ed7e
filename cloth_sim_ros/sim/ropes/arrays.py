# SPDX-License-Identifier: Apache-2.0
"""Ropes with a direct solve: arrays of a batch, and their sizes."""

import warp as wp

from cloth_sim_ros.sim.arrays.model import Counts, Features

NUMBERS = 2 * 37  # float64 a particle in `ladder`: planes of the larger layout, each up to 2 N long for N particles

# Array -> the element of each of its rows. These arrays are cleared if a body is placed elsewhere.
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
    turn: wp.vec3  # y of beam_rotation.py, if the rest shape is bent


@wp.struct
class RopeState:
    """State of ropes with a direct solve; see State for the letters."""

    tensions: wp.array(dtype=float)  # (C,) [N]
    targets: wp.array(dtype=wp.vec3)  # (N,) displacements that particles would have without the chain [m], chains alone
    solved: wp.array(dtype=wp.vec3)  # (N,) displacements after the chain's last solve [m], chains alone
    chain_forces: wp.array(dtype=wp.vec3)  # (N,) force of a chain on its particles, last substep [N], chains alone
    segments: wp.array(dtype=Segment)  # (C,)
    ladder: wp.array(dtype=wp.float64)  # scratch of the direct solve on a CPU (see ropes/elimination.py)
    moments: wp.array(dtype=wp.vec3)  # (C,) bending moment [N m] after each segment of a chain that bends
    beam: wp.array(dtype=BeamRow)  # (N,)
    bend_moves: wp.array(dtype=wp.vec3)  # (N,) displacement by bending so far in this substep [m], ropes bent at rest
    overstretched: wp.array(dtype=int)  # (B,) 1 if a chain is overstretched in this substep


def sizes(features: Features, n: Counts) -> dict[str, int]:
    """Return the number of elements of each array in one world; 0 if the features do not need it."""
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
