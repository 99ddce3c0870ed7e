# SPDX-License-Identifier: Apache-2.0
"""Figures of the study, PNG and SVG."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from PIL import Image

MARKERS = "osD^vP*X"


def usable(row: dict) -> bool:
    """Return True if a run can be drawn: it did not blow up, and its error is below the motion itself."""
    return bool(np.isfinite(row["position"])) and row.get("relative", 0.0) < 1.0


def draw_error(
    rows: list[dict], title: str, path: Path, wanted: float | None = None, budget: float | None = None
) -> None:
    """Draw error against time with the Pareto front and p95 whiskers, and error against substeps with fitted orders.

    A colour stands for each method, a marker for each number of iterations, an open marker for methods in NumPy. Dotted
    lines are a wanted error [m] and a budget [ms].
    """
    figure = Figure(figsize=(13, 6.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    methods = list(dict.fromkeys(row["method"] for row in rows))
    counts = sorted({row["iterations"] for row in rows})
    shown = [row for row in rows if usable(row)]
    entries = []
    for m, method in enumerate(methods):
        colour = f"C{m % 10}"
        orders = []
        for k, iterations in enumerate(counts):
            curve = [row for row in shown if row["method"] == method and row["iterations"] == iterations]
            if curve:
                _draw_curve(left, right, curve, {"color": colour, "marker": MARKERS[k % len(MARKERS)]})
                orders += [_order(curve)] if len(curve) > 2 else []
        note = f", order {orders[-1]:.2f}" if orders else ("" if _any(shown, method) else ": no run in sight")
        entries.append(Line2D([], [], color=colour, label=method + note))
    for k, iterations in enumerate(counts):
        marker = {"color": "grey", "marker": MARKERS[k % len(MARKERS)], "ls": ""}
        entries.append(Line2D([], [], label=f"{iterations} iterations", **marker))
    _draw_front(left, [row for row in shown if row["front"]])
    entries.append(Line2D([], [], color="black", lw=0.8, label="front"))
    left.set(xlabel="median time per 1/60 s frame [ms], whisker: p95", ylabel="RMS error of position [m]")
    right.set(xlabel="substeps per frame", ylabel="RMS error of position [m]")
    if budget is not None:
        left.axvline(budget, color="black", ls=":", lw=0.9)
    for axes in (left, right):
        if wanted is not None:
            axes.axhline(wanted, color="black", ls=":", lw=0.9)
        if shown:  # nothing has no logarithm
            axes.set(xscale="log", yscale="log")
        axes.grid(True, which="both", alpha=0.2)
    figure.legend(handles=entries, fontsize=8, ncols=4, loc="outside lower center", frameon=False)
    figure.suptitle(title, fontsize=10)
    save_png(figure, path.with_suffix(".png"))
    figure.savefig(path.with_suffix(".svg"))


def save_png(figure: Figure, path: Path) -> None:
    """Save `figure` as a PNG of 256 colours, a third of the size that matplotlib writes."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=105)
    picture = Image.open(buffer).convert("RGB")
    picture.quantize(256, dither=Image.Dither.NONE).save(path, optimize=True)


def _any(rows: list[dict], method: str) -> bool:
    return any(row["method"] == method for row in rows)


def _draw_front(axes: Axes, front: list[dict]) -> None:
    front = sorted(front, key=lambda row: row["ms"])
    times, errors = ([row[key] for row in front] for key in ("ms", "position"))
    axes.step(times, errors, "k-", where="post", lw=0.8, zorder=5)


def _draw_curve(left: Axes, right: Axes, curve: list[dict], style: dict) -> None:
    keys = ("ms", "ms_p95", "position", "substeps")
    ms, p95, error, substeps = (np.array([row[key] for row in curve]) for key in keys)
    face = "white" if curve[0]["device"] == "numpy" else style["color"]
    style = {**style, "lw": 0.9, "ms": 4, "mfc": face, "alpha": 0.85}
    left.errorbar(ms, error, xerr=[np.zeros(len(ms)), np.maximum(p95 - ms, 0.0)], elinewidth=0.5, **style)
    right.plot(substeps, error, **style)


def _order(curve: list[dict]) -> float:
    return fitted_order(*(np.array([row[key] for row in curve]) for key in ("substeps", "position")))


def fitted_order(substeps: np.ndarray, error: np.ndarray) -> float:
    """Return the slope of the error over the last three step sizes, in logarithms."""
    return float(-np.polyfit(np.log(substeps[-3:]), np.log(error[-3:]), 1)[0])
