# SPDX-License-Identifier: Apache-2.0
"""Charts that roll: the last seconds of a few numbers."""

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
_MOST = 2000  # samples that a chart keeps


class Curves:
    """One chart of the curves `labels`, over time [s] or whatever `add` is given.

    log: a logarithmic axis, where what is not above 0 is left out. span: how much of the x axis is kept.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        title: str,
        labels: Sequence[str],
        log: bool = False,
        span: float = SPAN,
        colours: Sequence[tuple[int, int, int]] = COLOURS,
    ):
        self.labels = tuple(labels)
        self._rows: deque[tuple[float, ...]] = deque(maxlen=_MOST)
        self._span, self._log, self._drawn = span, log, -np.inf
        lines = [
            uplot.Series(label=label, stroke="rgb({},{},{})".format(*colours[k % len(colours)]), width=2)
            for k, label in enumerate(labels)
        ]
        scales: dict[str, Any] = {"x": uplot.Scale(time=False)}
        if log:
            scales["y"] = uplot.Scale(distr=3)
        self._chart = gui.add_uplot(
            tuple(np.array([0.0]) for _ in range(len(labels) + 1)),
            (uplot.Series(label="s"), *lines),
            title=title,
            scales=scales,
            height=170,
        )

    def add(self, x: float, values: Sequence[float]) -> None:
        """One sample: `values` in the order of the labels, nan where there is none. Draws now and then."""
        if self._rows and x < self._rows[-1][0]:
            self.clear()
        self._rows.append((x, *values))
        while self._rows[0][0] < x - self._span:
            self._rows.popleft()
        if x - self._drawn >= PERIOD * self._span / SPAN:
            self.draw()

    def draw(self) -> None:
        """Sends what there is."""
        columns = np.array(self._rows).T
        if self._log:
            columns[1:][~(columns[1:] > 0.0)] = np.nan
        self._chart.data = tuple(columns)
        self._drawn = columns[0, -1]

    def clear(self) -> None:
        """Forgets all samples."""
        self._rows.clear()
        self._drawn = -np.inf

    @property
    def data(self) -> tuple[np.ndarray, ...]:
        """What is drawn: x, then each curve."""
        return self._chart.data
