# SPDX-License-Identifier: Apache-2.0
"""Bending of a sheet of rigidity B: energy B/2 times the integral of |H - n kappa|^2 over its triangles.

H is the Hessian of the positions, constant on a triangle and linear in the positions, n the normal of the triangle,
n kappa the Hessian at rest. The square of H gives a force that is linear in the positions (Bergou et al. 2006, A
quadratic bending model for inextensible surfaces); see topology/plate.py. A triangle that is curved at rest has one
more term, given here.
"""

import warp as wp

# (omega h_e)^2 of the stiffest bending mode that XPBD takes. Beyond it, the sheet is computed as softer.
MOST_BENDING = 0.6


@wp.struct
class RestCurvature:
    """Effect of a curved rest shape on a triangle for B = 1: forces [1/m] along its unit normal.

    Particle j of the triangle's stencil feels `gradients[j] * normal`, its own three vertices also `pull[k] * normal`.
    """

    normal: wp.vec3
    pull: wp.vec3


@wp.func
def turn_of_normal(a: wp.vec3, b: wp.vec3, c: wp.vec3, to_a: wp.vec3, to_b: wp.vec3, to_c: wp.vec3) -> wp.vec3:
    """How the unit normal of triangle a, b, c [m] turns as its vertices move by to_a, to_b, to_c [m]: the derivative.

    It is -sum_k grad phi_k (n . dx_k), see `rest_curvature`. A triangle without an area has no normal.
    """
    cross = wp.cross(b - a, c - a)
    double = wp.length(cross)
    if double <= 1.0e-18:
        return wp.vec3(0.0)
    n = cross / double
    return wp.cross((c - b) * wp.dot(n, to_a) + (a - c) * wp.dot(n, to_b) + (b - a) * wp.dot(n, to_c), n) / double


@wp.func
def rest_curvature(a: wp.vec3, b: wp.vec3, c: wp.vec3, moment: wp.vec3) -> RestCurvature:
    """The term -n . s of the energy of triangle a, b, c [m], with s = `moment` = sum_j g_j x_j over its stencil.

    n turns by -sum_k grad phi_k (n . dx_k), with phi_k the linear function that is 1 at vertex k and 0 at the others.
    So vertex k feels -(grad phi_k . s) n. A triangle without an area has no normal and feels nothing.
    """
    result = RestCurvature()
    cross = wp.cross(b - a, c - a)
    double = wp.length(cross)
    if double > 1.0e-18:
        n = cross / double
        # grad phi of a vertex is n x (the edge opposite, run the way round) / twice the area.
        turned = wp.cross(moment, n) / double
        result.normal = n
        result.pull = -wp.vec3(wp.dot(turned, c - b), wp.dot(turned, a - c), wp.dot(turned, b - a))
    return result
