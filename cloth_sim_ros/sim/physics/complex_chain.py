"""The ladder of chain.py with complex numbers, as one Newton step of the two-stage Radau IIA method needs it.

For M x'' = F(x) the displacements D = (D_1, D_2) of the stages at c = (1/3, 1) of a step h follow from

    M / h^2 A^-2 (D - c h v) = F(x + D),    A^-1 = [[3/2, 1/2], [-9/2, 5/2]],    A^-2 = [[0, 2], [-18, 4]],

and D_2 is the displacement of the step, (5 D_2 - 9 D_1) / (2 h) the velocity behind it (Hairer and Wanner 1996, Solving
Ordinary Differential Equations II, IV.5). With one tangent K for both stages, Newton's step falls apart along the
eigenvectors of A^-1, one the conjugate of the other (IV.8): of the eigenvalues lambda = 2 + i sqrt(2) of A^-1 and
mu = lambda^2 of A^-2 and their left and right eigenvectors w and v with w v = 1,

    (mu M + h^2 K) z = w . r,    D_i += 2 Re(v_i z)

for residuals r of the stages in units of mass times length. What grows with the velocity, drag and dashpots, comes with
lambda. All phases of masses lie between 0 and that of mu, 71 degrees, those of compliances between -71 degrees and 0,
and sums and inverses stay there: elimination needs no pivoting, and nothing cancels.
"""

import warp as wp

from cloth_sim_ros.sim.schedules.native import inverse_root, quick_quotient, root

_ROOT2 = 2.0**0.5
LAMBDA = wp.constant(wp.vec2(2.0, _ROOT2))
MU = wp.constant(wp.vec2(2.0, 4.0 * _ROOT2))
# v = ((1 - 2 sqrt(2) i) / 9, 1), w = (9 sqrt(2) / 8 i, 1/2 - sqrt(2) / 8 i).
FIRST_RIGHT = wp.constant(wp.vec2(1.0 / 9.0, -2.0 * _ROOT2 / 9.0))
FIRST_LEFT = wp.constant(9.0 * _ROOT2 / 8.0)
SECOND_LEFT = wp.constant(_ROOT2 / 8.0)

LEAST_PIVOT = wp.constant(1.0e-7)  # of a matrix with a diagonal near 1


@wp.struct
class ComplexVector:
    """re + i im."""

    re: wp.vec3
    im: wp.vec3


@wp.struct
class ComplexMatrix:
    """re + i im, both symmetric."""

    re: wp.mat33
    im: wp.mat33


@wp.func
def times(a: wp.vec2, b: wp.vec2) -> wp.vec2:
    """a b."""
    return wp.vec2(a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0])


@wp.func
def reciprocal(a: wp.vec2) -> wp.vec2:
    """1 / a."""
    q = quick_quotient(1.0, a[0] * a[0] + a[1] * a[1])
    return wp.vec2(a[0] * q, -a[1] * q)


@wp.func
def size_of(a: wp.vec2) -> float:
    """|re| + |im|, as near to the modulus as a scale needs."""
    return wp.abs(a[0]) + wp.abs(a[1])


@wp.func
def combined(first: float, second: float) -> wp.vec2:
    """w . (first, second)."""
    return wp.vec2(0.5 * second, FIRST_LEFT * first - SECOND_LEFT * second)


@wp.func
def combined_vectors(first: wp.vec3, second: wp.vec3) -> ComplexVector:
    """The same of vectors."""
    return ComplexVector(0.5 * second, FIRST_LEFT * first - SECOND_LEFT * second)


@wp.func
def first_part(z: wp.vec2) -> float:
    """2 Re(v_1 z), what the first stage gains; the second gains 2 Re(z)."""
    return 2.0 * (FIRST_RIGHT[0] * z[0] - FIRST_RIGHT[1] * z[1])


@wp.func
def first_part_of(z: ComplexVector) -> wp.vec3:
    """The same of a vector."""
    return 2.0 * (FIRST_RIGHT[0] * z.re - FIRST_RIGHT[1] * z.im)


@wp.func
def sum_of(a: ComplexVector, b: ComplexVector) -> ComplexVector:
    """a + b."""
    return ComplexVector(a.re + b.re, a.im + b.im)


@wp.func
def moved_along(a: ComplexVector, by: wp.vec2) -> ComplexVector:
    """A vector in the frame of an edge, with more along it."""
    return ComplexVector(a.re + wp.vec3(by[0], 0.0, 0.0), a.im + wp.vec3(by[1], 0.0, 0.0))


@wp.func
def scaled(factor: wp.vec2, a: ComplexVector) -> ComplexVector:
    """A complex number times a vector."""
    return ComplexVector(factor[0] * a.re - factor[1] * a.im, factor[0] * a.im + factor[1] * a.re)


@wp.func
def turned(r: wp.mat33, a: ComplexVector) -> ComplexVector:
    """R a."""
    return ComplexVector(r * a.re, r * a.im)


@wp.func
def applied(m: ComplexMatrix, a: ComplexVector) -> ComplexVector:
    """M a."""
    return ComplexVector(m.re * a.re - m.im * a.im, m.re * a.im + m.im * a.re)


@wp.func
def turn_matrix(y: ComplexMatrix, old: wp.mat33, new: wp.mat33) -> ComplexMatrix:
    """A symmetric matrix given in the frame `old`, in the frame `new`."""
    r = new * wp.transpose(old)
    back = wp.transpose(r)
    return ComplexMatrix(r * y.re * back, r * y.im * back)


@wp.func
def even(a: wp.vec2) -> ComplexMatrix:
    """a times the identity."""
    unit = wp.identity(n=3, dtype=float)
    return ComplexMatrix(a[0] * unit, a[1] * unit)


@wp.func
def _entry(m: ComplexMatrix, i: int, j: int, scale: float) -> wp.vec2:
    return scale * wp.vec2(m.re[i, j], m.im[i, j])


@wp.func
def _pivot(p: wp.vec2) -> wp.vec2:
    """A pivot that rounding has not brought to 0; of one that it has not, the real part is a third of it at least."""
    return wp.vec2(wp.max(p[0], LEAST_PIVOT), p[1])


@wp.func
def _scaled_inverse(
    d0: wp.vec2, d1: wp.vec2, d2: wp.vec2, a: wp.vec2, b: wp.vec2, c: wp.vec2, s: wp.vec3
) -> ComplexMatrix:
    """s M^-1 s for the symmetric M with diagonal d near 1 and entries a = M01, b = M02, c = M12, by LDL^T."""
    i0 = reciprocal(_pivot(d0))
    l1 = times(a, i0)
    l2 = times(b, i0)
    i1 = reciprocal(_pivot(d1 - times(a, l1)))
    rest = c - times(b, l1)
    l3 = times(rest, i1)
    i2 = reciprocal(_pivot(d2 - times(b, l2) - times(rest, l3)))
    e = times(l1, l3) - l2
    n12 = -times(l3, i2)
    n02 = times(e, i2)
    n11 = (i1 - times(l3, n12)) * (s[1] * s[1])
    n01 = (times(e, n12) - times(l1, i1)) * (s[0] * s[1])
    n00 = (i0 + times(times(l1, l1), i1) + times(e, n02)) * (s[0] * s[0])
    n22 = i2 * (s[2] * s[2])
    n12 *= s[1] * s[2]
    n02 *= s[0] * s[2]
    return ComplexMatrix(
        wp.mat33(n00[0], n01[0], n02[0], n01[0], n11[0], n12[0], n02[0], n12[0], n22[0]),
        wp.mat33(n00[1], n01[1], n02[1], n01[1], n11[1], n12[1], n02[1], n12[1], n22[1]),
    )


@wp.func
def admittance_of(y: ComplexMatrix, along: wp.vec2, g: float) -> ComplexMatrix:
    """(diag(along, 1/g, 1/g) + Y)^-1 [kg] in the edge's frame, finite for g = 0; along + Y00 must not be 0."""
    d0 = wp.vec2(along[0] + wp.max(y.re[0, 0], 0.0), along[1] + y.im[0, 0])
    d1 = wp.vec2(1.0 + g * wp.max(y.re[1, 1], 0.0), g * y.im[1, 1])
    d2 = wp.vec2(1.0 + g * wp.max(y.re[2, 2], 0.0), g * y.im[2, 2])
    i1 = quick_quotient(1.0, size_of(d1))
    i2 = quick_quotient(1.0, size_of(d2))
    s = wp.vec3(inverse_root(size_of(d0)), root(wp.max(g * i1, 1.0e-30)), root(wp.max(g * i2, 1.0e-30)))
    return _scaled_inverse(
        s[0] * s[0] * d0,
        i1 * d1,
        i2 * d2,
        _entry(y, 0, 1, s[0] * s[1]),
        _entry(y, 0, 2, s[0] * s[2]),
        _entry(y, 1, 2, s[1] * s[2]),
        s,
    )


@wp.func
def compliance_beside(mass: wp.vec2, a: ComplexMatrix) -> ComplexMatrix:
    """(m + A)^-1 [1/kg] of a particle of mass m behind an edge of admittance A."""
    d0 = mass + wp.vec2(a.re[0, 0], a.im[0, 0])
    d1 = mass + wp.vec2(a.re[1, 1], a.im[1, 1])
    d2 = mass + wp.vec2(a.re[2, 2], a.im[2, 2])
    s = wp.vec3(inverse_root(size_of(d0)), inverse_root(size_of(d1)), inverse_root(size_of(d2)))
    return _scaled_inverse(
        s[0] * s[0] * d0,
        s[1] * s[1] * d1,
        s[2] * s[2] * d2,
        _entry(a, 0, 1, s[0] * s[1]),
        _entry(a, 0, 2, s[0] * s[2]),
        _entry(a, 1, 2, s[1] * s[2]),
        s,
    )
