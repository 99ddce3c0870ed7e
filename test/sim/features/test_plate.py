# SPDX-License-Identifier: Apache-2.0
"""Bending of sheets against beams, the heavy elastica and Timoshenko, in float64: any mesh, any direction."""

import numpy as np
import pytest
import scipy.sparse as sparse
import warp as wp
from scipy.optimize import brentq
from scipy.sparse.linalg import spsolve
from scipy.spatial import Delaunay

from cloth_sim_ros.sim import Cloth
from cloth_sim_ros.sim.kernels.compiled import compiled
from cloth_sim_ros.sim.physics.plate import rest_curvature
from cloth_sim_ros.sim.physics.quaternion import rotate
from cloth_sim_ros.sim.topology import build, plate
from cloth_sim_ros.study.closed_forms import bending

MESHES = ("one way", "alternating", "equilateral", "jittered")
GRAVITY = np.array((0.0, 0.0, -9.81))


def strip(kind, segments, columns, length, width, before=1):
    """Points (N, 3) and triangles (T, 3) of a strip along x from 0 to `length`, with `before` segments behind 0."""
    a, b = length / segments, width / (columns - 1)
    ix, iy = np.meshgrid(np.arange(-before, segments + 1), np.arange(columns), indexing="ij")
    p = np.stack([ix * a, iy * b - width / 2], axis=2).reshape(-1, 2)
    if kind in ("one way", "alternating"):
        index = np.arange(len(p)).reshape(ix.shape)
        i, j, k, m = (each.ravel() for each in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
        other = ((ix + iy)[:-1, :-1].ravel() % 2 == 1) & (kind == "alternating")
        first = np.stack([i, j, np.where(other, m, k)], axis=1)
        triangles = np.concatenate([first, np.stack([np.where(other, j, i), k, m], axis=1)])
        return np.c_[p, np.zeros(len(p))], triangles
    inside = (p[:, 0] > a / 2) & (p[:, 0] < length - a / 2)
    if kind == "equilateral":
        # Every second line along x is shifted by half a segment, with a further point at its beginning.
        shifted = iy.ravel() % 2 == 1
        p[shifted & (p[:, 0] > a / 2), 0] -= a / 2
        p = np.concatenate([p, [(length, y) for y in np.unique(p[shifted, 1])]])
    else:
        moved = np.random.default_rng(1).uniform(-0.3, 0.3, p.shape) * (a, b)
        border = np.abs(p[:, 1]) > width / 2 - 1e-9
        p += moved * np.stack([inside, inside & ~border], axis=1)
    triangles = Delaunay(p).simplices
    corners = p[triangles]
    double = np.linalg.det(corners[:, 1:] - corners[:, :1])
    triangles[double < 0] = triangles[double < 0][:, ::-1]
    return np.c_[p, np.zeros(len(p))], triangles[np.abs(double) > 1e-6 * a * b]


def areas(points, triangles):
    corners = points[triangles]
    return 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)


def lumped(points, triangles):
    return np.bincount(triangles.ravel(), np.repeat(areas(points, triangles) / 3, 3), minlength=len(points))


def matrix(points, triangles, pinned=None):
    """The operator Q (N, N) for rigidity 1."""
    count = len(points)
    found = plate.of_triangles(points, triangles, np.zeros(count, bool) if pinned is None else pinned)
    rows = np.repeat(np.arange(count), found.neighbours.shape[1])
    weights = sparse.csr_matrix((found.weights.ravel(), (rows, found.neighbours.ravel())), (count, count))
    return weights - sparse.diags(np.asarray(weights.sum(axis=1)).ravel())


class Sheet:
    """A mesh of springs (Van Gelder 1998) and plate, without units: density 1 kg/m^2."""

    def __init__(self, points, triangles, pinned, stretch):
        self.rest, self.pinned = points, pinned
        self.q = matrix(points, triangles, pinned)
        self.masses = lumped(points, triangles)
        half = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
        pairs, inverse = np.unique(half, axis=0, return_inverse=True)
        self.difference = sparse.csr_matrix(
            (np.tile([-1.0, 1.0], len(pairs)), pairs.ravel(), 2 * np.arange(len(pairs) + 1)), (len(pairs), len(points))
        )
        self.length = np.linalg.norm(self.difference @ points, axis=1)
        area = np.bincount(inverse.ravel(), np.tile(areas(points, triangles), 3))
        self.constant = stretch * area / self.length**2
        self.free = np.flatnonzero(~np.repeat(pinned, 3))

    def springs(self, x, soft):
        """Force (N, 3) and stiffness of the springs; with `soft` without what compression takes away."""
        d = self.difference @ x
        length = np.linalg.norm(d, axis=1)
        n = d / length[:, None]
        along = n[:, :, None] * n[:, None, :]
        across = 1.0 - self.length / length
        across = (np.maximum(across, 0.0) if soft else across)[:, None, None] * (np.eye(3) - along)
        blocks = self.constant[:, None, None] * (along + across)
        count = len(d)
        middle = sparse.bsr_matrix((blocks, np.arange(count), np.arange(count + 1)), (3 * count, 3 * count))
        difference = sparse.kron(self.difference, sparse.eye(3))
        pull = (self.constant * (length - self.length))[:, None] * n
        return -(self.difference.T @ pull), difference.T @ middle @ difference

    def energy(self, x, rigidity):
        stretch = np.linalg.norm(self.difference @ x, axis=1) - self.length
        moved = x - self.rest
        bend = rigidity * (moved * (self.q @ moved)).sum()
        return 0.5 * (self.constant @ stretch**2 + bend) - self.masses @ moved @ GRAVITY

    def step(self, x, rigidity, bend, soft):
        """The step of Newton's method from x, and where along it the energy is less; None if nowhere."""
        pull, stiffness = self.springs(x, soft)
        force = pull - rigidity * (self.q @ (x - self.rest)) + self.masses[:, None] * GRAVITY
        step = np.zeros(x.size)
        step[self.free] = spsolve((stiffness + bend).tocsc()[self.free][:, self.free], force.ravel()[self.free])
        step = step.reshape(-1, 3)
        energy = self.energy(x, rigidity)
        for share in 0.5 ** np.arange(12):
            if self.energy(x + share * step, rigidity) < energy:
                return step, x + share * step
        return step, None

    def settled(self, rigidity, start):
        """Where it hangs under its weight, by Newton's method, clamped where it is pinned."""
        x, bend = start.copy(), sparse.kron(rigidity * self.q, sparse.eye(3))
        for k in range(100):
            step, lower = self.step(x, rigidity, bend, soft=k < 2)
            if np.abs(step).max() < 1e-6 * np.ptp(self.rest):
                return x + step
            if lower is None and k >= 2:
                step, lower = self.step(x, rigidity, bend, soft=True)
            if lower is None:
                break
            x = lower
        raise ArithmeticError(f"no rest found: the last step was {np.abs(step).max()} m")


def elastica(gamma):
    """Points (401, 2) of the heavy elastica of length 1 at gamma = w L^3 / EI."""
    return bending.heavy_elastica(1.0, 1.0, gamma, count=401)


def cantilever(kind, segments, columns, gamma, length=1.0, width=0.25):
    """A clamped strip at rest under its weight: height and reach of its tip over its length, and by how much of the
    height its tip's corners differ."""
    points, triangles = strip(kind, segments, columns, length, width)
    pinned = points[:, 0] < 1e-9 * length
    sheet = Sheet(points, triangles, pinned, stretch=9.81 * length / 5e-4)
    out, down = np.apply_along_axis(
        lambda line: np.interp(points[:, 0] / length, np.linspace(0, 1, 401), line), 0, elastica(gamma)
    ).T
    start = np.stack([np.where(pinned, points[:, 0], length * out), points[:, 1], -length * down], axis=1)
    x = sheet.settled(9.81 * length**3 / gamma, start)
    tip = np.flatnonzero(points[:, 0] > length * (1.0 - 1e-9))
    tip = tip[np.argsort(points[tip, 1])]
    height, reach = -x[tip, 2].mean() / length, x[tip, 0].mean() / length
    return height, reach, abs(x[tip[0], 2] - x[tip[-1], 2]) / (height * length)


@pytest.mark.parametrize("kind", MESHES)
@pytest.mark.parametrize(
    "segments, columns, gamma",
    [(8, 3, 0.1), (8, 3, 10), (16, 3, 0.1), (16, 5, 10), (24, 5, 100), (32, 9, 100), (64, 17, 10), (64, 17, 1000)],
)
def test_strip_hangs_as_the_heavy_elastica(kind, segments, columns, gamma):
    """Height over reach, the plate test of Romero et al. 2021; the tip must not twist."""
    height, reach, twist = cantilever(kind, segments, columns, gamma)
    out, down = elastica(gamma)[-1]
    assert height / reach == pytest.approx(down / out, rel=0.03)
    assert height == pytest.approx(down, rel=0.02)
    assert twist < 5e-3


@pytest.mark.parametrize("kind", MESHES)
@pytest.mark.parametrize("gamma", [100, 1000])
def test_where_segments_are_longer_than_the_bend_the_tip_is_still_low(kind, gamma):
    """Eight segments cannot show a bend over a tenth of the length; the error is then that of the reach."""
    height, reach, _ = cantilever(kind, 8, 3, gamma)
    out, down = elastica(gamma)[-1]
    assert height == pytest.approx(down, rel=0.05)
    assert reach == pytest.approx(out, abs=0.1)


@pytest.mark.parametrize("kind", MESHES)
def test_strip_converges_at_second_order(kind):
    out, down = elastica(10)[-1]
    errors = [abs(np.divide(*cantilever(kind, n, m, 10)[:2]) / (down / out) - 1) for n, m in ((20, 5), (40, 9))]
    assert errors[1] < 0.4 * errors[0]


@pytest.mark.parametrize("kind", MESHES)
@pytest.mark.parametrize("spacing", [2, 5, 10, 20])
def test_overhang_gives_the_rigidity_back(kind, spacing):
    """ASTM D1388: of a strip of 25 mm x 200 mm, 180 mm hang over; B from the weight at which they hang at 41.5 deg."""

    def slope(gamma):
        out, down = elastica(gamma)[-1]
        return np.log(down / out) - np.log(np.tan(np.radians(41.5)))

    exact = brentq(slope, 5, 12, xtol=1e-3)
    columns = max(3, round(25 / spacing) + 1)
    height, reach, twist = cantilever(kind, 180 // spacing, columns, exact, 0.18, 0.025)
    steepness = (slope(1.02 * exact) - slope(0.98 * exact)) / 0.04
    measured = 1.0 - np.log(height / reach / np.tan(np.radians(41.5))) / steepness
    assert measured == pytest.approx(1.0, abs=0.05)
    assert twist < 5e-3


def bent(points, hessian):
    """A quadratic over a sheet in its own axes."""
    return 0.5 * np.einsum("ni,ij,nj->n", points[:, :2], hessian, points[:, :2])


def with_free_edges(points, triangles, hessian):
    """A B/2 |H|^2 for B = 1, summed over triangles; of those at a border the least that slopes there allow."""
    half = np.sort(np.stack([triangles[:, [1, 2]], triangles[:, [2, 0]], triangles[:, [0, 1]]], axis=1), axis=2)
    _, inverse, count = np.unique(half.reshape(-1, 2), axis=0, return_inverse=True, return_counts=True)
    border = (count[inverse.ravel()] == 1).reshape(-1, 3)
    total = 0.5 * (hessian**2).sum() * areas(points, triangles)
    for t in np.flatnonzero(border.any(axis=1)):
        edge = np.diff(points[half[t][border[t]]][:, :, :2], axis=1)[:, 0]
        n = np.stack([edge[:, 1], -edge[:, 0]], axis=1) / np.linalg.norm(edge, axis=1, keepdims=True)
        freed = (n[:, :, None] * n[:, None, :]).reshape(-1, 4).T
        left = hessian.ravel() - freed @ np.linalg.lstsq(freed, hessian.ravel(), rcond=None)[0]
        total[t] *= (left**2).sum() / (hessian**2).sum()
    return total.sum()


@pytest.mark.parametrize("kind", MESHES)
@pytest.mark.parametrize("shape", [((1, 0), (0, 0)), ((0, 0), (0, 1)), ((0.5, 0.5), (0.5, 0.5)), ((1, 0), (0, -1))])
def test_cylinders_and_saddles_have_their_energy_in_any_direction(kind, shape):
    points, triangles = strip(kind, 16, 9, 1.0, 0.5)
    u, hessian = bent(points, np.array(shape, float)), np.array(shape, float)
    turned = rotate((0.1, 0.5, -0.3, np.sqrt(1 - 0.35)), points) + (0.3, 5.0, -2.0)
    q = matrix(turned, triangles)
    # Of a few edges at the borders of an irregular mesh, the vertices do not tell all curvatures.
    rel = 5e-4 if kind == "jittered" else 1e-9
    assert 0.5 * u @ (q @ u) == pytest.approx(with_free_edges(points, triangles, hessian), rel=rel)
    # Away from borders a constant moment is in balance: the patch test.
    force = q @ u
    inside = (points[:, 0] > 0.25) & (points[:, 0] < 0.75) & (np.abs(points[:, 1]) < 0.09)
    assert inside.sum() > 5 and np.abs(force[inside]).max() < 1e-9 * np.abs(force).max()


@pytest.mark.parametrize("kind", MESHES)
def test_twist_has_the_energy_of_the_whole_area(kind):
    """B A kxy^2, borders and all: at Poisson ratio 0 a twisted plate has twice the rigidity B w of a bent one."""
    points, triangles = strip(kind, 16, 5, 1.0, 0.25)
    u = points[:, 0] * points[:, 1]
    assert 0.5 * u @ (matrix(points, triangles) @ u) == pytest.approx(areas(points, triangles).sum(), rel=1e-4)


@pytest.mark.parametrize("kind", MESHES)
def test_operator_knows_no_axes_no_orientation_and_no_motion(kind):
    points, triangles = strip(kind, 8, 5, 1.0, 0.5)
    rng = np.random.default_rng(4)
    shuffled = np.stack([np.roll(each, rng.integers(3)) for each in triangles])
    shuffled[::3] = shuffled[::3, ::-1]
    q, other = matrix(points, triangles).toarray(), matrix(points @ np.diag((-1, 1, 1)), shuffled).toarray()
    assert np.abs(q - q.T).max() == 0.0
    assert np.abs(q - other).max() < 1e-8 * np.abs(q).max()
    assert np.abs(q @ points).max() < 1e-10 * np.abs(q).max()
    values = np.linalg.eigvalsh(q)
    assert np.abs(values[:3]).max() < 1e-9 * values[3]  # planes alone cost nothing


def buckling(kind, segments, columns, loaded):
    """Critical load [N] at B = 1 of a ribbon of 1 m x 0.05 m on edge, clamped at one end; `loaded` "end" or "all"."""
    length, width = 1.0, 0.05
    points, triangles = strip(kind, segments, columns, length, width)
    pinned = points[:, 0] < 1e-9
    sheet = Sheet(points, triangles, pinned, stretch=1e9)
    loads = lumped(points, triangles) * (~pinned if loaded == "all" else np.abs(points[:, 0] - length) < 1e-9)
    loads = loads / loads.sum()
    _, stiffness = sheet.springs(points, soft=False)
    plane = sheet.free[sheet.free % 3 != 2]
    moved = np.zeros(3 * len(points))
    moved[plane] = spsolve(stiffness.tocsc()[plane][:, plane], np.outer(loads, (0, -1, 0)).ravel()[plane])
    d = sheet.difference @ points
    tension = sheet.constant * (d * (sheet.difference @ moved.reshape(-1, 3))).sum(1) / sheet.length
    free = np.flatnonzero(~pinned)
    prestress = (sheet.difference.T @ sparse.diags(tension / sheet.length) @ sheet.difference).toarray()[free][:, free]
    q = sheet.q.toarray()[free][:, free]
    inverse = np.linalg.inv(np.linalg.cholesky(q))
    return -1.0 / np.linalg.eigvalsh(inverse @ prestress @ inverse.T).min()


@pytest.mark.parametrize("kind", MESHES)
@pytest.mark.parametrize("loaded, factor", [("end", 4.0126), ("all", 12.85)])
def test_ribbon_on_edge_buckles_sideways_at_timoshenkos_load(kind, loaded, factor):
    """P = factor sqrt(EI GJ) / L^2 with EI = B w and GJ = 2 B w (Timoshenko and Gere 1961, 6.3).

    Twist has the energy B/2 * 2 kxy^2 * w a length, which is GJ/2 kxy^2.
    """
    width = 0.05
    expected = factor * np.sqrt(2.0) * width
    errors = [abs(buckling(kind, *size, loaded) / expected - 1) for size in ((40, 3), (80, 5))]
    assert max(errors) < 0.05


def rolled(points, radius):
    """A sheet rolled about y: what was x is the length of an arc."""
    angle = points[:, 0] / radius
    return np.stack([radius * np.sin(angle), points[:, 1], radius * (1 - np.cos(angle))], axis=1)


def shape_energy(found, q, x):
    """Energy of a sheet that is curved at rest for B = 1, less the constant."""
    a, b, c = (x[found.stencil[:, k]] for k in range(3))
    n = np.cross(b - a, c - a)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    moment = (found.gradients[:, :, None] * x[found.stencil]).sum(1)
    return 0.5 * (x * (q @ x)).sum() - (n * moment).sum()


@pytest.mark.parametrize("kind", MESHES)
def test_rolled_sheet_rests_as_it_is_and_bends_with_the_same_rigidity(kind):
    flat, triangles = strip(kind, 48, 9, 1.0, 0.2, before=0)
    x = rolled(flat, 0.5)
    none = np.zeros(len(x), bool)
    found, q = plate.of_triangles(x, triangles, none), matrix(x, triangles)
    at_rest = shape_energy(found, q, x)
    # kappa = 2 / m: rolled out it holds A kappa^2 / 2, rolled the other way four times as much.
    expected = with_free_edges(flat, triangles, np.diag((2.0, 0.0)))
    assert at_rest == pytest.approx(-expected, rel=3e-3)
    assert shape_energy(found, q, flat) - at_rest == pytest.approx(expected, rel=3e-3)
    assert shape_energy(found, q, rolled(flat, -0.5)) - at_rest == pytest.approx(4.0 * expected, rel=3e-3)
    # Nothing pulls at it where it was built, and a little more or less rolled costs A (dkappa)^2 / 2.
    push = 1e-5 * np.random.default_rng(3).standard_normal(x.shape)
    rest, other = (shape_energy(found, q, at + push) - shape_energy(found, q, at - push) for at in (x, flat))
    assert abs(rest) < 1e-4 * abs(other)
    more, less = (shape_energy(found, q, rolled(flat, 1 / kappa)) - at_rest for kappa in (2.5, 1.5))
    assert (more + less) / 2 == pytest.approx(expected / 16, rel=1e-2)
    assert abs(more - less) < 0.02 * (more + less)


def test_flat_sheets_have_no_rest_curvature_and_clamps_no_energy():
    points, triangles = strip("jittered", 8, 5, 1.0, 0.5)
    found = plate.of_triangles(points, triangles, np.zeros(len(points), bool))
    assert found.stencil is None and found.gradients is None
    assert plate.of_triangles(points, triangles, np.ones(len(points), bool)) is None
    assert plate.of_triangles(points, triangles[:1], np.zeros(len(points), bool)) is None


@compiled
def curved_forces(
    x: wp.array(dtype=wp.vec3), stencil: wp.array2d(dtype=int), g: wp.array2d(dtype=float), f: wp.array(dtype=wp.vec3)
):
    t = wp.tid()
    moment = wp.vec3()
    for j in range(stencil.shape[1]):
        moment += g[t, j] * x[stencil[t, j]]
    term = rest_curvature(x[stencil[t, 0]], x[stencil[t, 1]], x[stencil[t, 2]], moment)
    for j in range(stencil.shape[1]):
        wp.atomic_add(f, stencil[t, j], g[t, j] * term.normal)
    for k in range(3):
        wp.atomic_add(f, stencil[t, k], term.pull[k] * term.normal)


@compiled
def flat_forces(
    x: wp.array(dtype=wp.vec3),
    v: wp.array(dtype=wp.vec3),
    neighbours: wp.array2d(dtype=int),
    weights: wp.array2d(dtype=float),
    rigidity: float,
    damping: float,
    f: wp.array(dtype=wp.vec3),
):
    i = wp.tid()
    for j in range(neighbours.shape[1]):
        n = neighbours[i, j]
        f[i] -= rigidity * weights[i, j] * (x[n] - x[i] + damping * (v[n] - v[i]))


@pytest.mark.parametrize("kind", ["one way", "jittered"])
def test_forces_are_the_slope_of_the_energy(device, kind):
    flat, triangles = strip(kind, 4, 4, 1.0, 0.8, before=0)
    built = rolled(flat, 0.5)
    found, q = plate.of_triangles(built, triangles, np.zeros(len(flat), bool)), matrix(built, triangles)
    rng = np.random.default_rng(7)
    x = (built + 0.05 * rng.standard_normal(flat.shape)).astype(np.float32).astype(float)
    v = rng.standard_normal(flat.shape)
    slope, step = np.zeros_like(x), 1e-6
    for index in np.ndindex(x.shape):
        shift = np.zeros_like(x)
        shift[index] = step
        slope[index] = (shape_energy(found, q, x + shift) - shape_energy(found, q, x - shift)) / (2 * step)
    points, result = (wp.array(each, dtype=wp.vec3, device=device) for each in (x, 0.0 * x))
    stencil, gradients = wp.array(found.stencil, device=device), wp.array(found.gradients, dtype=float, device=device)
    wp.launch(curved_forces, len(stencil), inputs=[points, stencil, gradients, result], device=device)
    curved = result.numpy().copy()
    result.zero_()
    neighbours, weights = wp.array(found.neighbours, device=device), wp.array(found.weights, dtype=float, device=device)
    velocities = wp.array(v, dtype=wp.vec3, device=device)
    inputs = [points, velocities, neighbours, weights, 3.0, 0.0, result]
    wp.launch(flat_forces, len(x), inputs=inputs, device=device)
    assert result.numpy() / 3.0 + curved == pytest.approx(-slope, abs=1e-4 * np.abs(slope).max())
    result.zero_()
    inputs[5] = 0.01
    wp.launch(flat_forces, len(x), inputs=inputs, device=device)
    expected = -3.0 * (q @ (x + 0.01 * v))
    assert result.numpy() == pytest.approx(expected, abs=1e-4 * np.abs(expected).max())
    # No force and no torque as a whole.
    assert np.abs(curved.sum(axis=0)).max() < 1e-4 * np.abs(curved).max()
    assert np.abs(np.cross(x, curved).sum(axis=0)).max() < 1e-3 * np.abs(curved).max()


def test_degenerate_triangles_and_folds_give_numbers():
    points, triangles = strip("jittered", 8, 5, 1.0, 0.5)
    collapsed, folded, shut = points.copy(), points.copy(), points.copy()
    collapsed[triangles[20, 0]] = collapsed[triangles[20, 1]]
    folded[:, 0] = np.abs(folded[:, 0] - 0.5)
    shut[:] = shut[:1]
    needles = np.concatenate([triangles, [[0, 1, 2]]])  # on a border, without an area
    for at, faces in ((collapsed, triangles), (folded, triangles), (points, needles)):
        found = plate.of_triangles(at, faces, np.zeros(len(at), bool))
        assert np.isfinite(found.weights).all()
        assert found.gradients is None or np.isfinite(found.gradients).all()
    assert plate.of_triangles(shut, triangles, np.zeros(len(shut), bool)) is None
    point = wp.vec3(1.0, 2.0, 3.0)
    assert np.isfinite(np.array(rest_curvature(point, point, point, point).pull)).all()


@pytest.mark.parametrize("pins, energy", [("none", 2.0), (tuple(range(18)), 4.0)])
def test_clamp_of_two_pinned_rows_is_at_the_second_one(pins, energy):
    """A square metre of rows 0.25 m apart, turned by 1 at the second one: EI / a, and twice that beyond a clamp."""
    topology = build(Cloth(resolution=(9, 5), bending="dihedral", bend_compliance=0.1, pins=pins), "it", True)
    found, u = topology.plate, np.maximum(topology.layout[:, 1] + 0.25, 0.0)
    force = -(found.weights * (u[found.neighbours] - u[:, None])).sum(axis=1)
    assert -0.5 * u @ force == pytest.approx(energy)


def test_only_cloths_that_bend_by_angles_have_a_plate():
    assert build(Cloth(bend_compliance=0.1), "it", True).plate is None
    assert build(Cloth(bend_compliance=None, bending="dihedral"), "it", True).plate is None


@pytest.mark.parametrize("kind", ["one way", "jittered"])
def test_fastest_mode_of_a_plate(kind):
    points, triangles = strip(kind, 16, 9, 1.0, 0.5)
    pins = np.flatnonzero(points[:, 0] < 1e-9).tolist()
    cloth = Cloth.from_mesh(points, triangles, mass=0.3, pins=pins, bending="dihedral", bend_compliance=2.0)
    topology = build(cloth, "it", True)
    root = topology.masses[~topology.pinned] ** -0.5
    q = matrix(points, triangles, topology.pinned).toarray()[~topology.pinned][:, ~topology.pinned]
    exact = 0.5 * np.linalg.eigvalsh(root[:, None] * q * root[None, :])[-1]
    assert 0.98 * exact < 0.5 * topology.plate_rate < 1.0001 * exact
    assert build(Cloth(), "it", True).plate_rate == 0.0
