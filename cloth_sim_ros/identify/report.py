# SPDX-License-Identifier: Apache-2.0
"""Report of an estimate, in sentences and as a picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cloth_sim_ros.identify.candidates import Candidates, Delay
from cloth_sim_ros.identify.fit import Estimate

_WIDE = 2.0  # a value that may be twice or half of what fits best is not known
_ALIKE = 0.95  # correlation of errors beyond which only a ratio or product of two values is known
_MATTERS = 1.05  # an interval that is narrower needs no such words
_RISES = 3.0  # ratio of the misfit at the end to that at the beginning, beyond which it is not noise
_SMALL = 1e-3  # misfit over the size of what was seen, below which nobody needs that warning
_SHOWN = 25  # places along the range of a number, in the picture


def sentences(candidates: Candidates, found: Estimate) -> list[str]:
    """Return a sentence for each value, on what the recording cannot tell, and on the remaining misfit."""
    sought, said = candidates.sought, []
    for k, each in enumerate(sought):
        value, low, high = found.values[k], found.low[k], found.high[k]
        if isinstance(each, Delay):
            said.append(_delay(each, value, low, high))
        elif found.felt[k] == 0.0:
            said.append(f"The recording cannot tell {each.name}, as nothing feels it: it stays as the scene has it.")
        elif high > _WIDE * value:
            said.append(
                f"The recording cannot tell {each.name}, {value:.3g} fits best: where it doubles, the motion changes "
                f"by {found.felt[k]:.2g} m RMS, and the recording is {found.noise:.2g} m RMS off."
            )
        else:
            said.append(f"{each.name} is {value:.4g}, with 95 % from {low:.4g} to {high:.4g}.")
        if not 1e-3 < found.units[k] < 1.0 - 1e-3:
            option = "--delay " if isinstance(each, Delay) else f"--fit {each.name}="
            said.append(
                f"{each.name} lies at the end of where it was looked for, {each.shown(each.low):.3g} to "
                f"{each.shown(each.high):.3g}: allowed is a wider range, {option}LOW:HIGH."
            )
    factors = found.high / found.values
    for a in range(len(sought)):
        for b in range(a):
            if abs(found.alike[a, b]) > _ALIKE and min(factors[a], factors[b]) > _MATTERS:
                if isinstance(sought[a], Delay):
                    said.append(f"The recording hardly tells {sought[b].name} and the delay apart.")
                    continue
                what = "ratio" if found.alike[a, b] > 0 else "product"
                said.append(
                    f"The recording tells the {what} of {sought[b].name} and {sought[a].name} better than each of them."
                )
    said.append(f"The motion with these numbers is {found.noise:.2g} m RMS off the recording.")
    if found.rise > _RISES and found.noise > _SMALL * candidates.recording.size:
        said.append(
            f"That is {found.rise:.2g} times more at its end than at its beginning, so it is not noise. The scene "
            "differs from what was recorded, or it buckles in another way: the numbers may be further off than their "
            "intervals say."
        )
    return said


def _delay(each: Delay, value: float, low: float, high: float) -> str:
    if high * each.low > low * each.high:
        return f"The recording cannot tell the delay, {each.shown(value):.3g} s fits best."
    low, high = each.shown(low), each.shown(high)
    return f"What was seen is late by {each.shown(value):.4g} s, with 95 % from {low:.4g} to {high:.4g} s."


def draw(candidates: Candidates, start: np.ndarray, found: Estimate, path: Path) -> None:
    """Draw a PNG: the misfit over time before and after the fit, and around each value with its interval."""
    count = len(candidates.sought)
    from matplotlib.figure import Figure  # not before `exit_status` has looked whether it is there

    figure = Figure(figsize=(5.5 * (1 + count), 4.5), layout="constrained")
    left, *others = figure.subplots(1, 1 + count, squeeze=False)[0]
    for label, units in (("first guess", start), ("best", found.units)):
        rows = np.concatenate(candidates.by_frame(candidates.residuals(units[None])[0]), axis=1)
        left.plot(candidates.recording.times, np.sqrt((rows**2).mean(axis=1)), label=label)
    left.set(xlabel="time [s]", ylabel="off the recording, RMS [m]", yscale="log")
    left.legend()
    for k, (axes, each) in enumerate(zip(others, candidates.sought, strict=True)):
        units = np.tile(found.units, (_SHOWN, 1))
        units[:, k] = np.linspace(0.0, 1.0, len(units))
        squares = candidates.squares(units)[:, -1]
        values = each.shown(candidates.values(units)[:, k])
        low, high = each.shown(max(found.low[k], each.low)), each.shown(min(found.high[k], each.high))
        axes.plot(values, np.sqrt(squares / candidates.count), ".-")
        axes.axvspan(low, high, alpha=0.3, label="95 %")
        axes.axvline(each.shown(found.values[k]), color="black", lw=0.8)
        scale = {"xlabel": "delay [s]"} if isinstance(each, Delay) else {"xlabel": each.name, "xscale": "log"}
        axes.set(yscale="log", ylabel="off the recording, RMS [m]", **scale)
        axes.legend()
    figure.savefig(path, dpi=110)
