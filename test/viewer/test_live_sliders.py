# SPDX-License-Identifier: Apache-2.0
"""Sliders: their scales from descriptors, and numbers by powers of ten that are dragged and typed."""

import pytest
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor

from cloth_sim_ros.viewer.live.sliders import ParameterSlider, scale_of
from cloth_sim_ros.viewer.scale import Scale


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


@pytest.mark.parametrize(("low", "high"), [(0.0, 1e6), (0.0, 1e12), (1e-5, 10.0), (2.0, 400.0)])
def test_marks_lie_within_and_apart(low, high):
    scale = Scale(low, high, powers=True, floor=max(low, 1e-8))
    left, right, _ = scale.ends
    places = [place for place, _ in scale.marks]
    assert left <= places[0] and places[-1] <= right and 2 <= len(places) <= 7
    assert min(b - a for a, b in zip(places, places[1:], strict=False)) >= (right - left) / 8
    for place, word in scale.marks:
        assert float(word) == pytest.approx(scale.value(place))


@pytest.fixture
def told():
    """Sentences for the page."""
    return []


@pytest.fixture
def slider(server, told):
    """A compliance of 0.003 m/N, from 0 to 1e6."""
    scale, hint = scale_of(described(0.0, 1e6), 0.003), "How it yields [m/N] (live)"
    return ParameterSlider(server.gui, "stretch compliance", scale, 0.003, hint, told.append)


def looked_at(slider, times: int = 100) -> list[float]:
    """What is wanted within so many frames."""
    return [value for value in (slider.wanted() for _ in range(times)) if value is not None]


def test_a_number_by_powers_of_ten_is_shown_with_its_unit(slider):
    box = slider._slider._box
    assert box.label == "stretch compliance" and box.value == "0.003 m/N"
    slider.slide(0.05)
    assert looked_at(slider) == [pytest.approx(0.05, rel=1e-2)] and box.value == "0.05 m/N"
    slider.show(0.2)
    assert looked_at(slider) == [] and box.value == "0.2 m/N"
    slider.slide(0.0)
    assert looked_at(slider) == [0.0] and box.value == "0 m/N"


@pytest.mark.parametrize(
    ("text", "value", "then", "said"),
    [
        ("0.0123", 0.0123, "0.0123 m/N", []),
        (" 2e-4 m/N", 2e-4, "0.0002 m/N", []),
        ("1e9", 1e6, "1000000 m/N", ["1e+09 is typed; allowed is 0 to 1e+06, and 1e+06 is taken."]),
        ("-2", 0.0, "0 m/N", ["-2 is typed; allowed is 0 to 1e+06, and 0 is taken."]),
        ("12345", 12345.0, "12300 m/N", []),
        (".5", 0.5, "0.5 m/N", []),
    ],
)
def test_a_number_is_typed(slider, told, text, value, then, said):
    for end in range(1, len(text) + 1):
        slider._slider.type(text[:end])
        assert looked_at(slider, 5) == [], "while keys are pressed nothing is sent"
    assert looked_at(slider) == [value] and slider._slider._box.value == then
    assert told == said


@pytest.mark.parametrize(("typed", "taken"), [(20.0, 15.0), (-15.5, -15.0)])
def test_a_number_beyond_a_linear_slider_is_told_with_what_is_taken(server, told, typed, taken):
    slider = ParameterSlider(server.gui, "x", Scale(-15.0, 15.0), 0.0, "Wind [m/s]", told.append)
    slider._slider.value = typed  # a browser sends what is typed beside a slider as it is
    assert looked_at(slider) == [taken]
    assert told == [f"{typed:g} is typed; allowed is -15 to 15, and {taken:g} is taken."]


def test_what_is_no_number_is_put_back(slider):
    slider._slider.type("soft")
    assert looked_at(slider) == [] and slider._slider._box.value == "0.003 m/N"
