# SPDX-License-Identifier: Apache-2.0
"""The measured error of each body, and the substeps that follow from it: arrays of a batch, and their sizes."""

import warp as wp

from cloth_sim_ros.sim.arrays.model import Counts, Features

# Array -> the element of each of its rows. FORGOTTEN arrays are cleared if a body is placed elsewhere, KEPT ones are
# kept if everything on the device is rebuilt.
FORGOTTEN = {"motions": "body", "asleep": "body", "ledgers": "body"}
KEPT = {"substeps": "count", "taken": "count", "redone": "count"}


@wp.struct
class StepLimits:
    """Bounds of the substeps of one body in a frame.

    start: substeps until an error is measured. least, most: bounds of those chosen from the error. fewest: those to
    which tests of facets for contact may lower both; `least` where there are none. test: cost of such a test, as a
    share of that of a substep without any. error: wanted error, as solver.error. size: largest extent of the body
    [m]. sleeps: 1 if it is not computed while it is at rest. is_set: 1 if a user has set the substeps.
    """

    start: int
    least: int
    most: int
    fewest: int
    test: float
    error: float
    size: float
    sleeps: int
    is_set: int


@wp.struct
class ControlState:
    """Measured errors and the controller's memory; see State for the letters.

    A trial takes 1 / divisor of the substeps. Errors of windows of time are in the units of solver.error. `motions` has
    the largest RMS displacement from the anchors in this window and in the one before [m], and the time since this
    window began [s]. Its last number is the share of the tests for contact that does not fall with the substeps.
    """

    substeps: wp.array(dtype=int)  # (B,) of the next frame; 0: as StepLimits.start
    divisors: wp.array(dtype=int)  # (B,) of this frame; 0: it is no trial
    factors: wp.array(dtype=int)  # (B,) by which a frame that is computed again multiplies them; 0: it is none
    redone: wp.array(dtype=int)  # (B,) number of frames that were computed again
    # (B,) [J]: ceiling of the energy, scale of gains, energy when last found, and that of the weight, see energy.py
    ledgers: wp.array(dtype=wp.vec4d)
    taken: wp.array(dtype=int)  # (B,) substeps of the last frame
    asleep: wp.array(dtype=int)  # (B,) 1 while the body is at rest
    # (B,) since the error was measured: frames, substeps, tests of facets for contact, frames computed again
    since: wp.array(dtype=wp.vec4i)
    # (B,) RMS error of the last measured frame [m] and its order, error in this window and in the one before
    errors: wp.array(dtype=wp.vec4)
    motions: wp.array(dtype=wp.vec4)  # (B,)
    anchors: wp.array(dtype=wp.vec3)  # (N,) positions when the window began [m]


def sizes(features: Features, n: Counts) -> dict[str, int]:
    bodies = ("substeps", "divisors", "factors", "redone", "taken", "since", "asleep", "errors", "motions")
    audited = {"ledgers": n.bodies if features.audited else 0}
    return {**dict.fromkeys(bodies, n.bodies), **audited, "anchors": n.particles if features.measured else 0}
