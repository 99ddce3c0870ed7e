"""Figures of the study, PNG and SVG."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402 (the backend must be chosen first: there may be no display)
import numpy as np  # noqa: E402

MARKERS = "osD^vP*X"


def draw_error(rows: list[dict], title: str, path: Path) -> None:
    """Error against time with the Pareto front and p95 whiskers, beside it error against substeps with fitted orders.

    Runs that blew up or missed by more than the motion itself are left out.
    """
    rows = [row for row in rows if np.isfinite(row["position"]) and row["relative"] < 1.0]
    figure, (left, right) = plt.subplots(1, 2, figsize=(13, 5.5), layout="constrained")
    methods = list(dict.fromkeys(row["method"] for row in rows))
    counts = sorted({row["iterations"] for row in rows})
    for m, method in enumerate(methods):
        for k, iterations in enumerate(counts):
            curve = [row for row in rows if row["method"] == method and row["iterations"] == iterations]
            if curve:
                style = {"color": f"C{m}", "marker": MARKERS[k % len(MARKERS)], "alpha": 1.0 - 0.6 * k / len(counts)}
                _draw_curve(left, right, curve, f"{method}, x{iterations}", style)
    front = sorted((row for row in rows if row["front"]), key=lambda row: row["ms"])
    times, errors = ([row[key] for row in front] for key in ("ms", "position"))
    left.step(times, errors, "k-", where="post", lw=0.8, label="front")
    left.set(xlabel="median time per 1/60 s frame [ms], whisker: p95", ylabel="RMS error of position [m]")
    right.set(xlabel="substeps per frame", ylabel="RMS error of position [m]")
    for axes in (left, right):
        axes.set(xscale="log", yscale="log")
        axes.grid(True, which="both", alpha=0.2)
        axes.legend(fontsize=7)
    figure.suptitle(title, fontsize=10)
    for suffix in (".png", ".svg"):
        figure.savefig(path.with_suffix(suffix), dpi=150)
    plt.close(figure)


def _draw_curve(left: plt.Axes, right: plt.Axes, curve: list[dict], label: str, style: dict) -> None:
    keys = ("ms", "ms_p95", "position", "substeps")
    ms, p95, error, substeps = (np.array([row[key] for row in curve]) for key in keys)
    whiskers = [np.zeros(len(ms)), np.maximum(p95 - ms, 0.0)]
    left.errorbar(ms, error, xerr=whiskers, lw=1.0, ms=4, elinewidth=0.5, label=label, **style)
    order = f", order {fitted_order(substeps, error):.2f}" if len(curve) > 2 else ""
    right.plot(substeps, error, lw=1.0, ms=4, label=label + order, **style)


def fitted_order(substeps: np.ndarray, error: np.ndarray) -> float:
    """The slope of the error over the last three step sizes, in logarithms."""
    return float(-np.polyfit(np.log(substeps[-3:]), np.log(error[-3:]), 1)[0])
