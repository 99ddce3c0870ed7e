# SPDX-License-Identifier: Apache-2.0
"""Rolling charts of the last seconds of a few numbers."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np
import viser
from viser import uplot

from cloth_sim_ros.viewer.drawing import COLOURS

SPAN = 20.0  # [s] that a chart shows
PERIOD = 0.2  # [s] of the chart's own time between two redraws
_LINES: dict[str, Any] = {"ticks": {"show": False}, "grid": {"width": 1}}  # of an axis
_MOST = 2000  # samples that a chart keeps


class Curves:
    """One chart of the curves `labels`, over time [s] or another x that `add` gets.

    log: the range of a logarithmic axis; values outside of it are not drawn. span: length of the x axis that is kept.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        title: str,
        labels: Sequence[str],
        log: tuple[float, float] | None = None,
        span: float = SPAN,
        colours: Sequence[tuple[int, int, int]] = COLOURS,
    ):
        self.labels = tuple(labels)
        self._rows: deque[tuple[float, ...]] = deque(maxlen=_MOST)
        self._span, self._log, self._drawn = span, log, -np.inf
        self._chart = make_chart(gui, title, "s", labels, colours, log is not None)

    def add(self, x: float, values: Sequence[float]) -> None:
        """Add one sample: `values` in the order of the labels, NaN for a missing one. Redraw if it is time."""
        if self._rows and x < self._rows[-1][0]:
            self.clear()
        self._rows.append((x, *values))
        while self._rows[0][0] < x - self._span:
            self._rows.popleft()
        if x - self._drawn >= PERIOD * self._span / SPAN:
            self.draw()

    def draw(self) -> None:
        """Send all samples to the chart."""
        x, *curves = np.array(self._rows).T
        if self._log is not None:
            low, high = self._log
            curves = [np.where((curve >= low) & (curve <= high), curve, np.nan) for curve in curves]
        self._chart.data = (x, *map(_without_gaps, curves))
        self._drawn = x[-1]

    def clear(self) -> None:
        """Delete all samples."""
        self._rows.clear()
        self._drawn = -np.inf

    @property
    def data(self) -> tuple[np.ndarray, ...]:
        """Data of the chart: x, then each curve."""
        return self._chart.data


def make_chart(
    gui: viser.GuiApi,
    title: str,
    x: str,
    labels: Sequence[str],
    colours: Sequence[tuple[int, int, int]] = COLOURS,
    log: bool = False,
) -> viser.GuiUplotHandle:
    """Return a chart of the curves `labels` over `x`, without data.

    Args:
        gui: Where the chart goes.
        title: Its title.
        x: Label of the x axis.
        labels: Those of the curves.
        colours: Those of the curves, in turn.
        log: True for a logarithmic y axis.
    """
    lines = [
        uplot.Series(label=label, stroke="rgb({},{},{})".format(*colours[k % len(colours)]), width=2)
        for k, label in enumerate(labels)
    ]
    return gui.add_uplot(
        tuple(np.array([1.0]) for _ in range(len(labels) + 1)),
        (uplot.Series(label=x), *lines),
        title=title,
        scales={"x": uplot.Scale(time=False), **({"y": uplot.Scale(distr=3)} if log else {})},
        axes=(uplot.Axis(**_LINES), uplot.Axis(size=62, **_LINES)),  # room for 100,000
        legend=uplot.Legend(live=False),  # else it says "--" where no mouse is
        padding=(12.0, 24.0, 0.0, 0.0),  # above, as half of the topmost number is there
        height=170,
    )


def _without_gaps(curve: np.ndarray) -> np.ndarray:
    """Cut values that are not finite from a curve's end, and fill other gaps with the value before.

    With NaN, uPlot loses its axes.
    """
    known = np.flatnonzero(np.isfinite(curve))
    if not len(known):
        return curve[:0]
    newest = np.maximum(np.searchsorted(known, np.arange(known[-1] + 1), side="right") - 1, 0)
    return curve[known[newest]]
