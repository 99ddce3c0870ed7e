# SPDX-License-Identifier: Apache-2.0
"""Bending: linear, heavy and discrete forms meet in their common limits."""

import numpy as np
import pytest

from cloth_sim_ros.study.closed_forms import bending


def lumped_loads(total, segments):
    loads = np.full(segments, total / segments)
    loads[-1] *= 0.5
    return loads


def test_cantilever_chain_tends_to_the_beam_at_second_order():
    length, ei, load, weight = 1.2, 0.5, 0.01, 0.02
    errors = []
    for n in (16, 32):
        a = length / n
        loads = lumped_loads(weight * length, n)
        loads[-1] += load
        tip = bending.cantilever_chain_tip(a * np.arange(1, n + 1), loads, a, ei)
        errors.append(abs(tip / bending.cantilever_tip(length, ei, load, weight) - 1.0))
    assert errors[0] < 0.01 and np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.2)


def test_heavy_elastica_starts_linear_and_ends_hanging():
    light = bending.heavy_elastica(1.0, 1.0, 1e-3)[-1]
    assert light[1] == pytest.approx(bending.cantilever_tip(1.0, 1.0, weight=1e-3), rel=1e-5)
    heavy = bending.heavy_elastica(1.0, 1e-3, 10.0)[-1]
    assert heavy[0] < 0.1 and heavy[1] > 0.9


def test_heavy_chain_tends_to_the_elastica_at_second_order():
    smooth = bending.heavy_elastica(1.0, 0.05, 1.0)[-1]
    errors = []
    for n in (20, 40):
        tip = bending.heavy_chain(1.0 / n, 0.05, lumped_loads(1.0, n))[-1]
        errors.append(np.linalg.norm(tip - smooth))
    assert errors[1] < 1e-3 and np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.2)


def test_buckling_chain_is_its_eigenvalue_and_tends_to_euler():
    n, ei, length = 9, 0.3, 1.1
    a = length / n
    # Deflections y of the inner joints: P y_j = (EI / a^2) (-y_j-1 + 2 y_j - y_j+1).
    matrix = (2 * np.eye(n - 1) - np.eye(n - 1, k=1) - np.eye(n - 1, k=-1)) * ei / a**2
    assert bending.euler_buckling_chain(a, ei, n) == pytest.approx(np.linalg.eigvalsh(matrix)[0], rel=1e-12)
    assert bending.euler_buckling_chain(length / 900, ei, 900) == pytest.approx(
        bending.euler_buckling(length, ei), rel=1e-5
    )
    assert bending.euler_buckling(length, ei, 2.0) == pytest.approx(bending.euler_buckling(length, ei) / 4)


def test_twist_thresholds():
    assert bending.michell_twist(2.0, 2.0) == pytest.approx(10.8828, rel=1e-5)
    assert bending.greenhill_moment(0.25, 4.0) == pytest.approx(2.0)
