# SPDX-License-Identifier: Apache-2.0
"""Scales of sliders from descriptors."""

import pytest
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor

from cloth_sim_ros.viewer.live.sliders import scale_of


def described(low: float, high: float) -> ParameterDescriptor:
    return ParameterDescriptor(floating_point_range=[FloatingPointRange(from_value=low, to_value=high)])


@pytest.mark.parametrize(
    ("low", "high", "values"),
    [
        (0.0, 1e6, (0.0, 1e-8, 1e-3, 0.25, 1e6)),
        (1e-6, 1.0, (1e-6, 1e-3, 1.0)),
        (0.0, 10.0, (0.0, 0.5, 10.0)),
        (-100.0, 100.0, (-100.0, 0.0, 2.5)),
        (1e-3, 1e4, (1e-3, 0.5, 1e4)),
    ],
)
def test_every_value_of_the_range_has_its_place_and_back(low, high, values):
    scale = scale_of(described(low, high), 0.5)
    left, right, _ = scale.ends
    for value in values:
        place = scale.place(value)
        assert left <= place <= right
        assert scale.value(place) == pytest.approx(value, rel=1e-2)
    assert scale.value(left) == low and scale.value(right) == high
    assert scale.place(2.0 * high) == right


def test_whole_numbers_stay_whole():
    scale = scale_of(ParameterDescriptor(integer_range=[IntegerRange(from_value=0, to_value=1000, step=1)]), 0)
    assert scale.ends == (0, 1000, 1) and scale.value(7) == 7


def test_without_a_range_there_is_no_scale():
    assert scale_of(ParameterDescriptor(), 1.0) is None
