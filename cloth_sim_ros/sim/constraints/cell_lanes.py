"""Eight cells at a time in the vector registers of a CPU: the projection of cell.py.

Cells of a pass share no particle, so that eight of them go through the same instructions side by side; only rows of
memory have to be turned into vectors and back. Compilers do not find this by themselves.
"""

import warp as wp

from cloth_sim_ros.sim.cells import ALONE, DOUBLED, FAR, HAS_DIAGONALS, HAS_SIDES, INDEX, TURNED
from cloth_sim_ros.sim.constraints.cell import Springs, is_plain
from cloth_sim_ros.sim.model import Body, Model
from cloth_sim_ros.sim.physics.integrate import Step
from cloth_sim_ros.sim.state import Material, State

LANES = 8

# Between rows of four numbers in memory and a vector of LANES for each number.
ROWS = f"""
typedef float Lanes __attribute__((ext_vector_type({LANES})));
typedef float Row __attribute__((ext_vector_type(4), aligned(4)));
// Four rows of four numbers to their columns, in both halves of the lanes; twice it is what it was.
auto turn = [](const Lanes* from, Lanes* to) {{
    const Lanes ab = __builtin_shufflevector(from[0], from[1], 0, 8, 1, 9, 4, 12, 5, 13);
    const Lanes AB = __builtin_shufflevector(from[0], from[1], 2, 10, 3, 11, 6, 14, 7, 15);
    const Lanes ce = __builtin_shufflevector(from[2], from[3], 0, 8, 1, 9, 4, 12, 5, 13);
    const Lanes CE = __builtin_shufflevector(from[2], from[3], 2, 10, 3, 11, 6, 14, 7, 15);
    to[0] = __builtin_shufflevector(ab, ce, 0, 1, 8, 9, 4, 5, 12, 13);
    to[1] = __builtin_shufflevector(ab, ce, 2, 3, 10, 11, 6, 7, 14, 15);
    to[2] = __builtin_shufflevector(AB, CE, 0, 1, 8, 9, 4, 5, 12, 13);
    to[3] = __builtin_shufflevector(AB, CE, 2, 3, 10, 11, 6, 7, 14, 15);
}};
auto load = [&](uint64_t address, const int* at, Lanes* to) {{
    const Row* row = (const Row*)address;
    Lanes rows[4];
    for (int lane = 0; lane < 4; ++lane) {{
        rows[lane] = __builtin_shufflevector(row[at[lane]], row[at[lane + 4]], 0, 1, 2, 3, 4, 5, 6, 7);
    }}
    turn(rows, to);
}};
"""

# Where there are dashpots, what they see of a corner: the rounding that displacements carry, and the last ones.
_LOAD_MORE = f"""
    if (gamma > 0.0f) {{
        load(low, corners[c].at, corners[c].low);
        for (int lane = 0; lane < {LANES} && second; ++lane) {{
            const wp::vec3& row = last.data[particle + corners[c].at[lane]];
            for (int axis = 0; axis < 3; ++axis) corners[c].last[axis][lane] = row[axis];
        }}
    }}
"""

# What holds a spring beside its length: multipliers so far, and dashpots.
_HOLD = """
    Lanes multiplier = 0.0f;
    Kept* kept = (Kept*)(multipliers.data + q * cells.shape[0] + first);
    if (!fresh) multiplier = *kept;
    off += alpha * multiplier;
    if (gamma > 0.0f) {
        Lanes before = 0.0f, change = 0.0f, carried = 0.0f;
        for (int axis = 0; axis < 3; ++axis) {
            const Lanes de = (j.d[axis] - i.d[axis]) - (j.low[axis] - i.low[axis]), was = e[axis] - de;
            before += was * was;
            change += (e[axis] + was) * de;
            if (second) carried += e[axis] * (j.last[axis] - i.last[axis]);
        }
        Lanes slip = change / (length + __builtin_elementwise_sqrt(before));
        if (second) slip -= carried / (3.0f * length);
        off += gamma * slip;
        w *= 1.0f + gamma;
    }
"""

_KEEP = "if (stores) *kept = multiplier - share * length;"


def _source(whole: bool) -> str:
    """C++ of the projection; of the `whole`, with dashpots and multipliers, or of what is_plain."""
    return f"""
#if !defined(__CUDA_ARCH__)
{ROWS}
typedef int Flags __attribute__((ext_vector_type({LANES})));
typedef float Kept __attribute__((ext_vector_type({LANES}), aligned(4)));
struct Corner {{
    int at[{LANES}];
    Lanes x[4], d[4];  // the fourth of d is the inverse mass
    {"Lanes low[4], last[3];" if whole else ""}
}};
const int* records = (const int*)(cells.data + first);
Flags flags;
Corner corners[4];
int count = 0;
for (int lane = 0; lane < {LANES}; ++lane) {{
    const int* record = records + 4 * lane;
    const bool empty = record[3] < 0;
    count += !empty;
    if (empty) record = records;  // any that is there: what comes of it is not stored
    flags[lane] = record[0];
    for (int c = 0; c < 4; ++c) corners[c].at[lane] = record[c] & {(1 << INDEX) - 1};
}}
for (int c = 0; c < 4; ++c) {{
    load(x, corners[c].at, corners[c].x);
    load(d, corners[c].at, corners[c].d);
    {_LOAD_MORE if whole else ""}
}}
const Lanes there = (flags >> {ALONE} & 1) != 0 ? Lanes(0.0f) : Lanes(1.0f);  // of springs that lone ones lack
auto pull = [&](Corner& i, Corner& j, int q, Lanes rest, Lanes alpha, Lanes there) {{
    Lanes e[3];
    for (int axis = 0; axis < 3; ++axis) e[axis] = (j.x[axis] - i.x[axis]) + (j.d[axis] - i.d[axis]);
    const Lanes square = e[0] * e[0] + e[1] * e[1] + e[2] * e[2] + 1.0e-24f;
    const Lanes length = __builtin_elementwise_sqrt(square);
    Lanes w = i.d[3] + j.d[3], off = length - rest;
    {_HOLD if whole else ""}
    const Lanes share = there * off / ((w + alpha) * length);
    {_KEEP if whole else ""}
    for (int axis = 0; axis < 3; ++axis) {{
        i.d[axis] += i.d[3] * share * e[axis];
        j.d[axis] -= j.d[3] * share * e[axis];
    }}
}};
auto compliance = [&](float alpha, int side) {{
    const Flags doubled = (flags >> ({DOUBLED} + side) & 1) != 0;
    return doubled ? Lanes(2.0f * alpha) : Lanes(alpha);
}};
Corner &a = corners[0], &b = corners[1], &c = corners[2], &e = corners[3];
if (records[1] >> {HAS_SIDES} & 1) {{
    const bool far_apart = records[1] >> {FAR} & 1;
    const float stride = far_apart ? 2.0f : 1.0f, alpha = far_apart ? far : near;
    const Lanes across = stride * spacing[1];
    const Flags turned = (flags >> {TURNED} & 1) != 0;
    const Lanes along = turned ? across : Lanes(stride * spacing[0]);
    pull(a, b, 0, along, compliance(alpha, 0), 1.0f);
    pull(c, e, 1, along, compliance(alpha, 1), 1.0f);
    pull(a, c, 2, across, compliance(alpha, 2), there);
    pull(b, e, 3, across, compliance(alpha, 3), there);
}}
if (records[1] >> {HAS_DIAGONALS} & 1) {{
    pull(a, e, 4, spacing[2], diagonal, there);
    pull(b, c, 5, spacing[2], diagonal, there);
}}
// Row by row where a cell is missing or has two springs alone.
const bool whole = count == {LANES} && !__builtin_reduce_or(flags >> {ALONE} & 1);
for (int n = 0; n < 4; ++n) {{
    Lanes rows[4];
    turn(corners[n].d, rows);
    Row* to = (Row*)d;
    const int* at = corners[n].at;
    if (whole) {{
        for (int lane = 0; lane < 4; ++lane) {{
            to[at[lane]] = rows[lane].lo;
            to[at[lane + 4]] = rows[lane].hi;
        }}
        continue;
    }}
    for (int lane = 0; lane < count; ++lane) {{
        if (n > 1 && c.at[lane] == a.at[lane]) continue;  // a lone spring: two particles, each there twice
        to[at[lane]] = lane < 4 ? rows[lane].lo : rows[lane - 4].hi;
    }}
}}
#endif
"""


@wp.func_native(_source(whole=False))
def _project_plain(
    cells: wp.array(dtype=wp.vec4i),
    first: int,
    near: float,
    far: float,
    diagonal: float,
    spacing: wp.vec3,
    x: wp.uint64,
    d: wp.uint64,
): ...


@wp.func_native(_source(whole=True))
def _project_whole(
    cells: wp.array(dtype=wp.vec4i),
    first: int,
    near: float,
    far: float,
    diagonal: float,
    spacing: wp.vec3,
    x: wp.uint64,
    d: wp.uint64,
    multipliers: wp.array(dtype=float),
    fresh: bool,
    stores: bool,
    gamma: float,
    low: wp.uint64,
    second: bool,
    last: wp.array(dtype=wp.vec3),
    particle: int,
): ...


@wp.func
def project_lanes(
    k: int,
    springs: Springs,
    m: Model,
    s: State,
    body: Body,
    material: Material,
    step: Step,
    x: wp.uint64,
    low: wp.uint64,
    d: wp.uint64,
):
    """Project the LANES cells from k on, of which the last of a pass may be empty."""
    if is_plain(material, step):
        _project_plain(m.cells, k, springs.near, springs.far, springs.diagonal, springs.cell, x, d)
    else:
        _project_whole(
            m.cells,
            k,
            springs.near,
            springs.far,
            springs.diagonal,
            springs.cell,
            x,
            d,
            s.cell_multipliers,
            step.first,
            step.store,
            material.damping * step.inverse,
            low,
            step.second,
            s.last_displacements,
            body.particles,
        )
