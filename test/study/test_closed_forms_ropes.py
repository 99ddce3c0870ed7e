# SPDX-License-Identifier: Apache-2.0
"""Ropes: continuum, discrete counterpart and numerical integration agree, at the expected order."""

import numpy as np
import pytest
from scipy.integrate import quad

from cloth_sim_ros.study.closed_forms import ropes

G = 9.81


def lumped(total, segments):
    masses = np.full(segments + 1, total / segments)
    masses[[0, -1]] *= 0.5
    return masses


def test_hanging_stretch_is_the_integral_of_the_tension():
    length, weight, load, ea = 2.0, 3.0, 5.0, 1e4
    for s in (0.3, 1.1, 2.0):
        integral = quad(lambda t: (weight * (length - t) + load) / ea, 0.0, s)[0]
        assert ropes.hanging_stretch(s, length, weight, load, ea) == pytest.approx(integral, rel=1e-12)


@pytest.mark.parametrize("segments", [1, 8, 32])
def test_lumped_chain_stretches_at_its_end_exactly_as_the_rope(segments):
    length, mass, load, ea = 1.5, 0.4, 2.0, 500.0
    masses = lumped(mass, segments)
    masses[-1] += load
    extensions = ropes.hanging_extensions(masses, np.full(segments, ea * segments / length), G)
    continuum = ropes.hanging_stretch(length, length, mass * G / length, load * G, ea)
    assert extensions.sum() == pytest.approx(continuum, rel=1e-12)


def test_catenary_has_its_length_span_and_slope():
    span, length = 1.0, 1.4
    c = ropes.catenary_parameter(span, length)
    points = ropes.catenary_points(span, length, 20001)
    assert np.linalg.norm(np.diff(points, axis=0), axis=1).sum() == pytest.approx(length, rel=1e-8)
    assert np.allclose(points[[0, -1]], [[0, 0], [span, 0]], atol=1e-12)
    assert points[:, 1].min() == pytest.approx(c * (1.0 - np.cosh(span / (2 * c))), rel=1e-7)


def test_rigid_chain_tends_to_the_catenary_at_second_order():
    span, length = 1.0, 1.4
    errors = []
    for segments in (16, 32, 64):
        chain = ropes.catenary_chain(span, np.full(segments, length / segments), lumped(0.3, segments), np.inf, G)
        smooth = ropes.catenary_points(span, length, segments + 1)
        errors.append(np.abs(chain - smooth).max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.1)
    assert np.log2(errors[1] / errors[2]) == pytest.approx(2.0, abs=0.1)
    assert errors[1] < 1e-3


def test_elastic_chain_balances_every_particle():
    segments, k = 12, 80.0
    rest, masses = np.full(segments, 0.1), lumped(0.5, segments)
    points = ropes.catenary_chain(1.0, rest, masses, k, G)
    edges = np.diff(points, axis=0)
    lengths = np.linalg.norm(edges, axis=1)
    pulls = (k * (lengths - rest) / lengths)[:, None] * edges
    net = np.diff(pulls, axis=0)
    net[:, 1] -= masses[1:-1] * G
    assert np.abs(net).max() < 1e-9


def test_hanging_beads_are_laguerre_and_tend_to_bessel():
    beads, length = 40, 1.0
    equal = ropes.equal_beads_frequencies(length / beads, G, beads)
    assert np.allclose(ropes.hanging_beads_modes(np.ones(beads), length / beads, G)[0], equal, rtol=1e-9)
    errors = []
    for count in (64, 128):
        beaded = ropes.hanging_beads_modes(lumped(1.0, count)[1:], length / count, G)[0][:3]
        errors.append(np.abs(beaded / ropes.hanging_chain_frequencies(length, G, 3) - 1.0).max())
    assert errors[0] < 5e-3 and np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.2)
    assert ropes.hanging_chain_frequencies(length, G, 3) / np.sqrt(G) * 2 == pytest.approx(
        [2.405, 5.520, 8.654], rel=1e-3
    )


def test_beaded_string_is_its_stiffness_matrix_and_tends_to_the_string():
    beads, tension, mass, link = 7, 20.0, 0.01, 0.1
    matrix = (2 * np.eye(beads) - np.eye(beads, k=1) - np.eye(beads, k=-1)) * tension / (mass * link)
    frequencies = [ropes.beaded_string_frequency(n, tension, mass, link, beads) for n in range(1, beads + 1)]
    assert np.allclose(np.sqrt(np.linalg.eigvalsh(matrix)), frequencies)
    fine = ropes.beaded_string_frequency(1, tension, mass / 1000, link / 1000, 8000 - 1) / (2 * np.pi)
    assert fine == pytest.approx(ropes.string_frequency(0.8, tension, mass / link), rel=1e-6)
