# SPDX-License-Identifier: Apache-2.0
"""Live numbers: checked, and written for the next frame."""

from __future__ import annotations

import dataclasses
import logging
from typing import Any

import numpy as np

from cloth_sim_ros import parameters as table
from cloth_sim_ros.sim.access.hands import Hands
from cloth_sim_ros.sim.access.live_values import COMPLIANCES, OF_FRAME
from cloth_sim_ros.sim.access.rope_queries import Ropes
from cloth_sim_ros.sim.arrays import writing
from cloth_sim_ros.sim.arrays.masses import MASSES
from cloth_sim_ros.sim.colliders import SPARE_SHAPES, number_of, shape_of
from cloth_sim_ros.sim.colliders.collider import Collider
from cloth_sim_ros.sim.engine.bodies import Bodies
from cloth_sim_ros.sim.input.checks import WorldSelection, check_worlds, named, names_of, worlds_of
from cloth_sim_ros.sim.input.numbers import places
from cloth_sim_ros.sim.scene.objects import FRICTION, Cloth, Rope, odd_friction, too_thick
from cloth_sim_ros.sim.substeps.choose import distinct
from cloth_sim_ros.sim.substeps.limits import check_explicit

_LOG = logging.getLogger(__name__)
_FAR_AWAY = 1e30  # negative reach [m] of a missing collider


class Live(Ropes, Hands):
    """Changes live parameters and colliders of a running simulation."""

    _rubbed: set[str]  # names of what has had a coefficient of friction set since `_tell_friction`
    _odd: set[str]  # names of what has more kinetic than static friction, as was told

    def set_collider_pose(
        self, name: str, position: Any, orientation: Any = (0.0, 0.0, 0.0, 1.0), sweep: bool = True, world: Any = None
    ) -> None:
        """Move a collider to a pose.

        Args:
            name: The collider.
            position: (3,) [m], or an array whose first axis is all worlds.
            orientation: Quaternion (4,) x y z w, or an array whose first axis is all worlds.
            sweep: If True, the collider sweeps to the pose and reaches it at the end of the next frame. If False, it is
                there at once, without a motion: for placing it, not for pushing.
            world: The number of a world, a mask (worlds,) of bool, or None for all.

        Raises:
            ValueError: There is no such collider, or the pose is not allowed.
        """
        row, some = named(self._bodies.collider_row, name, "collider"), self._bodies.some(world)
        self._bodies.colliders.reach(row, some, name, (position, orientation), sweep)

    def squeeze(self, name: str, load: float, gap: float, world: Any = None) -> None:
        """Let a collider and its opposite one press on what both touch, from the next frame on.

        Each point between them is pressed from both sides by `load`, beyond what its depth gives, until it leaves the
        space between them. Friction and wrenches have the load. Points that one of them touches alone have none.

        Args:
            name: One of two colliders that are each other's `opposite`.
            load: On each point [N]; 0 is none.
            gap: Distance between the two surfaces [m].
            world: The number of a world, a mask (worlds,) of bool, or None for all.

        Raises:
            ValueError: There is no such collider, or the load is not allowed.
        """
        bodies, some = self._bodies, self._bodies.some(world)
        load = table.check(table.row(table.GRIPPER, "force"), load, f"the load of {name}")
        collider = bodies.scene.colliders.get(name)
        if collider is None or not collider.opposite:
            pinching = [each for each, one in bodies.scene.colliders.items() if one.opposite]
            raise ValueError(f"{name!r} pinches nothing; allowed is one of {names_of(pinching)}")
        for each in (name, collider.opposite):
            bodies.colliders.write(bodies.collider_row[each], some, squeeze=load, half_gap=0.5 * gap)
        squeezes = (bodies.colliders.mirrors()["rows"]["squeeze"] > 0.0).any(axis=1)
        bodies.frame.write(0, None, squeezes=squeezes)

    def is_squeezing(self, name: str, world: int = 0) -> bool:
        """True if a collider and its opposite one squeezed anything in the last frame, see `squeeze`."""
        row, colliders = named(self._bodies.collider_row, name, "collider"), self._bodies.colliders.array.shape[1]
        world = self._bodies.one(world)
        rows = [batch.states["squeezed_in"].numpy()[world, row::colliders] for batch in self._bodies.batches]
        return any(found.any() for found in rows)

    def thinnest(self, world: int = 0) -> float:
        """Least thickness, or radius, of the objects [m]."""
        world, batches = self._bodies.one(world), self._bodies.batches
        return min(float(batch.materials.mirrors()["rows"]["thickness"][world].min()) for batch in batches)

    def add_collider(self, name: str, collider: Collider) -> None:
        """Add a collider of one of SPARE_SHAPES in all worlds, from the next frame on.

        It replaces an added collider of the same name. Raises ValueError if no spare collider is left.
        """
        bodies, named = self._bodies, self._bodies.scene
        if not isinstance(collider, Collider) or shape_of(collider) not in SPARE_SHAPES:
            raise ValueError(f"{name} is {collider!r}; allowed is a {', '.join(SPARE_SHAPES)}")
        if name in {*named.objects, *named.handles} or bodies.collider_row.get(name, bodies.fixed) < bodies.fixed:
            raise ValueError(f"{name} is added as a collider; allowed is a name that the scene has not given")
        free = sorted(set(range(bodies.fixed, bodies.colliders.array.shape[1])) - set(bodies.collider_row.values()))
        row = bodies.collider_row.get(name, free[0] if free else None)
        if row is None:
            raise ValueError(
                f"{name} is one collider too many; allowed are {named.spare_colliders} added ones, spare_colliders"
            )
        bodies.name_collider(name, row, collider)
        self._write_collider(row, collider)
        self._rubbed.add(name)

    def remove_collider(self, name: str) -> None:
        """Remove an added collider."""
        bodies = self._bodies
        added = [each for each, row in bodies.collider_row.items() if row >= bodies.fixed]
        if name not in added:
            raise ValueError(f"{name!r} is no collider that was added; allowed is {names_of(added)}")
        self._write_none(bodies.forget_collider(name))
        for names in (self._rubbed, self._odd):
            names.discard(name)

    def set_wind(self, velocity: Any, world: Any = None) -> None:
        """Set the wind velocity [m/s] from the next frame on."""
        self.set("wind.velocity", velocity, world)

    def set(self, name: str, value: Any, world: Any = None) -> None:
        """Set a live parameter.

        Setting a scale restarts the object with its rest shape scaled; all else stays as set, the total mass too. A
        sheet grows about its position, a rope from its start.

        Args:
            name: Such as "cloth.stretch_compliance", "cloth.mass", "cloth.scale", "ball.radius", "gravity" or
                "solver.substeps".
            value: One value, or an array whose first axis is all worlds.
            world: The number of a world, a mask (worlds,) of bool, or None for all. Solver settings take None only.

        Raises:
            ValueError: The name or value is not allowed; nothing changes then.
        """
        if not isinstance(name, str):
            raise ValueError(f"set is given the name {name!r}; allowed is text such as 'gravity' or 'cloth.mass'")
        owner, _, field = name.rpartition(".")
        world = self._bodies.some(world)
        if name == "gravity":
            self._set_frame(table.GRAVITY, name, value, world)
        elif owner == "solver":
            if world is not None:
                raise ValueError(f"{name} is set in world {world} alone; allowed is to set it in all of them")
            self._set_solver(_live(table.SOLVER, field, name), name, value)
        elif owner == "wind":
            if self._bodies.scene.wind is None:
                raise ValueError(f"{name} is set but the scene has no wind; allowed is a scene built with one")
            self._set_frame(_live(table.WIND, field, name), name, value, world)
        elif owner.endswith(".winch") and owner.removesuffix(".winch") in self._bodies.scene.objects:
            self._set_winch(owner.removesuffix(".winch"), _live(table.WINCH, field, name), name, value, world)
        elif owner in self._bodies.scene.handles:
            self._set_handle(owner, field, value, world)
        elif owner in self._bodies.scene.objects:
            self._set_material(owner, field, name, value, world)
        elif owner in self._bodies.scene.colliders:
            self._set_collider(owner, field, name, value, world)
        elif owner in self._bodies.scene.numbered:
            self._set_number(owner, field, name, value, world)
        else:
            scene = self._bodies.scene
            known = [*scene.objects, *scene.colliders, *scene.handles, *scene.numbered, "solver", "wind"]
            raise ValueError(f"there is no parameter {name!r}; allowed are 'gravity' and those of {names_of(known)}")

    def _checked(self, row: table.Parameter, value: Any, name: str, world: WorldSelection) -> Any:
        return check_worlds(row, value, name, self._bodies.worlds, world)

    def _set_frame(self, row: table.Parameter, name: str, value: Any, world: WorldSelection) -> None:
        value = self._checked(row, value, name, world)
        self._bodies.frame.write(0, world, **{OF_FRAME.get(row.name, row.name): value})

    def _set_collider(self, owner: str, field: str, name: str, value: Any, world: WorldSelection) -> None:
        collider, number = self._bodies.scene.colliders[owner], self._bodies.collider_row[owner]
        row = _live((*table.COLLIDER, *collider.dimensions), field, name)
        value, rows = self._checked(row, value, name, world), self._bodies.colliders
        if row not in collider.dimensions:
            rows.write(number, world, **{field: value})
            if field in FRICTION:
                self._rubbed.add(owner)
            return
        sizes = rows.read(number, world)["size"].astype(np.float64)
        sizes[:, places(collider.dimensions)[field]] = value
        rows.write(number, world, size=sizes, reach=collider.resized(sizes).reach())
        self._bodies.find_sharpest([owner])
        self._bodies.choose_again()

    def _set_number(self, owner: str, field: str, name: str, value: Any, world: WorldSelection) -> None:
        """Set a number of a force or constraint."""
        rows, live, number = self._bodies.scene.numbered[owner].rows, self._bodies.numbers, self._bodies.numbers_row
        value = self._checked(_live(rows, field, name), value, name, world)
        numbers = live.read(number[owner], world)["values"]
        numbers[:, places(rows)[field]] = value
        live.write(number[owner], world, values=numbers)

    def _set_solver(self, row: table.Parameter, name: str, value: Any) -> None:
        value = table.check(row, value, name)
        if row.name == "substeps" and self._bodies.settings.method == "verlet":
            for owner in self._bodies.scene.objects:
                self._check_explicit(owner, self._bodies.effective_materials(owner, None), substeps=value)
        self._bodies.change_setting(row.name, value)
        self._write_settings()
        self._bodies.choose_again()

    def _check_explicit(self, owner: str, rows: np.ndarray, **changed: Any) -> None:
        """Raise ValueError if explicit steps are unstable for an object with these rows of Material."""
        bodies = self._bodies
        settings = dataclasses.replace(bodies.settings, **changed)
        check_explicit(bodies.scene, settings, owner, bodies.elastic[owner], distinct(rows))

    def _set_material(self, owner: str, field: str, name: str, value: Any, world: WorldSelection) -> None:
        thing = self._bodies.scene.objects[owner]
        if field == "pins":
            self._set_pins(owner, value, world)
            return
        rows = table.CLOTH if isinstance(thing, Cloth) else (*table.ROPE, *table.TWIST)
        row = _live((*rows, table.SCALE), field, name)
        needed = "twist_compliance" if field == "end_turn" else field
        if needed in ("shear_compliance", "bend_compliance", "twist_compliance") and getattr(thing, needed) is None:
            raise ValueError(f"{name} is set but {owner} was built without; allowed is an object built with {needed}")
        if field == "shear_compliance" and self._bodies.topology(owner).coupling is not None:
            raise ValueError(f"{name} is set while {owner} runs; allowed is stretch_compliance, which scales both")
        value = self._checked(row, value, name, world)
        if field == "end_turn":
            self._bodies.batch[owner].ends.write(self._bodies.batch[owner].index[owner], world, turn=value)
            return
        if field in MASSES:
            self._set_mass(owner, field, value, world)
            return
        if field == "scale":
            _set_scale(self._bodies, owner, value, world)
            return
        materials = self._bodies.materials_of(owner, world)
        if field in COMPLIANCES:
            materials["compliance"][:, COMPLIANCES[field]] = value
            field = "compliance"
        else:
            field = "thickness" if field == "radius" else field
            if field == "thickness":
                _doubt(owner, thing, materials[field], value)
            materials[field] = value
        if field in ("compliance", "damping") and self._bodies.settings.method == "verlet":
            self._check_explicit(owner, self._bodies.effective_materials(owner, world, materials))
        batch = self._bodies.batch[owner]
        batch.materials.write(batch.index[owner], world, **{field: materials[field]})
        if field in ("compliance", "damping", "thickness"):
            self._bodies.choose_again()
        elif field in FRICTION:
            self._rubbed.add(owner)

    def _tell_friction(self) -> None:
        """Warn of what has more kinetic than static friction in some world, once until that is mended.

        Both may be set one after the other, so this waits until they act. Things of the same two are one warning.
        """
        found: dict[tuple[float, float], list[str]] = {}
        for name in sorted(self._rubbed):
            colliders, number = self._bodies.colliders, self._bodies.collider_row.get(name)
            rows = self._bodies.materials_of(name, None) if number is None else colliders.read(number, None)
            worst = rows[np.argmax(rows["kinetic_friction"] - rows["static_friction"])]
            static, kinetic = (worst[each] for each in FRICTION)
            if kinetic > static and name not in self._odd:
                found.setdefault((static, kinetic), []).append(name)
            (self._odd.add if kinetic > static else self._odd.discard)(name)
        self._rubbed.clear()
        for pair, (first, *others) in found.items():
            _LOG.warning(odd_friction(f"{first} and {len(others)} more" if others else first, *pair))

    def _set_mass(self, owner: str, field: str, value: Any, world: WorldSelection) -> None:
        """Set a mass; particles that are not pinned keep their velocities."""
        batch = self._bodies.batch[owner]
        kg = batch.masses.read(batch.index[owner], world)
        kg[:, MASSES[field]] = value
        if self._bodies.settings.method == "verlet":
            self._check_explicit(owner, self._bodies.effective_materials(owner, world, kg=kg))
        batch.write_masses(owner, kg, world)
        self._bodies.choose_again()

    def _set_pins(self, owner: str, value: Any, world: WorldSelection) -> None:
        """Change the pins: newly pinned particles stop where they are, and released ones move on from there."""
        if world is not None:
            raise ValueError(f"{owner}.pins is set in world {world} alone; allowed is to set it in all of them")
        thing = self._bodies.scene.objects[owner]
        try:
            thing = dataclasses.replace(thing, pins=value)
        except ValueError as error:
            raise ValueError(str(error).replace(f"{type(thing).__name__}.pins", f"{owner}.pins")) from None
        self._bodies.describe_again(owner, thing)

    # -- host mirrors of the device's structs --------------------------------------------------------------------

    def _write_settings(self) -> None:
        self._bodies.frame.write(0, None, global_damping=self._bodies.settings.global_damping)

    def _write_scene(self) -> None:
        self._bodies.frame.write(0, None, gravity=self._bodies.scene.gravity)
        if self._bodies.scene.wind is not None:
            for row in table.WIND:
                if row.live:
                    self._set_frame(row, f"wind.{row.name}", getattr(self._bodies.scene.wind, row.name), None)
        for name, thing in self._bodies.scene.objects.items():
            self._write_material(name, thing)
            if isinstance(thing, Rope):
                self._write_rope(name, thing)
        self._place_colliders()
        self._write_handles()

    def _write_material(self, name: str, thing: Cloth | Rope) -> None:
        batch = self._bodies.batch[name]
        batch.materials.write(
            batch.index[name],
            None,
            compliance=compliances_of(thing),
            damping=thing.damping,
            bend_damping=getattr(thing, "bend_damping", 0.0),
            thickness=thing.radius if isinstance(thing, Rope) else thing.thickness,
            static_friction=thing.static_friction,
            kinetic_friction=thing.kinetic_friction,
        )
        kg = np.array([thing.mass, getattr(thing, "end_mass", 0.0)])
        batch.masses.write(batch.index[name], None, kg)

    def _place_colliders(self) -> None:
        self._bodies.write_data()
        colliders = self._bodies.scene.colliders
        for row in range(len(colliders), self._bodies.colliders.array.shape[1]):
            self._write_none(row)
        for name, collider in colliders.items():
            self._write_collider(self._bodies.collider_row[name], collider)

    def _write_collider(self, row: int, collider: Collider) -> None:
        self._bodies.colliders.write(
            row,
            None,
            shape=number_of(shape_of(collider)),
            size=collider.size(),
            reach=collider.reach(),
            compliance=collider.compliance,
            static_friction=collider.static_friction,
            kinetic_friction=collider.kinetic_friction,
            opposite=1 + self._bodies.collider_row[collider.opposite] if collider.opposite else 0,
            squeeze=0.0,
        )
        self._bodies.colliders.place(row, None, collider.position, collider.orientation)

    def _write_none(self, row: int) -> None:
        """Mark a row as holding no collider."""
        self._bodies.colliders.write(row, None, shape=-1, reach=-_FAR_AWAY)
        self._bodies.colliders.place(row, None, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))


def _doubt(owner: str, thing: Cloth | Rope, before: np.ndarray, after: Any) -> None:
    """Warn of a thickness [m] that may be in millimetres, once however long a slider moves it."""
    was, now = (too_thick(owner, thing, float(np.max(each, initial=0.0))) for each in (before, after))
    if now and not was:
        _LOG.warning(now)


def _set_scale(bodies: Bodies, owner: str, value: Any, world: WorldSelection) -> None:
    """Set an object's scale to a checked value, or one per world, and restart it there.

    Raises ValueError if the object cannot be scaled, or if explicit steps would be unstable.
    """
    topology = bodies.elastic[owner]
    for what, is_so in (
        ("hangs on a winch", topology.winch is not None),
        ("tears", topology.tear_strain > 0.0),
        ("started inside of a collider and was moved out", owner in bodies.moves),
    ):
        if is_so:
            raise ValueError(f"{owner}.scale is set but {owner} {what}; allowed is a scene with another size of it")
    scales = np.broadcast_to(topology.scales_in(), bodies.worlds).copy()
    scales[worlds_of(world)] = value
    if bodies.settings.method == "verlet":
        scaled = topology.at(scales)
        rows = bodies.effective_materials(owner, None, topology=scaled)
        check_explicit(bodies.scene, bodies.settings, owner, scaled, distinct(rows))
    bodies.give_scales(owner, scales, world)
    batch, chosen = bodies.batch[owner], bodies.chosen(world)
    batch.write_positions(owner, batch.rest[owner], chosen)
    writing.clear(batch.states["velocities"], batch.span(owner), chosen)


def compliances_of(thing: Cloth | Rope) -> list[float]:
    """Structural, shear (in a rope: twist) and bending compliance, 0 for a kind that does not exist."""
    found = [0.0, 0.0, 0.0]
    for field, place in COMPLIANCES.items():
        found[place] += getattr(thing, field, None) or 0.0
    return found


def _live(group: tuple[table.Parameter, ...], field: str, name: str) -> table.Parameter:
    try:
        row = table.row(group, field)
    except KeyError:
        live = ", ".join(parameter.name for parameter in group if parameter.live)
        raise ValueError(f"there is no parameter {name!r}; allowed is one of {live}") from None
    if not row.live:
        raise ValueError(f"{name} is fixed when a Simulation is built; allowed is a new Simulation with another value")
    return row
