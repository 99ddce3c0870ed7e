"""The direct solve along a chain of segments, seen as a ladder of masses and edges, from one end to the other.

One Newton step of implicit Euler (or BDF2) on a chain is block-tridiagonal with 3x3 blocks. Eliminating particle after
particle, in units of mass (forces times h_e^2), a particle answers a force f with the displacement q + Y f, where the
compliance Y gathers its mass and all that was eliminated before it. An edge between i and j has the compliance
C = diag(alpha, 1/g, 1/g) in its own frame: alpha / h_e^2 along the edge, and g = tension / length across it, the
geometric stiffness (dropped under compression, so that the tangent stays positive). Then

    Z = C + Y_i,    S_j = m_j + Z^-1,    Y_j = S_j^-1.

Only positive quantities are added, never subtracted, so single precision keeps its digits for compliance 0 and for
loads of 1e5 times the mass alike. Matrices stay in the frames of their edges, scaled to unit diagonals before
inversion, because their entries along and across an edge may differ by ten orders of magnitude.
"""

import warp as wp


@wp.func
def edge_frame(n: wp.vec3) -> wp.mat33:
    """An orthonormal frame with rows n and two tangents, continuous in n but at n = -z (Duff et al. 2017)."""
    sign = wp.where(n[2] < 0.0, -1.0, 1.0)
    a = -1.0 / (sign + n[2])
    b = n[0] * n[1] * a
    return wp.mat33(
        n[0], n[1], n[2],
        1.0 + sign * n[0] * n[0] * a, sign * b, -sign * n[0],
        b, sign + n[1] * n[1] * a, -n[1],
    )  # fmt: skip


@wp.func
def _unit_inverse(a: float, b: float, c: float, scale: wp.vec3) -> wp.mat33:
    """scale M^-1 scale for the symmetric M with unit diagonal and entries a = M01, b = M02, c = M12."""
    determinant = wp.max(1.0 + 2.0 * a * b * c - a * a - b * b - c * c, 1.0e-9)
    m01 = (b * c - a) * scale[0] * scale[1]
    m02 = (a * c - b) * scale[0] * scale[2]
    m12 = (a * b - c) * scale[1] * scale[2]
    return wp.mat33(
        (1.0 - c * c) * scale[0] * scale[0], m01, m02,
        m01, (1.0 - b * b) * scale[1] * scale[1], m12,
        m02, m12, (1.0 - a * a) * scale[2] * scale[2],
    ) / determinant  # fmt: skip


@wp.func
def series_admittance(y: wp.mat33, alpha: float, g: float) -> wp.mat33:
    """Z^-1 = (diag(alpha, 1/g, 1/g) + Y)^-1 [kg] in the edge's frame, finite for g = 0; alpha + Y00 must be above 0."""
    s = wp.vec3(1.0 / wp.sqrt(alpha + y[0, 0]), wp.sqrt(g / (1.0 + g * y[1, 1])), wp.sqrt(g / (1.0 + g * y[2, 2])))
    return _unit_inverse(s[0] * s[1] * y[0, 1], s[0] * s[2] * y[0, 2], s[1] * s[2] * y[1, 2], s)


@wp.func
def particle_compliance(w: float, admittance: wp.mat33) -> wp.mat33:
    """Y = (m + Z^-1)^-1 [1/kg] of a particle of inverse mass w behind an edge; 0 where it is pinned."""
    if w == 0.0:
        return wp.mat33(0.0)
    m = 1.0 / w
    a = wp.vec3(m + admittance[0, 0], m + admittance[1, 1], m + admittance[2, 2])
    s = wp.vec3(1.0 / wp.sqrt(a[0]), 1.0 / wp.sqrt(a[1]), 1.0 / wp.sqrt(a[2]))
    return _unit_inverse(
        s[0] * s[1] * admittance[0, 1], s[0] * s[2] * admittance[0, 2], s[1] * s[2] * admittance[1, 2], s
    )


@wp.func
def turn_frame(y: wp.mat33, old: wp.mat33, new: wp.mat33) -> wp.mat33:
    """A symmetric matrix given in the frame `old`, in the frame `new`; straight chains keep their small entries."""
    r = new * wp.transpose(old)
    return r * y * wp.transpose(r)
