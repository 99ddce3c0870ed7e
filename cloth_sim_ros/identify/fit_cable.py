# SPDX-License-Identifier: Apache-2.0
"""`python -m cloth_sim_ros.identify.fit_cable RECORDING... [--judge RECORDING...]`: a cable from markers on it."""

from __future__ import annotations

import argparse
import dataclasses
import math
import sys
from pathlib import Path

import numpy as np
import yaml

from cloth_sim_ros.identify.cable import Cable, guesses, mean_error
from cloth_sim_ros.identify.cable_bag import CableTopics
from cloth_sim_ros.identify.cable_candidates import NAME, CableCandidates
from cloth_sim_ros.identify.cable_shape import PLACES
from cloth_sim_ros.identify.fit import Estimate, identify
from cloth_sim_ros.identify.markers import Markers
from cloth_sim_ros.identify.terminal import Progress, exit_status
from cloth_sim_ros.status_line import show

_PARTS = 4  # parts of time, each a column of the table
_SHOWN = 4  # moments in the picture
_HELD_OUT = 5  # one run in so many is judged and not fitted, if no others are given


def main() -> int:
    """Parse the command line, fit, judge and write; return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m cloth_sim_ros.identify.fit_cable", description=__doc__)
    paths = {"type": Path, "nargs": "+", "metavar": "RECORDING"}
    parser.add_argument("recordings", help=".npz or .csv files of markers, or bags, see docs/how-to/cables.md", **paths)
    parser.add_argument("--judge", help="recordings to judge by; else one run in five is held out", **paths)
    add_options(parser)
    parser.add_argument("--output", type=Path, default=Path("cable.yaml"), help="YAML of the cable; .png beside")
    return exit_status(run, parser.parse_args())


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options for fitting a cable, and for reading bags."""
    topics = {"nargs": "+", "default": [], "metavar": "/TOPIC"}
    parser.add_argument("--markers", help="topics of a bag with markers, in their order along the cable", **topics)
    parser.add_argument("--wrench", help="topics of a bag with forces on the hand at the start, to be added", **topics)
    parser.add_argument("--frame", default="", help="of tf, with z up (that of the first markers)")
    parser.add_argument(
        "--begin", type=float, default=0.0, help="what is used of each recording [s], from its start (0)"
    )
    parser.add_argument("--end", type=float, default=math.inf, help="until when it is used [s] (its end)")
    parser.add_argument("--held", type=int, default=2, help="markers at each end that follow the recording (2)")
    parser.add_argument("--start", type=int, default=2, help="frames that give positions and velocities at first (2)")
    parser.add_argument("--density", type=float, default=0.1, help="mass of the cable over its length [kg/m] (0.1)")
    parser.add_argument("--radius", type=float, default=0.004, help="of the cable [m] (0.004)")
    parser.add_argument("--between", type=int, default=3, help="segments between two markers (3)")
    parser.add_argument(
        "--shape",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="find bends at rest, how clamps point, and markers beside the middle (yes)",
    )
    parser.add_argument("--worlds", type=int, default=16, help="candidates at a time (16)")
    parser.add_argument("--device", default="cpu", help="cpu or cuda:0 (cpu)")


def run(arguments: argparse.Namespace) -> dict[str, np.ndarray]:
    """Fit a cable to recordings, judge it by others, print, draw and write. Raises ValueError in one sentence.

    Return name -> errors (F, R, M, 3) [m] of the markers of the judged runs: "fitted", "hold" and "blend".
    """
    topics = CableTopics(arguments.markers, arguments.wrench, arguments.frame)
    span = arguments.begin, arguments.end
    fitted = Markers.read(arguments.recordings, topics, *span)
    judged = Markers.read(arguments.judge, topics, *span) if arguments.judge else None
    if judged is None:
        fitted, judged = fitted.split(_HELD_OUT)
    if fitted.forces is not None and judged.forces is None:
        raise ValueError("--judge has no forces and the others do; allowed are both with, or none")
    if judged.count != fitted.count:
        raise ValueError(f"--judge has {judged.count} markers and the others {fitted.count}; allowed are as many")
    cable = Cable(fitted.lengths(), arguments.held, arguments.between, arguments.density, arguments.radius)
    how = arguments.start, arguments.device
    candidates = CableCandidates(cable, fitted, arguments.worlds, *how, arguments.shape)
    candidates.told = Progress(candidates)
    _, found = identify(candidates)
    show("")
    if fitted.forces is None:
        judged = dataclasses.replace(judged, forces=None)
    judge = CableCandidates(candidates.cable, judged, 1, *how)
    cable = candidates.weighed(found.values)
    off = {"fitted": judge.off(found.units[None])[0][:, :, : judged.count], **guesses(judge.markers, arguments.start)}
    print(*sentences(cable, candidates, found), sep="\n")
    print(*table(off, len(fitted.runs), len(judged.runs)), sep="\n")
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    arguments.output.write_text(yaml_of(cable, found))
    picture = arguments.output.with_suffix(".png")
    draw(judge, off, picture)
    print(f"written: {arguments.output} and {picture}")
    return off


def sentences(cable: Cable, candidates: CableCandidates, found: Estimate) -> list[str]:
    """Return lines that say what was found, one for each number."""
    compliance, damping, drag, torsion = found.values[:4]
    rigidity = 1.0 / compliance
    low, high = 1.0 / found.high[0], 1.0 / found.low[0]
    said = [
        f"rigidity EI {rigidity:.4g} N m^2, with 95 % from {low:.4g} to {high:.4g}, for {cable.density:.4g} kg/m; "
        f"their ratio is {rigidity / cable.density:.4g} m^4/s^2"
        + (", and forces tell them apart" if candidates.has_forces else ", and only that is found"),
        f"damping of bending {damping:.3g} s, with 95 % from {found.low[1]:.3g} to {found.high[1]:.3g}",
        f"drag relative to momentum {drag:.3g} 1/s, with 95 % from {found.low[2]:.3g} to {found.high[2]:.3g}",
        f"torsional rigidity GJ {1.0 / torsion:.3g} N m^2, with 95 % from {1.0 / found.high[3]:.3g} to "
        f"{1.0 / found.low[3]:.3g}, where clamps do not turn about the cable; the end is turned by "
        f"{candidates.sought[-1].shown(found.values[-1]):.2g} rad",
    ]
    if cable.offsets is not None:
        bends, beside = (np.linalg.norm(each, axis=1) for each in (cable.bends, cable.offsets))
        said.append(
            f"curvature at rest up to {bends[:PLACES].max():.2g} 1/m; clamps up to {bends[PLACES:].max():.2g} rad off "
            f"the line of their markers; markers up to {1e3 * beside.max():.2g} mm beside the middle"
        )
    for each, unit in zip(candidates.sought, found.units, strict=True):
        if not 1e-3 < unit < 1.0 - 1e-3:
            said.append(f"{each.name} lies at the end of where it is looked for, {each.low:.3g} to {each.high:.3g}")
    return said


def table(off: dict[str, np.ndarray], fitted: int, judged: int) -> list[str]:
    """Return rows of mean errors [mm]: over all, in each part of time, and of the worst marker."""
    rows = [
        f"Mean error |x - x_ref| [mm] in {judged} runs that were not fitted ({fitted} were):",
        f"{'':8}{'all':>8}" + "".join(f"{f'{k + 1}/{_PARTS}':>8}" for k in range(_PARTS)) + f"{'worst marker':>14}",
    ]
    for name, each in off.items():
        parts = [mean_error(part) for part in np.array_split(each, _PARTS)]
        worst = max(mean_error(each[:, :, m]) for m in range(each.shape[2]))
        numbers = [mean_error(each), *parts]
        rows.append(f"{name:8}" + "".join(f"{1e3 * number:8.2f}" for number in numbers) + f"{1e3 * worst:14.2f}")
    return rows


def yaml_of(cable: Cable, found: Estimate) -> str:
    """Return the node's YAML of a scene with the cable, straight between two points."""
    compliance, damping, drag, torsion = (float(f"{value:.4g}") for value in found.values[:4])
    length = float(cable.places[-1])
    rope = cable.rope(compliance, damping, torsion)
    parameters = {
        "objects": [NAME],
        NAME: {
            "type": "rope",
            "start": [0.0, 0.0, 1.0],
            "end": [round(length, 4), 0.0, 1.0],
            "segments": int(cable.markers[-1]),
            "mass": round(cable.density * length, 5),
            "radius": cable.radius,
            "stretch_compliance": rope.stretch_compliance,
            "damping": rope.damping,
            "bend_compliance": compliance,
            "bend_damping": damping,
            "twist": True,
            "twist_compliance": torsion,
        },
        "solver": {"global_damping": drag},
    }
    return yaml.safe_dump({"/**": {"ros__parameters": parameters}}, sort_keys=False)


def draw(judge: CableCandidates, off: dict[str, np.ndarray], path: Path) -> None:
    """Draw a PNG: errors over time, errors by marker, and the first run at some moments, recorded and computed."""
    from matplotlib.figure import Figure  # not before `exit_status` has looked whether it is there

    figure = Figure(figsize=(15.0, 4.5), layout="constrained")
    over_time, by_marker, places = figure.subplots(1, 3)
    for name, each in off.items():
        seen = np.isfinite(each).any(axis=(1, 2, 3))
        over_time.plot(judge.times[seen], 1e3 * np.nanmean(np.abs(each[seen]), axis=(1, 2, 3)), label=name)
        by_marker.plot(1e3 * np.nanmean(np.abs(each), axis=(0, 1, 3)), ".-", label=name)
    over_time.set(xlabel="time [s]", ylabel="mean error [mm]")
    by_marker.set(xlabel="marker", ylabel="mean error [mm]")
    over_time.legend()
    later = judge.markers.runs[0][judge.first :]
    flat = np.nan_to_num(later[..., :2] - np.nanmean(later[..., :2], axis=(0, 1))).reshape(-1, 2)
    axis = np.linalg.svd(flat, full_matrices=False)[2][0]
    for k, frame in enumerate(np.linspace(0, len(judge.times) - 1, _SHOWN).astype(int)):
        computed = later[frame] + off["fitted"][frame, 0]
        places.plot(later[frame][:, :2] @ axis, later[frame][:, 2], "o", color=f"C{k}", mfc="none")
        places.plot(computed[:, :2] @ axis, computed[:, 2], "-", color=f"C{k}", label=f"{judge.times[frame]:.2f} s")
    places.set(xlabel="along the motion [m]", ylabel="z [m]", aspect="equal", title="recorded: circles")
    places.legend()
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    sys.exit(main())
