"""A Newton step of third order along a rope by one thread of a CPU, from both its ends at once (see walks.py).

The quantities are those of radau.py, those of segments and particles told of four at a time.
"""

import warp as wp

from cloth_sim_ros.sim.model import Body, Model
from cloth_sim_ros.sim.physics.complex_chain import FIRST_LEFT, FIRST_RIGHT, LAMBDA, MU, SECOND_LEFT
from cloth_sim_ros.sim.physics.distance import SHORTEST
from cloth_sim_ros.sim.physics.integrate import Step
from cloth_sim_ros.sim.schedules.segments import LARGEST_TURN, SETTLED_SPEED, STIFFEST, TORN
from cloth_sim_ros.sim.schedules.walks import FEWEST, LANES, make_walk, planes
from cloth_sim_ros.sim.state import Material, StagedSegment, State

_PLANES = f"""
{planes(2)}{LANES}
Row *first_moves = (Row*)(stages.data + particles), *moves = (Row*)d;
const double lambda[2] = {{{LAMBDA[0]}, {LAMBDA[1]}}}, mu[2] = {{{MU[0]}, {MU[1]}}};
const double right[2] = {{{FIRST_RIGHT[0]}, {FIRST_RIGHT[1]}}}, left[2] = {{{FIRST_LEFT}, {SECOND_LEFT}}};
"""

_PREPARE = f"""
#if defined(__CUDA_ARCH__)
return false;
#else
{_PLANES}
const Row *places = (const Row*)x, *lost = (const Row*)low;
for (int i = 0; i <= n; ++i) {{
    const double w = moves[i][3], drag = first_moves[i][3];
    const double mass[2] = {{mu[0] + drag * lambda[0], mu[1] + drag * lambda[1]}};
    const double scale = w / (mass[0] * mass[0] + mass[1] * mass[1]);
    plane(WEIGHT)[i] = scale * mass[0];
    plane(WEIGHT + 1)[i] = -scale * mass[1];
    if (!again) continue;
    const float *first = (const float*)(first_targets.data + particles + i);
    const float *second = (const float*)(targets.data + particles + i);
    for (int axis = 0; axis < 3; ++axis) {{
        const double lacks[2] = {{first[axis] - first_moves[i][axis], second[axis] - moves[i][axis]}};
        plane(MISSING + 2 * axis)[i] = w > 0.0 ? 0.5 * lacks[1] : 0.0;
        plane(MISSING + 2 * axis + 1)[i] = w > 0.0 ? left[0] * lacks[0] - left[1] * lacks[1] : 0.0;
    }}
}}
const double square = (double)effective * effective;
// What a dashpot leaves: 1 / (1 + gamma lambda).
const double damped[2] = {{1.0 + gamma * lambda[0], gamma * lambda[1]}};
const double part = 1.0 / (damped[0] * damped[0] + damped[1] * damped[1]);
const double eased[2] = {{damped[0] * part, -damped[1] * part}};
bool lengths = true;
for (int begin = 0; begin < n; begin += 4) {{
    const int k = begin < n - 4 ? begin : n - 4;
    Row rows[2][4];
    Four first[3], second[3], n2[3];
    for (int s = 0; s < 4; ++s) {{
        const Row edge = places[k + s + 1] - places[k + s];
        rows[0][s] = edge + (first_moves[k + s + 1] - first_moves[k + s]);
        rows[1][s] = edge + (moves[k + s + 1] - moves[k + s]);
    }}
    turn(rows[0], first);
    turn(rows[1], second);
    const Four first_length = __builtin_elementwise_sqrt(dot(first, first));
    const Four length = __builtin_elementwise_sqrt(dot(second, second));
    const Four rest = __builtin_convertvector(*(const Row*)(rests.data + segments + k), Four);
    Four pulls[2];
    for (int s = 0; s < 4; ++s) {{
        pulls[0][s] = square * staged.data[segments + k + s].first;
        pulls[1][s] = square * staged.data[segments + k + s].second;
    }}
    const Four yields = (double)(compliance * inverse_square) * rest;
    Four gaps[2] = {{first_length - rest - yields * pulls[0], length - rest - yields * pulls[1]}};
    if (gamma > 0.0f) {{
        Four change[3], sum[3], slips[2];
        for (int stage = 0; stage < 2; ++stage) {{
            const Row* by = stage == 0 ? first_moves : moves;
            const Four* e = stage == 0 ? first : second;
            Row changes[4];
            for (int s = 0; s < 4; ++s) changes[s] = (by[k + s + 1] - by[k + s]) - (lost[k + s + 1] - lost[k + s]);
            turn(changes, change);
            slips[stage] = elongation(e, change, stage == 0 ? first_length : length);
        }}
        gaps[0] += (double)gamma * (1.5 * slips[0] + 0.5 * slips[1]);
        gaps[1] += (double)gamma * (2.5 * slips[1] - 4.5 * slips[0]);
    }}
    const Four re = 0.5 * gaps[1], im = left[0] * gaps[0] - left[1] * gaps[1];
    const Four gap[2] = {{eased[0] * re - eased[1] * im, eased[0] * im + eased[1] * re}};
    const Four near = {{moves[k][3], moves[k + 1][3], moves[k + 2][3], moves[k + 3][3]}};
    const Four far = {{moves[k + 1][3], moves[k + 2][3], moves[k + 3][3], moves[k + 4][3]}};
    const Four softest = larger(1.0e-9 * larger(near, far), Four(least));
    const Four along[2] = {{larger(yields * eased[0], softest), yields * eased[1]}};
    const Four scale = 1.0 / (along[0] * along[0] + along[1] * along[1]);
    const Four stiff[2] = {{along[0] * scale, -along[1] * scale}};
    const Four across = larger(pulls[1], Four(0.0)) / larger(length, 1.0e-3 * rest);
    const auto held = near + far == 0.0;  // nothing moves between two that are pinned
    at(G, k) = held ? Four(0.0) : across;
    at(KAPPA, k) = held ? Four(0.0) : stiff[0] - across;
    at(KAPPA + 1, k) = held ? Four(0.0) : stiff[1];
    at(PUSH, k) = held ? Four(0.0) : stiff[0] * gap[0] - stiff[1] * gap[1];
    at(PUSH + 1, k) = held ? Four(0.0) : stiff[0] * gap[1] + stiff[1] * gap[0];
    at(REACH, k) = larger(length, rest);
    const Four first_pull = pulls[0] / larger(first_length, Four(shortest));
    const Four inverse = 1.0 / larger(length, Four(shortest));
    for (int axis = 0; axis < 3; ++axis) {{
        const Four direction = second[axis] * inverse;
        at(N + axis, k) = direction;
        at(HELD + 2 * axis, k) = 0.5 * pulls[1] * direction;
        at(HELD + 2 * axis + 1, k) = left[0] * first_pull * first[axis] - left[1] * pulls[1] * direction;
    }}
    lengths = lengths && __builtin_reduce_and((length >= (double)shortest) & (first_length >= (double)shortest));
}}
return lengths;
#endif
"""

_MOVE = f"""
#if defined(__CUDA_ARCH__)
return wp::vec_t<2, wp::int32>();
#else
{_PLANES}
for (int begin = 0; begin <= n; begin += 4) {{
    const int k = begin < n - 3 ? begin : n - 3;
    for (int axis = 0; axis < 6; axis += 2) {{
        const Four w[2] = {{at(WEIGHT, k), at(WEIGHT + 1, k)}};
        const Four push[2] = {{
            at(FORCE + axis, k + 1) - at(FORCE + axis, k), at(FORCE + axis + 1, k + 1) - at(FORCE + axis + 1, k)
        }};
        const Four moved[2] = {{w[0] * push[0] - w[1] * push[1], w[0] * push[1] + w[1] * push[0]}};
        at(MOVED + axis, k) = again ? moved[0] + at(MISSING + axis, k) : moved[0];
        at(MOVED + axis + 1, k) = again ? moved[1] + at(MISSING + axis + 1, k) : moved[1];
    }}
}}
bool smooth = true, rests = true;
for (int begin = 0; begin < n; begin += 4) {{
    const int k = begin < n - 4 ? begin : n - 4;
    Four change[3], direction[3];
    for (int axis = 0; axis < 3; ++axis) {{
        change[axis] = 2.0 * (at(MOVED + 2 * axis, k + 1) - at(MOVED + 2 * axis, k));
        direction[axis] = at(N + axis, k);
    }}
    const Four along = dot(direction, change), reach = at(REACH, k);
    const Four turned = (dot(change, change) - along * along) / (reach * reach);
    const auto near = along * along <= (double)torn * torn * reach * reach;
    smooth = smooth && __builtin_reduce_and((turned <= (double)largest_turn) & near);
    rests = rests && __builtin_reduce_and(0.5 * turned * reach <= (double)settled);
}}
for (int k = 0; k < n; ++k) {{
    double gain[2] = {{0.0, 0.0}};
    for (int axis = 0; axis < 6; ++axis) {{
        gain[axis % 2] += plane(N + axis / 2)[k] * (plane(FORCE + axis)[k + 1] - plane(HELD + axis)[k]);
    }}
    auto& segment = staged.data[segments + k];
    segment.first += (float)(2.0 * (right[0] * gain[0] - right[1] * gain[1]) * inverse_square);
    segment.second += (float)(2.0 * gain[0] * inverse_square);
}}
for (int i = 0; i <= n; ++i) {{
    const double* moved = plane(MOVED) + i;
    Row by[2] = {{}};
    for (int axis = 0; axis < 3; ++axis) {{
        const double z[2] = {{moved[2 * axis * size], moved[(2 * axis + 1) * size]}};
        by[0][axis] = (float)(2.0 * (right[0] * z[0] - right[1] * z[1]));
        by[1][axis] = (float)(2.0 * z[0]);
    }}
    first_moves[i] += by[0];
    moves[i] += by[1];
}}
return wp::vec_t<2, wp::int32>(smooth, rests);
#endif
"""


@wp.func_native(_PREPARE)
def _prepare(
    particles: int,
    segments: int,
    n: int,
    again: bool,
    x: wp.uint64,
    low: wp.uint64,
    d: wp.uint64,
    rests: wp.array(dtype=float),
    staged: wp.array(dtype=StagedSegment),
    stages: wp.array(dtype=wp.vec4),
    first_targets: wp.array(dtype=wp.vec3),
    targets: wp.array(dtype=wp.vec3),
    ladder: wp.array(dtype=wp.float64),
    compliance: float,
    gamma: float,
    effective: float,
    inverse_square: float,
    least: float,
    shortest: float,
) -> bool:
    """Tell the planes of n segments; whether all have a length to speak of.

    compliance: of material [1/N]; gamma: dashpot time / h; least: of what a segment yields along itself.
    """
    ...


_walk = make_walk(2)


@wp.func_native(_MOVE)
def _move(
    particles: int,
    segments: int,
    n: int,
    again: bool,
    d: wp.uint64,
    staged: wp.array(dtype=StagedSegment),
    stages: wp.array(dtype=wp.vec4),
    ladder: wp.array(dtype=wp.float64),
    inverse_square: float,
    largest_turn: float,
    settled: float,
    torn: float,
) -> wp.vec2i:
    """Particles are moved and tensions changed at both stages. Whether that is smooth, and whether it is settled."""
    ...


@wp.func
def pass_both_ends(
    again: bool,
    m: Model,
    s: State,
    body: Body,
    material: Material,
    step: Step,
    x: wp.uint64,
    low: wp.uint64,
    d: wp.uint64,
) -> wp.vec2i:
    """One Newton step over both stages, `again` after the first. Whether the motion is smooth, and whether it is
    settled; -1 where nothing is done, for this is not a CPU, segments are few or one has no length."""
    n = body.segments_end - body.segments
    if n < FEWEST or s.ladder.shape[0] == 0:
        return wp.vec2i(-1, -1)
    lengths = _prepare(
        body.particles,
        body.segments,
        n,
        again,
        x,
        low,
        d,
        m.segment_length,
        s.staged,
        s.stages,
        s.first_targets,
        s.targets,
        s.ladder,
        material.compliance[0],
        material.damping * step.inverse,
        step.effective,
        step.inverse_square,
        STIFFEST * body.yielding,
        SHORTEST,
    )
    if not lengths:
        return wp.vec2i(-1, -1)
    _walk(body.particles, n, again, s.ladder)
    return _move(
        body.particles,
        body.segments,
        n,
        again,
        d,
        s.staged,
        s.stages,
        s.ladder,
        step.inverse_square,
        LARGEST_TURN,
        SETTLED_SPEED * step.effective,
        TORN,
    )
