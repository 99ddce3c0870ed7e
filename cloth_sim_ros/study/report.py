# SPDX-License-Identifier: Apache-2.0
"""`report`: one HTML page that holds every figure and table that the other commands have left in a folder."""

from __future__ import annotations

import argparse
import base64
import json
from collections.abc import Callable, Iterator
from html import escape
from pathlib import Path

from cloth_sim_ros.study import error, feature_costs, pass_map, speed, stability
from cloth_sim_ros.study.hard.judge import Combination

CAPTIONS = {  # file name of a picture -> what it shows
    "curtain": "A gathered curtain, a ball pushed through it, and a breeze.",
    "topology": "Families of lines of a 5 x 5 grid: a line is solved as a whole, all lines of a family at once.",
    "mesh_lines": "Lines of a triangle mesh, which go on as straight as its edges do; late families hold short ones.",
    "oscillator": "One mass on one spring: what a step does to the amplitude, measured beside its formula.",
    "rope": "A dragged rope of 12 particles: PBD stretches it by its iterations, XPBD by its material.",
}

STYLE = """
body { max-width: 72rem; margin: 2rem auto; padding: 0 1rem; font: 16px/1.5 system-ui, sans-serif; color: #2c3440; }
img { max-width: 100%; } pre { overflow-x: auto; background: #f5f6f7; padding: .8rem; font-size: 12px; }
h2 { margin-top: 3rem; } nav a { margin-right: 1rem; } summary { cursor: pointer; color: #2e86ab; }
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command line of `python -m cloth_sim_ros.study report`."""
    parser.add_argument("--folder", type=Path, default=Path("study"), help="where the other commands wrote")
    parser.add_argument("--images", type=Path, default=Path("docs/images"), help="where the pictures are")


def run(arguments: argparse.Namespace) -> int:
    """Collect and write FOLDER/report.html."""
    sections = list(collect(arguments.folder, arguments.images))
    if not sections:
        raise ValueError(f"{arguments.folder} holds no results; run the commands error, tune or speed first")
    path = arguments.folder / "report.html"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(page(sections), encoding="utf-8")
    print(f"written: {path}, {len(sections)} sections, {path.stat().st_size / 1e6:.1f} MB")
    return 0


def collect(folder: Path, images: Path) -> Iterator[tuple[str, str]]:
    """(heading, HTML) of every result."""
    for pattern, (heading, body) in SECTIONS.items():
        for path in sorted(folder.glob(pattern)):
            stored = json.loads(path.read_text())
            yield heading(stored), _figure(path.with_suffix(".png")) + body(stored)
    for name, caption in CAPTIONS.items():
        if (images / f"{name}.png").exists():
            yield name.capitalize(), f"<p>{escape(caption)}</p>" + _figure(images / f"{name}.png")


def page(sections: list[tuple[str, str]]) -> str:
    """The whole page; nothing in it is loaded from elsewhere."""
    links = "".join(f'<a href="#{k}">{escape(heading)}</a> ' for k, (heading, _) in enumerate(sections))
    bodies = "".join(f'<h2 id="{k}">{escape(head)}</h2>\n{body}\n' for k, (head, body) in enumerate(sections))
    head = f'<meta charset="utf-8"><title>Speed against error</title><style>{STYLE}</style>'
    return f"<!doctype html><html lang='en'><head>{head}</head><body><h1>Speed against error</h1>{READING}" + (
        f"<nav>{links}</nav>{bodies}</body></html>"
    )


READING = """<p>Error is the RMS distance of all particles at all frames from the exact motion of the same springs (or,
where a scene was tuned, from its own converged run). A star marks the Pareto front: nothing else is both as fast and
nearer. Methods labelled NumPy are references for their error; their times are those of NumPy on one core.</p>"""


def _error_body(stored: dict) -> str:
    return _machine(stored) + _tables(stored["rows"])


def _tune_body(stored: dict) -> str:
    chosen, own = stored["chosen"], stored["own"]
    lines = [("the file's own settings", own), ("chosen", chosen)]
    words = "".join(f"<li>{name}: {escape(_words(row))}</li>" for name, row in lines if row)
    return f"<ul>{words}</ul><p>Converged to {stored['uncertainty']:.1e} m.</p>" + _tables(stored["rows"])


def _words(row: dict) -> str:
    steps = f"{row['substeps']} substeps x {row['iterations']} iterations"
    far = "not finite" if row["position"] is None else f"{row['position']:.2e} m"
    return f"{row['method']}, {steps}: {far}, {row['ms']:.3f} ms a frame"


def _speed_body(stored: dict) -> str:
    tables = [speed.table(stored["rows"])]
    tables += [speed.peer_table(stored["peers"])] if stored["peers"] else []
    tables += [feature_costs.table(stored["features"])] if stored["features"] else []
    return _machine(stored) + "".join(map(_pre, tables))


def _stability_body(stored: dict) -> str:
    failed = [row for row in stored["rows"] if row["outcome"] == "failed"]
    lines = "".join(f"<li>{escape(_what(row))}: {escape(row['why'])}</li>" for row in failed)
    return (
        _machine(stored) + _pre(stability.table(stored["rows"])) + (f"<p>Failed:</p><ul>{lines}</ul>" if lines else "")
    )


def _what(row: dict) -> str:
    return str(Combination(*(row[name] for name in ("case", "kind", "method", "options", "seed"))))


def _map_body(stored: dict) -> str:
    return _machine(stored) + _pre(pass_map.table(stored["cells"]))


def _machine(stored: dict) -> str:
    where = stored["machine"]
    return f"<p>{escape(where['name'])} ({where['device']}), Warp {where['warp']}, Python {where['python']}</p>"


def _tables(rows: list[dict]) -> str:
    """The front, and all rows behind a fold."""
    rows = [{key: float("inf") if value is None else value for key, value in row.items()} for row in rows]
    front = [row for row in rows if row["front"]]
    shown = _pre(error.table(front)) if front else ""
    shown += f"<p>Cheapest for an error of</p>{_pre(error.prices(rows))}"
    return f"{shown}<details><summary>all {len(rows)} runs</summary>{_pre(error.table(rows))}</details>"


def _pre(text: str) -> str:
    return f"<pre>{escape(text)}</pre>"


def _figure(path: Path) -> str:
    if not path.exists():
        return ""
    return f'<img alt="{path.stem}" src="data:image/png;base64,{base64.b64encode(path.read_bytes()).decode()}">'


Section = tuple[Callable[[dict], str], Callable[[dict], str]]
SECTIONS: dict[str, Section] = {  # files of a command -> (heading, body)
    "error_*.json": (lambda stored: f"{stored['title']}, {stored['machine']['device']}", _error_body),
    "tuned_*.json": (lambda stored: f"Tuned: {stored['title']}", _tune_body),
    "stability_*.json": (lambda stored: f"Hard cases, seed {stored['seed']}", _stability_body),
    "map_*.json": (lambda stored: f"What holds, {stored['machine']['device']}", _map_body),
    "speed*.json": (lambda stored: f"Speed, {stored['machine']['device']}", _speed_body),
}
