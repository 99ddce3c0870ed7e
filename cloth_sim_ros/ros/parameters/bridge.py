# SPDX-License-Identifier: Apache-2.0
"""The parameter table as ROS parameters: declared, coerced, checked, and passed on when they change.

All rows are declared with dynamic typing, so that this bridge and not the middleware decides on types. The bridge knows
the row and can say in one sentence what is allowed. A value keeps the type of its row all the same.
"""

from __future__ import annotations

import array
import difflib
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any

import yaml
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter

from cloth_sim_ros import parameters as table
from cloth_sim_ros.parameters import Parameter
from cloth_sim_ros.ros.parameters import names
from cloth_sim_ros.ros.parameters.feasibility import broken_meshes, check_solver
from cloth_sim_ros.ros.parameters.plan import make_plan, material_values
from cloth_sim_ros.ros.parameters.plugins import load_plugins
from cloth_sim_ros.sim.scene.objects import FRICTION, odd_friction, too_thick

_RCLPY_OWN = ("use_sim_time", "start_type_description_service", "qos_overrides")

Change = Callable[[str, Parameter, Any], None]  # full name, its row, the checked value


class ParameterBridge:
    """Declares every parameter of the scene that the start-up values describe; `values` holds the checked ones.

    `values` is replaced, never written to, so another thread may keep the one it read.
    """

    def __init__(self, node: Node, on_change: Change):
        self._node = node
        self._on_change = on_change
        self._log = node.get_logger()
        # rclpy offers the values from YAML files and the command line only by declaring each of them. It fails at the
        # first of a wrong type or an empty list. Its own store of them is the only way to look before declaring. Later
        # also holds what clients have set: a material leaves all that alone.
        self._given = {name: parameter.value for name, parameter in node._parameter_overrides.items()}
        self.rows: dict[str, Parameter] = {}
        self.values: dict[str, Any] = {}
        self._restoring = self._declaring = False
        self._followed: set[str] = set()  # parameters that the last change sets through a material
        self._refused: dict[str, str] = {}  # start-up value -> what is wrong with it
        self._declare_all()
        self._warn_bare()
        self._warn_unknown()
        self._warn_idle()
        node.add_pre_set_parameters_callback(self._coerce)
        node.add_on_set_parameters_callback(self._refuse_or_accept)
        node.add_post_set_parameters_callback(self._hand_on)

    # -- start-up ------------------------------------------------------------------------------------------------

    def _declare_all(self) -> None:
        self._declare(names.fixed_rows())
        for sentence in load_plugins(self.values["plugins"]):
            self._log.error(sentence)
        taken = {*names.fixed_rows(), *names.GROUPS}
        for what in names.NAMED:
            good, complaints = names.usable(self.values[what], taken, what)
            self.values[what] = tuple(good)
            for sentence in complaints:
                self._log.error(sentence)
        self._declare(names.type_rows(self.values))
        rows = names.scene_rows(self.values)
        self._declare({name: row for name, row in rows.items() if name not in self.rows})

    def _declare(self, rows: dict[str, Parameter]) -> None:
        for name, row in rows.items():
            self.rows[name] = row
            self.values[name] = self._start_value(name, row)
        if any(row.name == "material" for row in rows.values()):
            self.values |= material_values(self.values, self._given)
        for name, row in rows.items():
            # What a material makes of an object's size may be beyond its range; the plan then leaves the object out.
            value = ros_value(row, bounded(row, self.values[name]))
            if name in self._refused:
                usual = self.values[name] == _default(row, name, self.values)
                source = "the default" if usual else "that of the material,"
                self._log.error(f"{self._refused[name]}; using {source} {value!r}")
            self._node.declare_parameter(name, value, descriptor(row, name), ignore_override=True)

    # -- objects that come and go --------------------------------------------------------------------------------

    def checked_object(self, name: str, given: Mapping[str, Any]) -> dict[str, Any]:
        """Return full name -> value of all parameters of one more object; `given` has some by full name.

        Raises ValueError in one sentence if the object is not allowed. May take seconds, in any thread.
        """
        (kind,) = names.type_rows({"objects": (name,)}).items()
        rows = names.prefixed(name, names.object_rows(coerced(kind[1], given.get(kind[0], ""), kind[0])))
        values = {**self.values, **filled(rows, given), "objects": (*self.values["objects"], name)}
        values |= material_values(values, {**self._given, **given})
        plan = make_plan(values)
        problem = {**plan.problems, **broken_meshes(plan, [name])}.get(name)
        if problem:
            raise ValueError(problem)
        check_solver(plan)
        return {each: values[each] for each in rows}

    def add_object(self, name: str, values: Mapping[str, Any], given: Mapping[str, Any]) -> None:
        """Declare the parameters of one more object with the `values` that `checked_object` made of `given`.

        The simulation is not told. The parameter `objects` keeps the names that the node has started with.
        """
        rows = names.prefixed(name, names.object_rows(values[f"{name}.type"]))
        self.rows |= rows
        self._given |= {each: values[each] for each in given}
        self.values = {**self.values, **values, "objects": (*self.values["objects"], name)}
        self._declaring = True
        try:
            for each, row in rows.items():
                about = descriptor(row, each)
                about.read_only = False  # the middleware would keep such a parameter for ever
                self._node.declare_parameter(each, ros_value(row, values[each]), about, ignore_override=True)
        finally:
            self._declaring = False

    def remove_objects(self, gone: Collection[str]) -> None:
        """Remove the parameters of objects that add_object has added. The simulation is not told."""
        left = tuple(name for name in self.values["objects"] if name not in gone)
        lost = {each for each in self.rows if each.partition(".")[0] in gone}
        self.values = {name: value for name, value in self.values.items() if name not in lost} | {"objects": left}
        for each in lost:
            del self.rows[each]
            self._given.pop(each, None)
            self._node.undeclare_parameter(each)

    def _start_value(self, name: str, row: Parameter) -> Any:
        """Return the value given for `name`, or the default if none is given or it is wrong.

        A wrong type or shape is kept: no default replaces it, and the plan leaves out the object or collider that has
        it.
        """
        default = _default(row, name, self.values)
        if name not in self._given:
            return default
        given = self._given[name]
        if given is None and (row.kind.endswith("_array") or row.kind == "pins"):
            given = ()  # how the middleware passes on an empty list
        try:
            return coerced(row, given, name)
        except ValueError as error:
            if row.name in ("type", "shape") and isinstance(given, str):
                return given
            self._refused[name] = str(error)
            del self._given[name]
            return default

    def _warn_bare(self) -> None:
        """Warn of names that a file lists but says nothing else of, as a misspelt section does."""
        # Of all that was given, as values that are refused describe a thing, too.
        described = {name.partition(".")[0] for name in self._node._parameter_overrides if "." in name}
        for what in names.NAMED:
            for name in self.values[what]:
                if name in described:
                    continue
                close = _closest(name, described - {*names.GROUPS, *self.values[what]})
                hint = f"; did you mean {close}?" if close else ""
                self._log.warning(f"{what} holds {name!r}, but no parameter is set for it, so all have defaults{hint}")

    def _warn_idle(self) -> None:
        """Warn of given values without an effect, unless another given value switches them off."""
        for name in filter(self.rows.__contains__, self._given):
            why, value = names.idle(name, self.values), self.values[name]
            is_off = self._given.keys() & (set(why.split()) - {name})
            if why and not is_off and value and value != _default(self.rows[name], name, self.values):
                self._log.warning(why)

    def _warn_unknown(self) -> None:
        kinds = {f"{name}.type" for name in self.values["objects"]} & self.rows.keys()
        odd = tuple(kind[:-4] for kind in kinds if self.values[kind] not in self.rows[kind].choices)
        for name in self._given:
            if name not in self.rows and not name.startswith((*_RCLPY_OWN, *odd)):
                close = _closest(name, self.rows)
                acts = f", and {close} is {ros_value(self.rows[close], self.values[close])!r}" if close else ""
                self._log.warning(f"{_unknown(name, self.rows)} Its value is ignored{acts}.")

    # -- changes -------------------------------------------------------------------------------------------------
    # An exception in one of these callbacks would end the node's spinning and leave the client without an answer.

    def decide(self, parameters: list[RosParameter]) -> None:
        """Raise ValueError in one sentence if `parameters` cannot be set. May take seconds, in any thread."""
        if any(parameter.name in self.rows and self.rows[parameter.name].fixed for parameter in parameters):
            return  # the middleware refuses them
        if any(each.name == "use_sim_time" and each.value is True for each in parameters):
            if self.values["publish_clock"]:
                raise ValueError("use_sim_time is True with publish_clock; a node cannot follow its own clock")
        every = self._coerced(parameters)
        every += self._following(every)
        plan = make_plan(self._proposed(every))
        owners = {parameter.name.partition(".")[0] for parameter in every}
        for sentence in broken_meshes(plan, owners).values():
            raise ValueError(sentence)
        if owners & {"solver", "device", "rate", "wind", *self.values["objects"]}:
            check_solver(plan)

    def remark(self, parameters: list[RosParameter]) -> str:
        """Return which of `parameters`, now set, have no effect or are probably mistakes; "" if none."""
        objects, said = make_plan(self.values).scene.objects, []
        for name in (parameter.name for parameter in parameters):
            said.append(names.idle(name, self.values))
            owner, _, field = name.rpartition(".")
            if owner in objects and field in ("thickness", "radius"):
                said.append(too_thick(owner, objects[owner], self.values[name]))
            if field in FRICTION:
                said.append(odd_friction(owner, *(self.values[f"{owner}.{each}"] for each in FRICTION)))
        return "; ".join(dict.fromkeys(filter(None, said)))

    def _coerce(self, parameters: list[RosParameter]) -> list[RosParameter]:
        result = self._coerced(parameters)
        following = [] if self._restoring else self._following(result)
        self._followed = {parameter.name for parameter in following}
        return result + following

    def _coerced(self, parameters: list[RosParameter]) -> list[RosParameter]:
        result = []
        for parameter in parameters:
            row = self.rows.get(parameter.name)
            try:
                if row is not None and parameter.value is not None:
                    value = ros_value(row, coerced(row, parameter.value, parameter.name))
                    parameter = RosParameter(parameter.name, value=value)
            except (ValueError, TypeError):
                pass  # refused with the reason in the next callback
            result.append(parameter)
        return result

    def _following(self, parameters: list[RosParameter]) -> list[RosParameter]:
        """Return the other parameters that change with `parameters`: values of a material that nobody has set."""
        known = [parameter for parameter in parameters if parameter.name in self.rows]
        try:
            asked = {each.name: coerced(self.rows[each.name], each.value, each.name) for each in known}
            given = {**self._given, **asked}
            before = material_values(self.values, self._given)
            after = material_values({**self.values, **asked}, given)
        except (ValueError, TypeError, KeyError):  # refused with the reason in the next callback
            return []
        changed = {name: after.get(name, self.rows[name].default) for name in {**before, **after} if name not in given}
        return [
            RosParameter(name, value=ros_value(self.rows[name], value))
            for name, value in changed.items()
            if value != self.values[name]
        ]

    def _refuse_or_accept(self, parameters: list[RosParameter]) -> SetParametersResult:
        if self._declaring:  # checked before, as one object
            return SetParametersResult(successful=True)
        try:
            self._proposed(parameters)
        except Exception as error:
            for parameter in parameters:
                if parameter.name in self.rows:  # rclpy has already noted the refused value's type as the parameter's
                    held = self._node.get_parameter(parameter.name)
                    self._node.describe_parameter(parameter.name).type = held.type_.value
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _proposed(self, parameters: list[RosParameter]) -> dict[str, Any]:
        """Return the values with `parameters` in place. Raises ValueError if they are not allowed."""
        changed = {}
        for parameter in parameters:
            if parameter.name in self.rows:
                row = self.rows[parameter.name]
                if parameter.type_ == RosParameter.Type.NOT_SET:
                    raise ValueError(f"{parameter.name} cannot be deleted")
                changed[parameter.name] = coerced(row, parameter.value, parameter.name)
                if row.fixed and changed[parameter.name] != self.values[parameter.name]:
                    raise ValueError(f"{parameter.name} is fixed; allowed is what it is")
            elif not parameter.name.startswith(_RCLPY_OWN):
                raise ValueError(_unknown(parameter.name, self.rows))
        values = {**self.values, **changed}
        problems = make_plan(values).problems
        for owner in {name.partition(".")[0] for name in changed} & set(problems):
            raise ValueError(problems[owner])
        return values

    def _hand_on(self, parameters: list[RosParameter]) -> None:
        if self._declaring:
            return
        try:
            before, self.values = self.values, self._proposed(parameters)
            if self._restoring:
                return
            asked = {parameter.name: parameter.value for parameter in parameters if parameter.name in self.rows}
            self._given |= {name: value for name, value in asked.items() if name not in self._followed}
            # A live value acts even where it is the one before: a topic may have set another since.
            acting = [name for name in asked if self.rows[name].live or self.values[name] != before[name]]
            rebuilds = any(not self.rows[name].live for name in acting)
            for name in acting:
                if not (rebuilds and name in self._followed):  # the new simulation takes those as it is built
                    self._on_change(name, self.rows[name], self.values[name])
        except Exception as error:
            self._log.error(f"a parameter change was accepted but not applied: {error}")

    def restore(self, built: Mapping[str, Any]) -> None:
        """Set the parameters that rebuild back to the values `built` that the simulation still runs on."""
        rebuilding = {name for name, row in self.rows.items() if not (row.live or row.fixed)} & built.keys()
        self._hold({name: built[name] for name in rebuilding if self.values[name] != built[name]})

    def put_back(self, name: str, refused: Any, held: Any) -> None:
        """Set a live parameter back to the value `held` in effect, unless it was set again since it was refused."""
        if self.values[name] == refused:
            self._hold({name: held})

    def follow(self, values: Mapping[str, Any]) -> None:
        """Adopt values that the simulation got otherwise, such as by a service."""
        self._hold({name: value for name, value in values.items() if self.values[name] != value})

    def _hold(self, values: Mapping[str, Any]) -> None:
        """Set parameters without telling the simulation, which has these values already."""
        if not values:
            return
        self._restoring = True
        try:
            result = self._node.set_parameters_atomically(  # as some hold only together
                [RosParameter(name, value=ros_value(self.rows[name], value)) for name, value in values.items()]
            )
        finally:
            self._restoring = False
        if not result.successful:
            self._log.error(f"parameters cannot follow the simulation: {result.reason}")


def _default(row: Parameter, name: str, values: Mapping[str, Any]) -> Any:
    """Return the default of the parameter `name`, given the `values` of those declared before it."""
    return "none" if row.name == "pins" and values.get(name.replace(".pins", ".mesh")) else row.default


def filled(rows: Mapping[str, Parameter], given: Mapping[str, Any]) -> dict[str, Any]:
    """Return full name -> checked value of all `rows`; `given` has some. Raises ValueError in one sentence."""
    for name in given:
        if name not in rows:
            raise ValueError(_unknown(name, rows))
    values: dict[str, Any] = {}
    for name, row in rows.items():
        values[name] = coerced(row, given[name], name) if name in given else _default(row, name, values)
    return values


def _closest(name: str, known: Iterable[str]) -> str:
    """Return the parameter among `known` that is most similar to a wrong `name`, or ""."""
    owner, _, field = name.rpartition(".")
    of_owner = [each.rpartition(".")[2] for each in known if each.rpartition(".")[0] == owner]
    if of_owner:
        close = [f"{owner}.{each}".lstrip(".") for each in difflib.get_close_matches(field, of_owner, n=1)]
    else:
        close = difflib.get_close_matches(name, known, n=1)
    return close[0] if close else ""


def _unknown(name: str, known: Iterable[str]) -> str:
    close = _closest(name, known)
    plain = name if name.isprintable() and len(name) <= 80 else table.shown(name)
    return f"there is no parameter {plain}" + (f"; did you mean {close}?" if close else ".")


def coerced(row: Parameter, value: Any, name: str) -> Any:
    """Return `value` as the type of `row`.

    Text such as 1e-6 and whole numbers become doubles, and text in brackets a list. Raises ValueError in one sentence.
    """
    if row.kind.endswith("_array") and isinstance(value, str) and value.lstrip().startswith("["):
        try:  # ros2 param set sends a list of mixed numbers as text
            value = yaml.safe_load(value)
        except yaml.YAMLError:
            pass  # check() says what is allowed
    if isinstance(value, (list, tuple, array.array)):
        value = tuple(_number(item) if row.kind in ("double_array", "integer_array") else item for item in value)
    elif row.kind in ("double", "integer"):
        value = _number(value)
    return table.check(row, value, name)


def _number(value: Any) -> Any:
    """Return text such as 1e-6, which YAML takes for text, as a number; anything else as it is."""
    try:
        return float(value) if isinstance(value, str) else value
    except ValueError:
        return value  # check() says what is allowed


def ros_value(row: Parameter, value: Any) -> Any:
    """Return a checked value as ROS holds it: arrays are lists, no pins are "none"."""
    if row.kind == "pins" and not value:
        return "none"
    return list(value) if isinstance(value, tuple) else value


def bounded(row: Parameter, value: Any) -> Any:
    """Return a number within the range that ROS holds it to; other values as they are."""
    return min(max(value, row.low), row.high) if row.kind == "double" and isinstance(value, float) else value


def descriptor(row: Parameter, name: str) -> ParameterDescriptor:
    """Return description, range and constraints of `row` for tools that list parameters."""
    effect = "fixed at start" if row.fixed else "live" if row.live else "rebuilds the simulation"
    unit = f" [{row.unit}]" if row.unit else ""
    result = ParameterDescriptor(
        name=name,
        description=f"{row.text}{unit} ({effect})",
        additional_constraints=table.allowed(row),
        read_only=row.fixed,
        dynamic_typing=True,
    )
    if row.kind == "double" and row.low > -table.INFINITY and row.high < table.INFINITY:
        result.floating_point_range = [FloatingPointRange(from_value=row.low, to_value=row.high)]
    elif row.kind == "integer":
        result.integer_range = [IntegerRange(from_value=int(row.low), to_value=int(row.high), step=1)]
    return result
