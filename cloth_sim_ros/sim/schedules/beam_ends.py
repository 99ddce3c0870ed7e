"""The direct solve of a rope's bending by one thread of a CPU: from both its ends at once, in double precision.

The equations are those of beam.py. What joints and rows are is told of four at a time; the elimination, which waits for
one quotient after the other, goes from either end to the two rows in the middle, each in one half of a vector register.
"""

import warp as wp

from cloth_sim_ros.sim.model import Body, Model
from cloth_sim_ros.sim.physics.integrate import Step
from cloth_sim_ros.sim.schedules.beam import STIFFEST
from cloth_sim_ros.sim.schedules.walks import FEWEST, NUMBERS
from cloth_sim_ros.sim.state import Material, State

# Planes of numbers, in the room of walks.py, which is done by then: of every joint its stiffness, the inverse lengths
# before and behind it and by how much its moment is to change; of every particle inverse mass, row, pull and move; of
# every step of the walks, for both side by side, what couples a row to the two before it, and D^-1 of its pull. Before
# the first and behind the last there are two places where nothing is. Where rows are one too few for walks of as many
# steps and two between them, one more is there, which moves nothing.
_PLANES = f"""
enum {{ STIFF, BEFORE, BEHIND, CHANGE, WEIGHT = 6, DIAGONAL, BELOW, BEYOND, PULL, MOVED = 13, WALKS = 16 }};
typedef double Four __attribute__((ext_vector_type(4), aligned(8)));
typedef double Two __attribute__((ext_vector_type(2), aligned(8)));
typedef float Row __attribute__((ext_vector_type(4), aligned(4)));
double* numbers = ladder.data + (size_t){NUMBERS} * particles;
const int size = count + 6, rows = count + count % 2, turns = count - 2;
auto plane = [&](int which) {{ return numbers + (size_t)which * size + 2; }};
auto at = [&](int which, int i) -> Four& {{ return *(Four*)(plane(which) + i); }};
const Row* places = (const Row*)x;
Row* displaced = (Row*)d;
auto column = [](const Row* from, int k) {{
    return __builtin_convertvector(Row{{from[0][k], from[1][k], from[2][k], from[3][k]}}, Four);
}};
auto larger = [](Four a, Four b) {{ return a > b ? a : b; }};
// What the turn vectors of four joints from j on lack to their rest shape.
auto residual = [&](int j, Four* turn) {{
    Row before[5], e[5];
    for (int s = 0; s < 5; ++s) {{
        before[s] = places[j + s + 1] - places[j + s];
        e[s] = before[s] + (displaced[j + s + 1] - displaced[j + s]);
    }}
    for (int axis = 0; axis < 3; ++axis) {{
        turn[axis] = column(e + 1, axis) * at(BEHIND, j) - column(e, axis) * at(BEFORE, j);
    }}
    const Four rest = column((const Row*)(joints.data + segments + j), 0);
    if (__builtin_reduce_or(rest != 0.0)) {{
        Four was[3], square = {{}};
        for (int axis = 0; axis < 3; ++axis) {{
            was[axis] = column(before + 1, axis) * at(BEHIND, j) - column(before, axis) * at(BEFORE, j);
            square += was[axis] * was[axis];
        }}
        const Four share = rest / larger(__builtin_elementwise_sqrt(square), Four(1.0e-9));
        for (int axis = 0; axis < 3; ++axis) turn[axis] -= share * was[axis];
    }}
}};
"""

_PREPARE = f"""
#if !defined(__CUDA_ARCH__)
{_PLANES}
for (int which = STIFF; which < MOVED; ++which) {{
    double* place = plane(which);
    place[-2] = place[-1] = 0.0;
    for (int i = turns; i < count + 4; ++i) place[i] = 0.0;
}}
for (int i = 0; i < count; ++i) plane(WEIGHT)[i] = displaced[i][3];
const double square = (double)effective * effective;
for (int begin = 0; begin < turns; begin += 4) {{
    const int j = begin < turns - 4 ? begin : turns - 4;
    const Row* joint = (const Row*)(joints.data + segments + j);
    const Four before = column(joint, 2), behind = column(joint, 3), middle = before + behind;
    const Four lightest = larger(at(WEIGHT, j), larger(at(WEIGHT, j + 1), at(WEIGHT, j + 2)));
    const Four yields = (double)compliance * column(joint, 1) / square;
    const Four stiff = 1.0 / larger(yields, lightest * middle * middle / (double)stiffest);
    Four turn[3];
    at(STIFF, j) = stiff;
    at(BEFORE, j) = before;
    at(BEHIND, j) = behind;
    residual(j, turn);
    const float* moment = (const float*)(moments.data + segments + j);
    const auto carries = (column(joint, 0) == 0.0) | (first ? 0 : -1);
    for (int axis = 0; axis < 3; ++axis) {{
        const Four held = {{moment[axis], moment[axis + 3], moment[axis + 6], moment[axis + 9]}};
        at(CHANGE + axis, j) = stiff * turn[axis] - square * (carries ? held : Four(0.0));
    }}
}}
for (int begin = 0; begin < count; begin += 4) {{
    const int i = begin < count - 4 ? begin : count - 4;
    // The joints that a particle begins, is the middle of and ends.
    const Four first = at(BEFORE, i), middle = -(at(BEFORE, i - 1) + at(BEHIND, i - 1)), last = at(BEHIND, i - 2);
    const Four begun = at(STIFF, i) * first, near = at(STIFF, i - 1) * middle, far = at(STIFF, i - 2) * last;
    const Four w = at(WEIGHT, i);
    const auto one = (w > 0.0) & (at(WEIGHT, i - 1) > 0.0), two = (w > 0.0) & (at(WEIGHT, i - 2) > 0.0);
    at(DIAGONAL, i) = w > 0.0 ? 1.0 / w + (begun * first + near * middle + far * last) : Four(1.0);
    at(BELOW, i) = one ? near * at(BEFORE, i - 1) - far * (at(BEFORE, i - 2) + at(BEHIND, i - 2)) : Four(0.0);
    at(BEYOND, i) = two ? far * at(BEFORE, i - 2) : Four(0.0);
    for (int axis = 0; axis < 3; ++axis) {{
        const double* change = plane(CHANGE + axis) + i;
        const Four pull = first * *(Four*)change + middle * *(Four*)(change - 1) + last * *(Four*)(change - 2);
        at(PULL + axis, i) = w > 0.0 ? -pull : Four(0.0);
    }}
}}
if (rows > count) plane(DIAGONAL)[count] = 1.0;
#endif
"""

_WALK = f"""
#if !defined(__CUDA_ARCH__)
{_PLANES}
const int steps = rows / 2 - 1;
Two* kept = (Two*)plane(WALKS);
auto both = [&](int which, int i, int j) {{ return Two{{plane(which)[i], plane(which)[j]}}; }};
struct Done {{ Two inverse, first, move[3]; }} one = {{}}, two = {{}};
for (int s = 0; s < steps; ++s) {{
    const int i = s, j = rows - 1 - s;
    const Two beyond = both(BEYOND, i, j + 2), below = both(BELOW, i, j + 1) - beyond * one.first;
    const Two second = beyond * two.inverse;
    Done here;
    here.first = below * one.inverse;
    here.inverse = 1.0 / (both(DIAGONAL, i, j) - here.first * below - second * beyond);
    kept[5 * s] = here.first;
    kept[5 * s + 1] = second;
    for (int axis = 0; axis < 3; ++axis) {{
        here.move[axis] = both(PULL + axis, i, j) - here.first * one.move[axis] - second * two.move[axis];
        kept[5 * s + 2 + axis] = here.inverse * here.move[axis];
    }}
    two = one;
    one = here;
}}
// Of the two rows in the middle, to each walk one is its next and the other the one after that.
const int i = steps, j = steps + 1;
const Two beyond = both(BEYOND, i, j + 2), below = both(BELOW, i, j + 1) - beyond * one.first;
const Two second = beyond * two.inverse, first = below * one.inverse;
const Two beyond_after = both(BEYOND, j, i + 2), second_after = beyond_after * one.inverse;
const Two next = first * below + second * beyond, after = second_after * beyond_after, across = beyond_after * first;
const Two diagonal = both(DIAGONAL, i, j) - next - after.yx;
const double beside = plane(BELOW)[j] - across[0] - across[1];
const double inverse = 1.0 / (diagonal[0] * diagonal[1] - beside * beside);
Two ahead[3], last[3];
for (int axis = 0; axis < 3; ++axis) {{
    const Two near = first * one.move[axis] + second * two.move[axis], far = second_after * one.move[axis];
    const Two pull = both(PULL + axis, i, j) - near - far.yx;
    ahead[axis] = (diagonal.yx * pull - beside * pull.yx) * inverse;
    last[axis] = ahead[axis].yx;
    plane(MOVED + axis)[i] = ahead[axis][0];
    plane(MOVED + axis)[j] = ahead[axis][1];
}}
Two to_next = first, to_after = second_after, to_next_after = second;
for (int s = steps - 1; s >= 0; --s) {{
    for (int axis = 0; axis < 3; ++axis) {{
        const Two move = kept[5 * s + 2 + axis] - to_next * ahead[axis] - to_after * last[axis];
        last[axis] = ahead[axis];
        ahead[axis] = move;
        plane(MOVED + axis)[s] = move[0];
        plane(MOVED + axis)[rows - 1 - s] = move[1];
    }}
    to_next = kept[5 * s];
    to_after = to_next_after;
    to_next_after = kept[5 * s + 1];
}}
#endif
"""

_MOVE = f"""
#if !defined(__CUDA_ARCH__)
{_PLANES}
for (int i = 0; i < count; ++i) {{
    const double* move = plane(MOVED) + i;
    displaced[i] += Row{{(float)move[0], (float)move[size], (float)move[2 * size], 0.0f}};
}}
for (int begin = 0; begin < turns; begin += 4) {{
    const int j = begin < turns - 4 ? begin : turns - 4;
    Four turn[3];
    residual(j, turn);
    float* moment = (float*)(moments.data + segments + j);
    for (int axis = 0; axis < 3; ++axis) {{
        const Four held = at(STIFF, j) * inverse_square * turn[axis];
        for (int s = 0; s < 4; ++s) moment[3 * s + axis] = (float)held[s];
    }}
}}
#endif
"""


@wp.func_native(_PREPARE)
def _prepare(
    particles: int,
    segments: int,
    count: int,
    x: wp.uint64,
    d: wp.uint64,
    joints: wp.array(dtype=wp.vec4),
    moments: wp.array(dtype=wp.vec3),
    ladder: wp.array(dtype=wp.float64),
    compliance: float,
    effective: float,
    stiffest: float,
    first: bool,
):
    """The planes of joints and rows of `count` particles."""
    ...


@wp.func_native(_WALK)
def _walk(
    particles: int,
    segments: int,
    count: int,
    x: wp.uint64,
    d: wp.uint64,
    joints: wp.array(dtype=wp.vec4),
    ladder: wp.array(dtype=wp.float64),
):
    """How particles are to move."""
    ...


@wp.func_native(_MOVE)
def _move(
    particles: int,
    segments: int,
    count: int,
    x: wp.uint64,
    d: wp.uint64,
    joints: wp.array(dtype=wp.vec4),
    moments: wp.array(dtype=wp.vec3),
    ladder: wp.array(dtype=wp.float64),
    inverse_square: float,
):
    """Particles are moved, and moments are what they are then."""
    ...


@wp.func
def solve_beam_from_both_ends(
    m: Model, s: State, body: Body, material: Material, step: Step, x: wp.uint64, d: wp.uint64
) -> bool:
    """One solve over all joints of a body: moves its particles and changes its moments; False where this is not a CPU
    or joints are few."""
    if body.count <= FEWEST or s.ladder.shape[0] == 0:
        return False
    p = body.particles
    compliance = material.compliance[2]
    _prepare(
        p,
        body.segments,
        body.count,
        x,
        d,
        m.joints,
        s.moments,
        s.ladder,
        compliance,
        step.effective,
        STIFFEST,
        step.first,
    )
    _walk(p, body.segments, body.count, x, d, m.joints, s.ladder)
    _move(p, body.segments, body.count, x, d, m.joints, s.moments, s.ladder, step.inverse_square)
    return True
