# SPDX-License-Identifier: Apache-2.0
"""Save a simulation's whole state to a file, and load it bit-identically.

The state lies in arrays: those of every batch, and the live numbers that all share. The file holds all of them by name,
including scratch arrays. The header holds the choices that determine the arrays and their sizes.
"""

from __future__ import annotations

import dataclasses
import hashlib
import os
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from cloth_sim_ros import parameters as table
from cloth_sim_ros.sim.access.saved_file import ALLOWED, SavedFile, finite, is_finite, path_of, reason, write_file
from cloth_sim_ros.sim.arrays.live_array import LiveArray
from cloth_sim_ros.sim.arrays.masses import Masses
from cloth_sim_ros.sim.colliders import SHAPES, shape_of
from cloth_sim_ros.sim.engine.bodies import Bodies
from cloth_sim_ros.sim.input.checks import check_worlds
from cloth_sim_ros.sim.scene.scene import kind_of
from cloth_sim_ros.sim.substeps.choose import Choice
from cloth_sim_ros.sim.substeps.speed import is_allowed

_LIVE_OF_OBJECTS = {row.name for row in (*table.CLOTH, *table.ROPE, *table.TWIST, *table.WINCH) if row.live}
_LIVE_OF_COLLIDERS = {"position", "orientation", "file", *(row.name for row in table.COLLIDER if row.live)}
_LIVE_SETTINGS = tuple(row.name for row in table.SOLVER if row.live)
_FIXED_SETTINGS = ("frame_dt", *(row.name for row in table.SOLVER if not row.live))
_TYPES = {"bool": (bool,), "int": (int,), "float": (int, float), "str": (str,)}  # field type -> JSON types
_MOST_SUBSTEPS = 100_000  # largest number of substeps per frame; a frame of more takes seconds
_MOST = {"iterations": table.row(table.SOLVER, "iterations").high}  # of a Choice


class Saving:
    """Saves and loads the state of `bodies`."""

    def __init__(self, bodies: Bodies) -> None:
        self._bodies = bodies

    def save(self, path: str | os.PathLike, frames: int, notes: Any) -> None:
        """Write the whole state, the number of frames so far and `notes`. Raises ValueError."""
        bodies = self._bodies
        spare = {name: row for name, row in bodies.collider_row.items() if row >= bodies.fixed}
        added = {name: (row, bodies.scene.colliders[name]) for name, row in spare.items()}
        header = {
            "frames": frames,
            "notes": notes,
            "structure": structure_of(bodies),
            "batches": _names(bodies),
            "settings": {name: getattr(bodies.settings, name) for name in _LIVE_SETTINGS},
            "speed": bodies.speed,
            "choices": {name: dataclasses.asdict(choice) for name, choice in bodies.as_chosen.items()},
            "scales": {name: rows.tolist() for name, rows in bodies.scales.items()},
            "pins": {name: thing.pins for name, thing in bodies.scene.objects.items()},
            "grasps": bodies.grasps,
            "wakes": bodies.wakes(),
            "bounds": any(batch.frame.limits.is_changed for batch in bodies.batches),
            "added": {name: (row, shape_of(each), vars(each)) for name, (row, each) in added.items()},
        }
        path, arrays = path_of(path), _on_host(self._arrays(bodies))
        for name, rows in arrays.items():
            if not is_finite(rows):
                if name.rpartition("/")[2] in ("positions", "position_lo", "velocities"):
                    raise ValueError(f"{path} cannot be written: {name} are not finite; allowed are states that are")
                arrays[name] = finite(rows)
        write_file(path, header, arrays)

    def load(self, path: str | os.PathLike) -> tuple[int, bool, Any]:
        """Restore the state from a file; return the number of frames, whether the next wakes bodies, and the notes.

        Raises ValueError; nothing changes then.
        """
        path = path_of(path)
        with SavedFile(path) as file:
            header = file.header
            try:
                self._check_structure(path, header["structure"])
                derived = self._derived(header)
                targets = self._arrays(derived)
                if header["batches"] != _names(derived):
                    raise ValueError("its objects are not computed as its header says")
                frames, notes, grasps = _whole(header["frames"]), header["notes"], self._grasps(header["grasps"])
                wakes, bounds = bool(header["wakes"]), bool(header["bounds"])
            except _AnotherScene:
                raise
            except Exception as error:  # odd entries can raise anything
                raise ValueError(f"{path} cannot be used: {reason(error)}; {ALLOWED}") from None
            arrays = file.arrays(_on_host(targets))
        _check_numbers(path, derived, arrays)
        self._bodies.adopt(derived)
        for batch in () if bounds else self._bodies.batches:  # else the next frame forgets what the budget paid
            batch.frame.limits.upload()
        for name, rows in targets.items():
            if isinstance(rows, wp.array):
                rows.assign(arrays[name])
            else:
                rows[...] = arrays[name]
        for rows in _live_arrays(self._bodies).values():
            rows.touch()
        self._bodies.find_sharpest(self._bodies.scene.colliders)
        self._bodies.write_data()  # addresses of another process mean nothing here
        self._bodies.grasps = grasps
        return frames, wakes, notes

    def _check_structure(self, path: Path, theirs: dict[str, str]) -> None:
        """Raise ValueError if a file is from a scene of another structure, or from another kind of device."""
        ours = structure_of(self._bodies)
        for name in (*ours, *theirs):
            if ours.get(name) != theirs.get(name):
                there, here = (words.get(name, "not there") for words in (theirs, ours))
                raise _AnotherScene(
                    f"{path} is of another scene: {name} is {there} in it and {here} here; allowed is a file of a "
                    f"scene of the same structure"
                )
        if list(ours) != list(theirs):
            raise _AnotherScene(
                f"{path} is of another scene: it has {', '.join(theirs)}; allowed are the same names in the order "
                f"{', '.join(ours)}"
            )

    def _derived(self, header: dict[str, Any]) -> Bodies:
        """The bodies as the header describes them, on the device, without their state."""
        bodies, objects = self._bodies, {}
        for name, thing in bodies.scene.objects.items():
            pins = header["pins"][name]
            pins = tuple(pins) if isinstance(pins, list) else pins
            objects[name] = thing if pins == thing.pins else dataclasses.replace(thing, pins=pins)
        colliders = dict(list(bodies.scene.colliders.items())[: bodies.fixed])
        rows = {name: bodies.collider_row[name] for name in colliders}
        scales = header["scales"]
        if {*scales} - {*objects}:
            raise ValueError(f"it has objects {table.shown(sorted({*scales} - {*objects}))}")
        spare = range(bodies.fixed, bodies.fixed + bodies.scene.spare_colliders)
        for name, (row, shape, fields) in header["added"].items():
            if row not in spare or row in rows.values():
                raise ValueError(f"its collider {name} has row {row!r}")
            rows[name], colliders[name] = row, SHAPES[shape](**fields)
        return bodies.derived(
            {name: _choice(header["choices"][name]) for name in objects},
            scene=dataclasses.replace(bodies.scene, objects=objects, colliders=colliders),
            settings=dataclasses.replace(bodies.settings, **header["settings"]),
            speed=_speed(header["speed"]),
            collider_row=rows,
            scales={
                name: check_worlds(table.SCALE, np.atleast_1d(each), f"{name}.scale", bodies.worlds, None)
                for name, each in scales.items()
            },
        )

    def _grasps(self, grasps: dict[str, str]) -> dict[str, str]:
        """Check that the object that each handle grasps exists. Raises ValueError."""
        if grasps.keys() != self._bodies.grasps.keys() or {*grasps.values()} - {"", *self._bodies.scene.objects}:
            raise ValueError(f"its handles grasp {table.shown(grasps)}")
        return grasps

    def _arrays(self, bodies: Bodies) -> dict[str, wp.array | np.ndarray]:
        """Name -> array of everything that varies: state on the device, live numbers on the host."""
        found = {"handles/counts": bodies.handle_counts, "handles/breaks": bodies.handle_breaks}
        for k, batch in enumerate(bodies.batches):
            found |= {f"batch{k}/{name}": rows for name, rows in batch.states.items()}
            if batch.measurement is not None:
                found[f"batch{k}/most"] = batch.measurement.most
        for name, live in _live_arrays(bodies).items():
            found |= {f"{name}/{part}": rows for part, rows in live.mirrors().items()}
        return {name: rows for name, rows in found.items() if rows.size}


class _AnotherScene(ValueError):
    """A file is intact, but from a scene of another structure."""


def _whole(number: Any) -> int:
    """A count from a header. Raises ValueError."""
    if type(number) is not int or not 0 <= number < 1 << 53:
        raise ValueError(f"its frames are {table.shown(number)}")
    return number


def _speed(number: Any) -> float:
    """The speed of a device from a header. Raises ValueError."""
    if not is_allowed(number):
        raise ValueError(f"its speed is {table.shown(number)}")
    return number


def _choice(fields: dict[str, Any]) -> Choice:
    """Build a Choice from the fields of a header. Raises ValueError if they are not valid."""
    choice = Choice(**fields)
    for field in dataclasses.fields(choice):
        value = getattr(choice, field.name)
        if type(value) not in _TYPES[field.type] or (
            field.type == "int" and not 1 <= value <= _MOST.get(field.name, _MOST_SUBSTEPS)
        ):
            raise ValueError(f"it has {field.name} {table.shown(value)}")
    if choice.method not in ("verlet", "xpbd") or choice.order > 2:
        raise ValueError(f"it has the method {table.shown(choice.words)}")
    return choice


def _check_numbers(path: Path, bodies: Bodies, arrays: dict[str, np.ndarray]) -> None:
    """Raise ValueError if an index or count in `arrays` is out of range for `bodies`, as kernels do not check them."""
    handles, colliders = len(bodies.scene.handles), len(bodies.colliders.mirrors()["rows"][0])
    ranges = [("frame/rows", field, 0, table.row(table.SOLVER, field).high) for field in ("substeps", "iterations")]
    ranges.append(("colliders/rows", "opposite", 0, colliders))
    for k, batch in enumerate(bodies.batches):
        segments = np.array(batch.counts) - 1
        ranges += [
            (f"batch{k}/{name}", *each)
            for name, *each in (
                ("grips", (..., 3), 0, handles),
                ("panels", ..., 0, sum(batch.counts) - 1),
                ("panel_parts", (..., 0), 0, len(segments) - 1),
                ("substeps", ..., 0, _MOST_SUBSTEPS),
                *((name, ..., 0, 0) for name in ("divisors", "factors")),  # as no frame is under way
                *((name, "index", 0, segments - 1) for name in ("winches", "good_winches")),
                *((name, by, -1, handles) for name in ("twists", "good_twists") for by in ("start_by", "end_by")),
            )
        ]
    for name, field, least, most in ranges:
        rows = arrays.get(name)
        if rows is not None and not ((rows[field] >= least) & (rows[field] <= most)).all():
            raise ValueError(f"{path} cannot be used: {name} has numbers that are out of range; {ALLOWED}")


def structure_of(bodies: Bodies) -> dict[str, str]:
    """Structure that arrays and kernels depend on and live changes keep: name -> text that differs if it differs.

    It follows from the descriptions alone, which are the same on every machine.
    """
    scene, settings = bodies.scene, bodies.settings
    found = {
        "device": "a CPU" if bodies.warp_device.is_cpu else "a GPU",
        "worlds": str(bodies.worlds),
        "wind": "there" if scene.wind is not None else "not there",
        "spare_colliders": str(scene.spare_colliders),
        "object_contact": str(scene.object_contact),
        **{f"solver.{name}": repr(getattr(settings, name)) for name in _FIXED_SETTINGS},
    }
    for name, thing in scene.objects.items():
        count = len(bodies.elastic[name].masses)
        found[f"object {name}"] = f"a {type(thing).__name__} of {count} particles ({_digest(thing, _LIVE_OF_OBJECTS)})"
    for name, collider in list(scene.colliders.items())[: bodies.fixed]:
        found[f"collider {name}"] = f"a {type(collider).__name__} ({_digest(collider, _LIVE_OF_COLLIDERS)})"
    found |= {f"handle {name}": "there" for name in scene.handles}
    found |= {f"force {name}": kind_of(force) for name, force in scene.forces.items()}
    for name, each in scene.constraints.items():
        found[f"constraint {name}"] = f"{kind_of(each)} of {each.object}, {each.between}"
    for name, seam in scene.seams.items():
        lines = (seam.first_particles, seam.second_particles, seam.points, seam.slides)
        found[f"seam {name}"] = f"{seam.first} to {seam.second}, {lines}"
    return found


def _digest(thing: Any, live: Collection[str]) -> str:
    """A short hash of a description's fields without its pins; `live` fields count only by being None or not."""
    found = hashlib.sha256()
    for field in dataclasses.fields(thing):
        value = getattr(thing, field.name)
        if field.name == "pins":
            continue
        if field.name in live:
            value = value is None
        elif isinstance(value, np.ndarray):
            found.update(np.ascontiguousarray(value).tobytes())
            value = (value.shape, value.dtype.str)
        elif dataclasses.is_dataclass(value):
            value = _digest(value, live)
        found.update(f"{field.name}={value!r};".encode())
    return found.hexdigest()[:8]


def _names(bodies: Bodies) -> list[list[str]]:
    """The objects in each batch."""
    return [list(batch.index) for batch in bodies.batches]


def _on_host(arrays: dict[str, wp.array | np.ndarray]) -> dict[str, np.ndarray]:
    """Convert arrays to NumPy; those on a GPU are copied."""
    return {name: rows.numpy() if isinstance(rows, wp.array) else rows for name, rows in arrays.items()}


def _live_arrays(bodies: Bodies) -> dict[str, LiveArray | Masses]:
    """Name -> live numbers, shared ones and those of each batch."""
    found = {"frame": bodies.frame, "colliders": bodies.colliders, "handles": bodies.handles, "numbers": bodies.numbers}
    for k, batch in enumerate(bodies.batches):
        each = {"materials": batch.materials, "drives": batch.drives, "ends": batch.ends}
        found |= {f"batch{k}/{name}": rows for name, rows in each.items()}
        found[f"batch{k}/masses"] = batch.masses
    return found
