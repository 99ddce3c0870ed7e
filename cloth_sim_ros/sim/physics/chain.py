# SPDX-License-Identifier: Apache-2.0
"""The direct solve along a chain of segments, seen as a ladder of masses and edges, from one end to the other.

One Newton step of implicit Euler (or BDF2) on a chain is block-tridiagonal with 3x3 blocks. Particles are eliminated
one after another, in units of mass (forces times h_e^2). A particle answers a force f with the displacement q + Y f.
The compliance Y gathers its mass and all that was eliminated before it. An edge between i and j has the compliance C =
diag(alpha, 1/g, 1/g) in its own frame: alpha / h_e^2 along the edge, and g = tension / length across it. That g is the
geometric stiffness, which is dropped under compression, so that the tangent stays positive. Then

    Z = C + Y_i,    S_j = m_j + Z^-1,    Y_j = S_j^-1.

Only positive quantities are added, never subtracted, so single precision keeps its digits for compliance 0 and for
loads of 1e5 times the mass alike. Matrices stay in the frames of their edges, because their entries along and across an
edge may differ by ten orders of magnitude.

Many threads solve a chain as a parallel scan over spans of it. Spans join like the elements of a parallel Kalman
smoother (Sarkka and Garcia-Fernandez 2021), again by adding positive matrices alone.
"""

import warp as wp

from cloth_sim_ros.sim.kernels.intrinsics import larger, quick_inverse_root, quick_quotient


@wp.func
def edge_frame(n: wp.vec3) -> wp.mat33:
    """An orthonormal frame with rows n and two tangents, continuous in n but at n = -z (Duff et al. 2017)."""
    sign = wp.where(n[2] < 0.0, -1.0, 1.0)
    a = quick_quotient(-1.0, sign + n[2])
    b = n[0] * n[1] * a
    return wp.mat33(
        n[0], n[1], n[2],
        1.0 + sign * n[0] * n[0] * a, sign * b, -sign * n[0],
        b, sign + n[1] * n[1] * a, -n[1],
    )  # fmt: skip


@wp.func
def symmetric(diagonal: wp.vec3, beside: wp.vec3) -> wp.mat33:
    """The symmetric matrix of this diagonal and of its entries 01, 02 and 12."""
    return wp.mat33(
        diagonal[0], beside[0], beside[1], beside[0], diagonal[1], beside[2], beside[1], beside[2], diagonal[2]
    )


@wp.func
def _inverse(d: wp.vec3, a: float, b: float, c: float) -> wp.mat33:
    """M^-1 of the symmetric, positive definite M of whatever range with diagonal d and a = M01, b = M02, c = M12.

    As a sum of squares, M^-1 = sum of r r^T / pivot (LDL^T), so that rounding never makes it indefinite.
    """
    first = quick_quotient(1.0, d[0])
    l1 = a * first
    l2 = b * first
    second = quick_quotient(1.0, larger(d[1] - l1 * a, 1.0e-7 * d[1]))
    e = c - l1 * b
    l = e * second
    third = quick_quotient(1.0, larger((d[2] - l2 * b) - l * e, 1.0e-7 * d[2]))
    r = l1 * l - l2
    beside = -second * l1
    corner = third * r
    last = -third * l
    diagonal = wp.vec3(first - beside * l1 + corner * r, second - last * l, third)
    return symmetric(diagonal, wp.vec3(beside - corner * l, corner, last))


@wp.func
def series_admittance(y: wp.mat33, alpha: float, g: float) -> wp.mat33:
    """Z^-1 = (diag(alpha, 1/g, 1/g) + Y)^-1 [kg] in the edge's frame, finite for g = 0; alpha + Y00 must be above 0."""
    # Turned by a large angle, rounding may leave a small entry below 0.
    across = quick_quotient(1.0, larger(g, 1.0e-30))
    d = wp.vec3(alpha + larger(y[0, 0], 0.0), across + larger(y[1, 1], 0.0), across + larger(y[2, 2], 0.0))
    return _inverse(d, y[0, 1], y[0, 2], y[1, 2])


@wp.func
def particle_compliance(w: float, admittance: wp.mat33) -> wp.mat33:
    """Y = (m + Z^-1)^-1 [1/kg] of a particle of inverse mass w behind an edge; 0 where it is pinned."""
    if w == 0.0:
        return wp.mat33(0.0)
    return inverse_beside(quick_quotient(1.0, w), admittance)


@wp.func
def inverse_beside(m: float, a: wp.mat33) -> wp.mat33:
    """(m + A)^-1 for m > 0 and a positive semi-definite A of whatever range."""
    return _inverse(wp.vec3(m + a[0, 0], m + a[1, 1], m + a[2, 2]), a[0, 1], a[0, 2], a[1, 2])


@wp.func
def turn_frame(y: wp.mat33, old: wp.mat33, new: wp.mat33) -> wp.mat33:
    """A symmetric matrix given in the frame `old`, in the frame `new`; straight chains keep their small entries."""
    r = new * wp.transpose(old)
    return r * y * wp.transpose(r)


@wp.struct
class Span:
    """Neighbouring segments, each with the particle at its far end, seen from outside.

    The particle before it has a displacement u, and a force f acts on its last particle. The last particle then moves
    by A u + b + C f, and the particle before it feels the force eta - J u + A^T f. Vectors and matrices are in the
    frame of the first segment on the side of u, in that of the last on the side of f.
    """

    passed: wp.mat33  # A
    compliance: wp.mat33  # C [1/kg]
    inertia: wp.mat33  # J [kg]
    free: wp.vec3  # b [m]
    pull: wp.vec3  # eta [kg m]


@wp.func
def span_of(w: float, along: float, across: float, tension: float, gap: float, missing: wp.vec3) -> Span:
    """One segment of compliance diag(along, 1/across, 1/across) and its far particle of inverse mass w.

    tension: what the segment pulls with already. gap: what it is too long by. missing: how far the particle lies from
    where it would be without the chain, in the segment's frame.
    """
    span = Span()
    a = quick_quotient(1.0, along + w)
    t = quick_quotient(1.0, 1.0 + across * w)
    span.passed = wp.diag(wp.vec3(w * a, across * w * t, across * w * t))
    span.compliance = wp.diag(wp.vec3(along * w * a, w * t, w * t))
    span.inertia = wp.diag(wp.vec3(a, across * t, across * t))
    span.free = wp.vec3(along * a * (missing[0] - w * tension) - w * a * gap, t * missing[1], t * missing[2])
    span.pull = wp.vec3((gap + missing[0] + along * tension) * a, across * t * missing[1], across * t * missing[2])
    return span


@wp.func
def semidefinite_root(m: wp.mat33) -> wp.mat33:
    """A lower triangular L with L L^T = M, for a positive semi-definite M of whatever range (Cholesky)."""
    i = wp.vec3(_inverse_root(m[0, 0]), _inverse_root(m[1, 1]), _inverse_root(m[2, 2]))
    a = m[0, 1] * i[0] * i[1]
    b = m[0, 2] * i[0] * i[2]
    c = m[1, 2] * i[1] * i[2]
    second = wp.max(1.0 - a * a, 1.0e-7)
    r = quick_inverse_root(second)
    l = (c - a * b) * r
    rest = wp.max(1.0 - b * b - l * l, 1.0e-14)
    third = rest * quick_inverse_root(rest)
    s = wp.vec3(m[0, 0] * i[0], m[1, 1] * i[1], m[2, 2] * i[2])
    return wp.mat33(s[0], 0.0, 0.0, a * s[1], second * r * s[1], 0.0, b * s[2], l * s[2], third * s[2])


@wp.func
def _inverse_root(value: float) -> float:
    """1/sqrt of a diagonal entry; 0 where there is nothing."""
    return wp.where(value > 1.0e-30, quick_inverse_root(wp.max(value, 1.0e-30)), 0.0)


# Products with a lower triangular L, without its zeros, which a compiler must otherwise keep because of infinities.


@wp.func
def _before(l: wp.mat33, a: wp.mat33) -> wp.mat33:
    """L^T A."""
    return wp.matrix_from_rows(
        l[0, 0] * a[0] + l[1, 0] * a[1] + l[2, 0] * a[2], l[1, 1] * a[1] + l[2, 1] * a[2], l[2, 2] * a[2]
    )


@wp.func
def _behind(a: wp.mat33, l: wp.mat33) -> wp.mat33:
    """A L."""
    return wp.transpose(_before(l, wp.transpose(a)))


@wp.func
def _without(a: wp.mat33, l: wp.mat33, b: wp.mat33) -> wp.mat33:
    """A - L B."""
    return wp.matrix_from_rows(
        a[0] - l[0, 0] * b[0],
        (a[1] - l[1, 0] * b[0]) - l[1, 1] * b[1],
        ((a[2] - l[2, 0] * b[0]) - l[2, 1] * b[1]) - l[2, 2] * b[2],
    )


@wp.func
def _lower(l: wp.mat33, v: wp.vec3) -> wp.vec3:
    """L v."""
    return wp.vec3(l[0, 0] * v[0], l[1, 0] * v[0] + l[1, 1] * v[1], l[2, 0] * v[0] + l[2, 1] * v[1] + l[2, 2] * v[2])


@wp.func
def _upper(l: wp.mat33, v: wp.vec3) -> wp.vec3:
    """L^T v."""
    return wp.vec3(l[0, 0] * v[0] + l[1, 0] * v[1] + l[2, 0] * v[2], l[1, 1] * v[1] + l[2, 1] * v[2], l[2, 2] * v[2])


@wp.func
def symmetric_product(a: wp.mat33, b: wp.mat33) -> wp.mat33:
    """A B^T where it is symmetric."""
    return symmetric(
        wp.vec3(wp.dot(a[0], b[0]), wp.dot(a[1], b[1]), wp.dot(a[2], b[2])),
        wp.vec3(wp.dot(a[0], b[1]), wp.dot(a[0], b[2]), wp.dot(a[1], b[2])),
    )


@wp.func
def _between(first: Span, second: Span):
    """L, X and M^-1 of `join`."""
    l = semidefinite_root(first.compliance)
    x = _before(l, second.inertia)
    return l, x, inverse_beside(1.0, _behind(x, l))


@wp.func
def _beyond(first: Span, second: Span, l: wp.mat33, x: wp.mat33, inverse: wp.mat33):
    """Compliance and displacement of the end of two joined spans; then D b = b - L h of the first span's end, and h."""
    u = _behind(second.passed, l)
    held = inverse * (x * first.free)
    kept = first.free - _lower(l, held)
    pushed = inverse * _upper(l, second.pull)
    compliance = second.compliance + symmetric_product(u * inverse, u)
    return compliance, second.free + second.passed * kept + u * pushed, kept, held


@wp.func
def join(first: Span, second: Span) -> Span:
    """Two spans one behind the other, the first ending in the frame in which the second begins.

    Between them C = L L^T of the first meets J of the second. Let X = L^T J, M = 1 + X L and N = M^-1 X. The particle
    that they share keeps the share D = (1 + C J)^-1 = 1 - L N of its motion, and both reach beyond it by

        (C^-1 + J)^-1 = L M^-1 L^T    and    (J^-1 + C)^-1 = D^T J D + N^T N.
    """
    l, x, inverse = _between(first, second)
    compliance, free, kept, held = _beyond(first, second, l, x, inverse)
    v = inverse * (x * first.passed)
    e = _without(first.passed, l, v)
    turned = wp.transpose(e)
    back = wp.transpose(v)
    span = Span()
    span.passed = second.passed * e
    span.compliance = compliance
    # Small terms hardly count beside large ones, so the small ones are summed first.
    span.inertia = first.inertia + (symmetric_product(turned * second.inertia, turned) + symmetric_product(back, back))
    span.free = free
    span.pull = first.pull + turned * (second.pull - second.inertia * kept) - back * held
    return span


@wp.func
def close(first: Span, second: Span) -> Span:
    """Join spans if the first begins at a fixed end of the chain; only compliance and displacement are set."""
    l, x, inverse = _between(first, second)
    compliance, free, kept, held = _beyond(first, second, l, x, inverse)
    span = Span()
    span.compliance = compliance
    span.free = free
    return span


@wp.func
def turned_end(span: Span, r: wp.mat33) -> Span:
    """The span with its end in another frame; r turns the old one into the new."""
    span.passed = r * span.passed
    span.compliance = r * span.compliance * wp.transpose(r)
    span.free = r * span.free
    return span
