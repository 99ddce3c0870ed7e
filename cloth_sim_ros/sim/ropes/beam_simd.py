# SPDX-License-Identifier: Apache-2.0
"""Bending of a rope by one thread of a CPU (see beam_ends.py): joints and rows four at a time, elimination in pairs."""

from collections.abc import Callable

import warp as wp

from cloth_sim_ros.sim.ropes.elimination import NUMBERS

# Planes of numbers, in the room of elimination.py, which is done by then. Of every joint: its stiffness, the inverse
# lengths before and behind it, and by how much its moment is to change. Of every particle: inverse mass, row, pull and
# move. Of every step of the walks, for both side by side: what couples a row to the two before it, and D^-1 of its
# pull. Before the first and behind the last there are two places where nothing is. Where rows are one too few for walks
# of as many steps and two between them, one more is there, which moves nothing. Where rest is bent (beam_rotation.py),
# pulls and moves have three columns more, by which the rest shape turns. There are also the rest turn of every joint
# and by how much bending has moved every particle before.
_PLANES = """
enum { STIFF, BEFORE, BEHIND, CHANGE, WEIGHT = 6, DIAGONAL, BELOW, BEYOND, PULL, COLUMNS = BENT ? 6 : 3,
    MOVED = PULL + COLUMNS, WALKS = MOVED + COLUMNS, REST = WALKS + 2 + COLUMNS + 1,
    KNOWN = REST + 3 };
typedef double Four __attribute__((ext_vector_type(4), aligned(8)));
typedef double Two __attribute__((ext_vector_type(2), aligned(8)));
typedef float Row __attribute__((ext_vector_type(4), aligned(4)));
double* numbers = ladder.data + (size_t)NUMBERS * particles;
const int size = count + 6, rows = count + count % 2, turns = count - 2;
auto plane = [&](int which) { return numbers + (size_t)which * size + 2; };
auto at = [&](int which, int i) -> Four& { return *(Four*)(plane(which) + i); };
const Row* places = (const Row*)x;
Row* displaced = (Row*)d;
auto column = [](const Row* from, int k) {
    return __builtin_convertvector(Row{from[0][k], from[1][k], from[2][k], from[3][k]}, Four);
};
auto larger = [](Four a, Four b) { return a > b ? a : b; };
// How vectors by particles turn four joints from j on, and what of their turn vectors rest is not.
auto turned = [&](int which, int j) {
    const double* move = plane(which) + j;
    const Four first = *(Four*)(move + 1) - *(Four*)move, last = *(Four*)(move + 2) - *(Four*)(move + 1);
    return last * at(BEHIND, j) - first * at(BEFORE, j);
};
auto residual = [&](int j, Four* turn) {
    Row e[5];
    for (int s = 0; s < 5; ++s) e[s] = (places[j + s + 1] - places[j + s]) + (displaced[j + s + 1] - displaced[j + s]);
    for (int axis = 0; axis < 3; ++axis) {
        turn[axis] = column(e + 1, axis) * at(BEHIND, j) - column(e, axis) * at(BEFORE, j);
        if (BENT) turn[axis] -= at(REST + axis, j);
    }
};
"""
_PREPARE = """
for (int which = STIFF; which < (BENT ? KNOWN + 3 : (int)MOVED); ++which) {
    if (which == WALKS) which = REST;
    double* place = plane(which);
    place[-2] = place[-1] = 0.0;
    for (int i = turns; i < count + 4; ++i) place[i] = 0.0;
}
for (int i = 0; i < count; ++i) plane(WEIGHT)[i] = displaced[i][3];
for (int i = 0; BENT && i < count; ++i) {
    for (int axis = 0; axis < 3; ++axis) plane(KNOWN + axis)[i] = moves.data[particles + i][axis];
}
const double square = (double)effective * effective;
for (int begin = 0; begin < turns; begin += 4) {
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
    if (BENT) {
        const Four rest = column(joint, 0);
        Row e[5];
        Four was[3], length = {};
        for (int s = 0; s < 5; ++s) e[s] = places[j + s + 1] - places[j + s];
        for (int axis = 0; axis < 3; ++axis) {
            was[axis] = column(e + 1, axis) * behind - column(e, axis) * before;
            length += was[axis] * was[axis];
        }
        const Four share = rest / larger(__builtin_elementwise_sqrt(length), Four(1.0e-9));
        for (int axis = 0; axis < 3; ++axis) at(REST + axis, j) = share * was[axis];
    }
    residual(j, turn);
    const float* moment = (const float*)(moments.data + segments + j);
    for (int axis = 0; axis < 3; ++axis) {
        const Four held = {moment[axis], moment[axis + 3], moment[axis + 6], moment[axis + 9]};
        at(CHANGE + axis, j) = stiff * turn[axis] - (BENT ? Four(0.0) : square * held);
    }
}
for (int begin = 0; begin < count; begin += 4) {
    const int i = begin < count - 4 ? begin : count - 4;
    // The joints that a particle begins, is the middle of and ends.
    const Four first = at(BEFORE, i), middle = -(at(BEFORE, i - 1) + at(BEHIND, i - 1)), last = at(BEHIND, i - 2);
    const Four begun = at(STIFF, i) * first, near = at(STIFF, i - 1) * middle, far = at(STIFF, i - 2) * last;
    const Four w = at(WEIGHT, i);
    const auto one = (w > 0.0) & (at(WEIGHT, i - 1) > 0.0), two = (w > 0.0) & (at(WEIGHT, i - 2) > 0.0);
    at(DIAGONAL, i) = w > 0.0 ? 1.0 / w + (begun * first + near * middle + far * last) : Four(1.0);
    at(BELOW, i) = one ? near * at(BEFORE, i - 1) - far * (at(BEFORE, i - 2) + at(BEHIND, i - 2)) : Four(0.0);
    at(BEYOND, i) = two ? far * at(BEFORE, i - 2) : Four(0.0);
    for (int axis = 0; axis < 3; ++axis) {
        const double* change = plane(CHANGE + axis) + i;
        const Four pull = first * *(Four*)change + middle * *(Four*)(change - 1) + last * *(Four*)(change - 2);
        const Four inertia = BENT ? at(KNOWN + axis, i) / w : Four(0.0);
        at(PULL + axis, i) = w > 0.0 ? -pull - inertia : Four(0.0);
        if (BENT) {
            const double* rest = plane(REST + axis) + i;
            const Four turning = begun * *(Four*)rest + near * *(Four*)(rest - 1) + far * *(Four*)(rest - 2);
            at(PULL + 3 + axis, i) = w > 0.0 ? turning : Four(0.0);
        }
    }
}
if (rows > count) plane(DIAGONAL)[count] = 1.0;
"""
_WALK = """
const int steps = rows / 2 - 1;
Two* kept = (Two*)plane(WALKS);
auto both = [&](int which, int i, int j) { return Two{plane(which)[i], plane(which)[j]}; };
struct Done { Two inverse, first, move[COLUMNS]; } one = {}, two = {};
for (int s = 0; s < steps; ++s) {
    const int i = s, j = rows - 1 - s;
    const Two beyond = both(BEYOND, i, j + 2), below = both(BELOW, i, j + 1) - beyond * one.first;
    const Two second = beyond * two.inverse;
    Done here;
    here.first = below * one.inverse;
    here.inverse = 1.0 / (both(DIAGONAL, i, j) - here.first * below - second * beyond);
    kept[(COLUMNS + 2) * s] = here.first;
    kept[(COLUMNS + 2) * s + 1] = second;
    for (int axis = 0; axis < COLUMNS; ++axis) {
        here.move[axis] = both(PULL + axis, i, j) - here.first * one.move[axis] - second * two.move[axis];
        kept[(COLUMNS + 2) * s + 2 + axis] = here.inverse * here.move[axis];
    }
    two = one;
    one = here;
}
// Of the two rows in the middle, to each walk one is its next and the other the one after that.
const int i = steps, j = steps + 1;
const Two beyond = both(BEYOND, i, j + 2), below = both(BELOW, i, j + 1) - beyond * one.first;
const Two second = beyond * two.inverse, first = below * one.inverse;
const Two beyond_after = both(BEYOND, j, i + 2), second_after = beyond_after * one.inverse;
const Two next = first * below + second * beyond, after = second_after * beyond_after, across = beyond_after * first;
const Two diagonal = both(DIAGONAL, i, j) - next - after.yx;
const double beside = plane(BELOW)[j] - across[0] - across[1];
const double inverse = 1.0 / (diagonal[0] * diagonal[1] - beside * beside);
Two ahead[COLUMNS], last[COLUMNS];
for (int axis = 0; axis < COLUMNS; ++axis) {
    const Two near = first * one.move[axis] + second * two.move[axis], far = second_after * one.move[axis];
    const Two pull = both(PULL + axis, i, j) - near - far.yx;
    ahead[axis] = (diagonal.yx * pull - beside * pull.yx) * inverse;
    last[axis] = ahead[axis].yx;
    plane(MOVED + axis)[i] = ahead[axis][0];
    plane(MOVED + axis)[j] = ahead[axis][1];
}
Two to_next = first, to_after = second_after, to_next_after = second;
for (int s = steps - 1; s >= 0; --s) {
    for (int axis = 0; axis < COLUMNS; ++axis) {
        const Two move = kept[(COLUMNS + 2) * s + 2 + axis] - to_next * ahead[axis] - to_after * last[axis];
        last[axis] = ahead[axis];
        ahead[axis] = move;
        plane(MOVED + axis)[s] = move[0];
        plane(MOVED + axis)[rows - 1 - s] = move[1];
    }
    to_next = kept[(COLUMNS + 2) * s];
    to_after = to_next_after;
    to_next_after = kept[(COLUMNS + 2) * s + 1];
}
"""
# Sums of beam_rotation.py, the inertia and then the lag.
_SUM = """
Four inertia[9] = {}, lag[9] = {};
auto add = [](const Four* a, const Four* b, Four* to) {
    for (int k = 0; k < 9; ++k) to[k] += a[k / 3] * b[k % 3];
};
for (int i = 0; i < count; i += 4) {
    const Four w = at(WEIGHT, i), mass = w > 0.0 ? 1.0 / w : Four(0.0);
    Four u[3], y[3], heavy[3];
    for (int axis = 0; axis < 3; ++axis) {
        u[axis] = at(KNOWN + axis, i) + at(MOVED + axis, i);
        y[axis] = at(MOVED + 3 + axis, i);
        heavy[axis] = mass * y[axis];
    }
    add(heavy, y, inertia);
    add(heavy, u, lag);
}
for (int j = 0; j < turns; j += 4) {
    const Four stiff = at(STIFF, j);
    Four z[3], strong[3], moment[3];
    for (int axis = 0; axis < 3; ++axis) {
        z[axis] = turned(MOVED + 3 + axis, j) - at(REST + axis, j);
        strong[axis] = stiff * z[axis];
        moment[axis] = at(CHANGE + axis, j) + stiff * turned(MOVED + axis, j);
    }
    add(strong, z, inertia);
    add(z, moment, lag);
}
wp::mat_t<6, 3, float> sums;
for (int k = 0; k < 9; ++k) {
    sums.data[k / 3][k % 3] = (float)(inertia[k][0] + inertia[k][1] + inertia[k][2] + inertia[k][3]);
    sums.data[3 + k / 3][k % 3] = (float)(lag[k][0] + lag[k][1] + lag[k][2] + lag[k][3]);
}
return sums;
"""
_MOVE = """
auto rotate = [&](int which, int by, int i) {
    const Four v[3] = {at(by, i), at(by + 1, i), at(by + 2, i)};
    for (int axis = 0; axis < 3; ++axis) {
        const float* r = rotation.data[axis];
        at(which + axis, i) += v[0] * (double)r[0] + v[1] * (double)r[1] + v[2] * (double)r[2];
    }
};
for (int i = 0; BENT && i < count; i += 4) rotate(MOVED, MOVED + 3, i);
for (int j = 0; BENT && j < turns; j += 4) {
    for (int axis = 0; axis < 3; ++axis) at(CHANGE + axis, j) += at(STIFF, j) * at(REST + axis, j);
    rotate(REST, REST, j);
    for (int axis = 0; axis < 3; ++axis) at(CHANGE + axis, j) -= at(STIFF, j) * at(REST + axis, j);
}
for (int i = 0; i < count; ++i) {
    const double* move = plane(MOVED) + i;
    displaced[i] += Row{(float)move[0], (float)move[size], (float)move[2 * size], 0.0f};
    for (int axis = 0; BENT && axis < 3; ++axis) moves.data[particles + i][axis] += (float)move[axis * size];
}
for (int j = 0; j < turns; j += 4) {
    float* moment = (float*)(moments.data + segments + j);
    for (int axis = 0; axis < 3; ++axis) {
        const Four change = (at(CHANGE + axis, j) + at(STIFF, j) * turned(MOVED + axis, j)) * inverse_square;
        for (int s = 0; s < 4 && j + s < turns; ++s) {
            float* held = moment + 3 * s + axis;
            *held = (float)(change[s] + (BENT ? 0.0 : *held));
        }
    }
}
"""


def _code(body: str, bent: bool, otherwise: str = "") -> str:
    """C++ of a CPU for a rope that is bent at rest, or straight."""
    planes = f"enum {{ BENT = {int(bent)}, NUMBERS = {NUMBERS} }};\n{_PLANES}"
    return f"\n#if !defined(__CUDA_ARCH__)\n{planes}{body}#else\n{otherwise}\n#endif\n"


def make_lanes(bent: bool) -> tuple[Callable, ...]:
    """Four Warp functions, of which a GPU does nothing: prepare, walk, add_up and move."""

    @wp.func_native(_code(_PREPARE, bent))
    def prepare(
        particles: int,
        segments: int,
        count: int,
        x: wp.uint64,
        d: wp.uint64,
        joints: wp.array(dtype=wp.vec4),
        moments: wp.array(dtype=wp.vec3),
        moves: wp.array(dtype=wp.vec3),
        ladder: wp.array(dtype=wp.float64),
        compliance: float,
        effective: float,
        stiffest: float,
    ):
        """The planes of joints and rows of `count` particles."""
        ...

    @wp.func_native(_code(_WALK, bent))
    def walk(particles: int, count: int, x: wp.uint64, d: wp.uint64, ladder: wp.array(dtype=wp.float64)):
        """How particles are to move."""
        ...

    @wp.func_native(_code(_SUM, bent, "return wp::mat_t<6, 3, float>();"))
    def add_up(
        particles: int, count: int, x: wp.uint64, d: wp.uint64, ladder: wp.array(dtype=wp.float64)
    ) -> wp.types.matrix((6, 3), float):
        """The inertia and the lag of beam_rotation.py, where rest is bent."""
        ...

    @wp.func_native(_code(_MOVE, bent))
    def move(
        particles: int,
        segments: int,
        count: int,
        x: wp.uint64,
        d: wp.uint64,
        moments: wp.array(dtype=wp.vec3),
        moves: wp.array(dtype=wp.vec3),
        ladder: wp.array(dtype=wp.float64),
        inverse_square: float,
        rotation: wp.mat33,
    ):
        """Particles are moved, the rest shape is turned by `rotation` + 1, and moments are what they are then."""
        ...

    return prepare, walk, add_up, move
