"""What sweeps over colours need where they are not symmetric, so that they feed no energy."""

import warp as wp

from cloth_sim_ros.sim.model import Body
from cloth_sim_ros.sim.state import Frame, Material


@wp.func
def is_stiffer(times: float, body: Body, material: Material, frame: Frame) -> bool:
    """Whether springs of any kind are more than `times` as stiff as what a substep's inertia can hold against them."""
    return wp.max(body.lightness - times * material.compliance / (frame.dt * frame.dt)) > 0.0


FAR_STIFFER = wp.constant(50.0)  # than a sweep over colours can meet
FED = wp.constant(1.5)  # times 1 + iterations as stiff, sweeps in one direction feed energy
CALMED = wp.constant(5.0e-5)  # [s] of a substep of one sweep that has to be damped as by implicit Euler then


@wp.func
def parts_of_motion(body: Body, material: Material, frame: Frame) -> float:
    """The parts p of the last displacement, of which order 2 carries on one, b = d_prev / p: 3 is BDF2.

    Sweeps over several colours that do not come in pairs, there and back, are not symmetric: where they leave most of a
    stiff spring's error they act as one with negative damping, which BDF2 does not outweigh, and energy grows. A share
    1 - 3 / p of implicit Euler's damping does: a quarter, and more where substeps are so short that it damps little.
    The error of such a share is below what the sweeps leave. Pairs need it in short substeps alone, as within a cell
    springs have one order.
    """
    sweeps = float(frame.iterations)
    share = CALMED / (frame.dt * sweeps)
    pairs = frame.iterations % 2 == 0 and is_stiffer(FAR_STIFFER, body, material, frame)
    fed = is_stiffer(FED * (1.0 + sweeps), body, material, frame) and (not pairs or share > 0.2)
    single = frame.iterations == 1 and is_stiffer(0.5, body, material, frame)
    kept = 1.0 - wp.where(fed, wp.clamp(share, 0.25, 0.999999), 0.25)
    return wp.where((fed or single) and body.groups_end - body.groups > 1, 3.0 / kept, 3.0)


@wp.func
def goes_back(iteration: int, body: Body, material: Material, frame: Frame) -> bool:
    """Whether an iteration of order 2 takes the colours in the opposite order, as every second one does where springs
    are stiffer by far than a sweep can meet: sweeps that always favour the same end feed such a cloth energy. On softer
    ones they converge better in one direction, to errors up to eight times smaller.
    """
    return is_stiffer(FAR_STIFFER, body, material, frame) and iteration % 2 == 1
