# SPDX-License-Identifier: Apache-2.0
"""Scene, Settings and device of a Simulation from parameter values. Plain Python: no rclpy, nothing on a device."""

from __future__ import annotations

import math
import re
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from cloth_sim_ros import parameters
from cloth_sim_ros.ros.inputs.pose_track import Pose, composed
from cloth_sim_ros.ros.inputs.robot import GROUP, read_robot
from cloth_sim_ros.sim import Cloth, Gripper, Handle, Plane, Rope, Scene, Seam, Settings, Winch, Wind
from cloth_sim_ros.sim.colliders import SHAPES
from cloth_sim_ros.sim.colliders.collider import Collider
from cloth_sim_ros.sim.mesh_file import load_mesh, tell_once
from cloth_sim_ros.sim.scene.constraints import CONSTRAINTS, Constraint
from cloth_sim_ros.sim.scene.forces import FORCES, Force
from cloth_sim_ros.sim.scene.materials import CORDS, FABRICS, cell_of, rope_fields, sheet_fields, triangles_area

Values = Mapping[str, Any]  # full parameter name -> checked value


@dataclass(frozen=True)
class Plan:
    """Description of a simulation to build.

    problems: name of an object, collider, handle or group -> why it is left out, in one sentence. mounts: collider of
    the robot -> its link, and its pose in the axes of that. grippers: grippers whose fingers are among the colliders.
    frame_id: the frame of the scene.
    """

    scene: Scene
    settings: Settings
    device: str
    problems: dict[str, str] = field(default_factory=dict)
    mounts: dict[str, tuple[str, Pose]] = field(default_factory=dict)
    grippers: dict[str, Gripper] = field(default_factory=dict)
    frame_id: str = "world"

    def without(self, names: Container[str]) -> Plan:
        """Return the plan without the objects and seams of these names."""
        objects = {name: thing for name, thing in self.scene.objects.items() if name not in names}
        constraints = {name: each for name, each in self.scene.constraints.items() if each.object in objects}
        whole = {name: each for name, each in self.scene.seams.items() if name not in names}
        seams = {name: each for name, each in whole.items() if {each.first, each.second} <= objects.keys()}
        handles = {name: each for name, each in self.scene.handles.items() if each.object in ("", *objects)}
        things = {"objects": objects, "constraints": constraints, "seams": seams, "handles": handles}
        return replace(self, scene=replace(self.scene, **things))

    def with_poses(self, poses: Mapping[str, Pose]) -> Plan:
        """Return the plan with colliders and handles at `poses`, where topics have moved them."""
        colliders = {
            name: replace(collider, **_placed(collider, poses[name])) if name in poses else collider
            for name, collider in self.scene.colliders.items()
        }
        handles = {
            name: replace(handle, **vars(poses[name])) if name in poses else handle
            for name, handle in self.scene.handles.items()
        }
        return replace(self, scene=replace(self.scene, colliders=colliders, handles=handles))


def make_plan(values: Values) -> Plan:
    """Return the plan for `values`. Things that are not allowed are left out, with a sentence in `problems`."""
    problems: dict[str, str] = {}
    objects = _made(values, values["objects"], make_object, problems)
    colliders = _made(values, values["colliders"], make_collider, problems)
    handles = _made(values, values["handles"], make_handle, problems)
    for name in [name for name, handle in handles.items() if handle.object not in ("", *objects)]:
        problems[name] = f"{name}.object is {handles.pop(name).object!r}, which is left out"
    grippers = _made(values, values["grippers"], make_gripper, problems)
    for name, gripper in grippers.items():
        colliders |= gripper.fingers(name)
    links, mounts = make_robot(values, problems)
    colliders |= links
    forces = _made(values, values["forces"], make_force, problems)
    constraints = _made(values, values["constraints"], make_constraint, problems)
    seams = _made(values, values["seams"], make_seam, problems)
    wind = None
    if values["wind.enabled"]:
        wind = Wind(**{name: value for name, value in group(values, "wind").items() if name != "enabled"})
    return Plan(
        scene=Scene(
            objects,
            colliders,
            wind,
            gravity=values["gravity"],
            handles=handles,
            spare_colliders=values["spare_colliders"],
            object_contact=values["object_contact"],
            forces=forces,
            constraints={name: each for name, each in constraints.items() if each.object in objects},
            seams={name: each for name, each in seams.items() if {each.first, each.second} <= objects.keys()},
        ),
        settings=Settings(frame_dt=1.0 / values["rate"], **group(values, "solver")),
        device=values["device"],
        problems=problems,
        mounts=mounts,
        grippers=grippers,
        frame_id=values["frame_id"],
    )


def group(values: Values, prefix: str) -> dict[str, Any]:
    """Return the values under `prefix`, by their names without it."""
    start = prefix + "."
    return {name[len(start) :]: value for name, value in values.items() if name.startswith(start)}


def material_values(values: Values, given: Container[str]) -> dict[str, Any]:
    """Return full name -> value of all parameters that the materials of objects set, without those in `given`.

    given: names that the user has set. A material that cannot be used sets nothing; make_object raises the reason.
    """
    found = {}
    for name in values["objects"]:
        try:
            fields = _of_material(values, name, given) if values[f"{name}.material"] else {}
        except ValueError:
            continue
        found |= {f"{name}.{field}": value for field, value in fields.items() if value is not None}
    return {name: value for name, value in found.items() if name not in given}


def _of_material(values: Values, name: str, given: Container[str]) -> dict[str, Any]:
    """Return field -> value of the parameters that an object's material sets. Raises ValueError."""
    own = group(values, name)
    if own["type"] == "rope":
        radius = own["radius"] if f"{name}.radius" in given else None
        length = math.dist(own["start"], own["end"])
        if own["path"]:
            points = along_path(own["path"], own["segments"], f"{name}.path")
            length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
        fields = rope_fields(own["material"], length, radius)
        return {**fields, "bending": "angle"}
    path, scale = own["mesh"], own["scale"]
    area = math.prod(own["size"])
    if path:
        area = scale**2 * triangles_area(*load_mesh(path, f"{name}.mesh", scale))
    own_fields = {field: value for field, value in own.items() if f"{name}.{field}" in given}
    cell = None if path else cell_of(own["size"], own["resolution"])
    return sheet_fields(own["material"], area, own_fields, cell)


def make_object(values: Values, name: str) -> Cloth | Rope:
    """Return the cloth or rope called `name`. Raises ValueError with what is wrong."""
    own, types = group(values, name), parameters.OBJECT[0].choices
    if own["type"] not in types:
        raise ValueError(f"{name}.type is {own['type']!r}; allowed is one of {', '.join(types)}")
    material, known = own.pop("material"), CORDS if own["type"] == "rope" else FABRICS
    if material and material not in known:
        raise ValueError(f"{name}.material is {material!r}; allowed is one of {', '.join(known)}")
    if own["bending"] == "none":
        own["bend_compliance"] = None
    if own.pop("type") == "rope":
        del own["bending"]
        if not own.pop("twist"):
            del own["twist_compliance"]
        winch = group(own, "winch")
        del winch["timeout"]
        own = {field: value for field, value in own.items() if not field.startswith("winch.")}
        path = own.pop("path")
        if path:
            del own["start"], own["end"]
            own["points"] = along_path(path, own.pop("segments"), f"{name}.path")
        return Rope(**own, winch=Winch(**winch) if winch.pop("enabled") else None)
    path, shear, scale, uv = (own.pop(field) for field in ("mesh", "shear", "scale", "uv"))
    if not shear:
        own["shear_compliance"] = None
    for like_warp in ("weft_compliance", "weft_bend_compliance", "diagonal_bend_compliance"):
        own[like_warp] = own[like_warp] or None
    if not path:
        del own["warp"]
        return Cloth(**own)
    for absent in ("resolution", "size"):
        del own[absent]
    return Cloth.from_file(path, scale=scale, uv=uv, named=f"{name}.mesh", **own)


def along_path(path: Sequence[float], segments: int, name: str) -> np.ndarray:
    """Return points (segments + 1, 3) [m] at equal distances along straight lines between the corners of `path`.

    path: x y z [m] of each corner. The log tells once if the points cut corners and are more than a hundredth shorter.
    Raises ValueError for fewer than two corners, for a corner without three numbers, and for one that repeats the last.
    """
    if len(path) % 3 or len(path) < 6:
        raise ValueError(f"{name} has {len(path)} numbers; allowed are x y z of two corners or more")
    corners = np.reshape(path, (-1, 3))
    lengths = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    if not lengths.all():
        at = np.flatnonzero(lengths == 0.0)[0]
        raise ValueError(f"{name} has the corner {corners[at].tolist()} twice in a row; allowed are corners apart")
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    wanted = np.linspace(0.0, along[-1], segments + 1)
    points = np.stack([np.interp(wanted, along, axis) for axis in corners.T], axis=1)
    length = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
    if length < 0.99 * along[-1]:
        cut = f"{segments} segments along it cut its corners and have {length:.3g} m"
        tell_once(f"{name} is {along[-1]:.3g} m long, but {cut}; more segments follow it")
    return points


def make_collider(values: Values, name: str) -> Collider:
    """Return the collider called `name`. Raises ValueError with what is wrong."""
    own = group(values, name)
    shape, dimensions, file, scale = (own.pop(field) for field in ("shape", "dimensions", "mesh", "scale"))
    del own["follow_frame"]
    kind = SHAPES.get(shape)
    if kind is None:
        raise ValueError(f"{name}.shape is {shape!r}; allowed is one of {', '.join(SHAPES)}")
    if hasattr(kind, "from_file"):
        return _from_file(name, shape, file, scale=scale, **own)
    try:
        return kind.from_dimensions(dimensions, **own)
    except ValueError as error:
        raise ValueError(str(error).replace(f"{kind.__name__}.", f"{name}.")) from None


def _from_file(name: str, shape: str, file: str, **fields: Any) -> Collider:
    """Return the collider called `name` from a file. Raises ValueError."""
    if not file:
        raise ValueError(f"{name}.mesh is empty; a {shape} has a file")
    try:
        return SHAPES[shape].from_file(file, **fields)
    except ValueError as error:
        sentence = re.sub(r"^\w+\.from_file", f"{name}.mesh", str(error))
    raise ValueError(sentence if sentence.startswith(name) else f"{name}: {sentence}")


def make_handle(values: Values, name: str) -> Handle:
    """Return the handle called `name`. Raises ValueError with what is wrong."""
    own = group(values, name)
    if own["object"] not in ("", *values["objects"]):
        allowed = ", ".join(values["objects"])
        raise ValueError(f"{name}.object is {own['object']!r}; allowed is '' for any object or one of {allowed}")
    if len(own["reach"]) not in (1, 3):
        raise ValueError(f"{name}.reach is {parameters.shown(own['reach'])}; allowed is 1: radius [m], or 3: x y z [m]")
    del own["follow_frame"]
    return Handle(**own)


def make_gripper(values: Values, name: str) -> Gripper:
    """Return the gripper called `name`. Raises ValueError with what is wrong."""
    own = group(values, name)
    for row in (parameters.FOLLOW_FRAME, *parameters.GRIPPER_JOINT):
        del own[row.name]
    if values[f"{name}.joint_open"] == values[f"{name}.joint_closed"]:
        raise ValueError(f"{name}.joint_open is {values[f'{name}.joint_open']:g}, as is joint_closed; they must differ")
    try:
        gripper = Gripper(**own)
    except ValueError as error:
        raise ValueError(str(error).replace("Gripper.", f"{name}.")) from None
    taken = [*values["objects"], *values["colliders"], *values["handles"], *values["grippers"]]
    for finger in gripper.fingers(name):
        if finger in taken:
            raise ValueError(f"{name} has a finger {finger}; allowed is a gripper whose fingers' names are not taken")
    return gripper


def make_robot(values: Values, problems: dict[str, str]) -> tuple[dict[str, Collider], dict[str, tuple[str, Pose]]]:
    """Return the colliders of the robot's links, with its joints at 0, and Plan.mounts; add errors to `problems`."""
    colliders: dict[str, Collider] = {}
    try:
        robot = read_robot(values["robot.urdf"]) if values["robot.urdf"] else None
        parts = robot.chosen(values["robot.links"]) if robot is not None else {}
        if robot is not None and not parts:
            allowed = ", ".join(sorted({part.link for part in robot.parts.values()})) or "none, as no link collides"
            raise ValueError(
                f"robot.links is {parameters.shown(values['robot.links'])}, which no link matches; there are {allowed}"
            )
    except ValueError as error:
        problems[GROUP] = str(error)
        return {}, {}
    places = robot.places({}, Pose.of(values, GROUP)) if parts else {}
    surface = {name: values[f"robot.{name}"] for name in ("static_friction", "kinetic_friction")}
    for name, part in parts.items():
        try:
            colliders[name] = part.make({**surface, **placed(composed(places[part.link], part.pose))})
        except ValueError as error:
            problems[name] = f"{name}: {error}"
    return colliders, {name: (parts[name].link, parts[name].pose) for name in colliders}


def make_force(values: Values, name: str) -> Force:
    """Return the force called `name`. Raises ValueError with what is wrong."""
    return _of_plugin(FORCES, values, name)


def make_constraint(values: Values, name: str) -> Constraint:
    """Return the constraint called `name`. Raises ValueError with what is wrong."""
    if values[f"{name}.object"] not in values["objects"]:
        allowed = ", ".join(values["objects"])
        raise ValueError(f"{name}.object is {values[f'{name}.object']!r}; allowed is one of {allowed}")
    return _of_plugin(CONSTRAINTS, values, name)


def make_seam(values: Values, name: str) -> Seam:
    """Return the seam called `name`. Raises ValueError with what is wrong."""
    own = group(values, name)
    for which in ("first", "second"):
        if own[which] not in values["objects"]:
            allowed = ", ".join(values["objects"])
            raise ValueError(f"{name}.{which} is {own[which]!r}; allowed is one of {allowed}")
    try:
        return Seam(**own)
    except ValueError as error:
        raise ValueError(str(error).replace("Seam.", f"{name}.")) from None


def _of_plugin(known: Mapping[str, type], values: Values, name: str) -> Any:
    """Make the object called `name`, of a class in one of the tables that plugins add to. Raises ValueError."""
    own = group(values, name)
    kind = known.get(own.pop("type"))
    if kind is None:
        allowed = f"one of {', '.join(known)}" if known else "none, as no plugin adds any"
        raise ValueError(f"{name}.type is {values[f'{name}.type']!r}; allowed is {allowed}")
    try:
        return kind(**own)
    except ValueError as error:
        raise ValueError(str(error).replace(f"{kind.__name__}.", f"{name}.")) from None


def _made(values: Values, names: tuple[str, ...], make, problems: dict[str, str]) -> dict[str, Any]:
    things = {}
    for name in names:
        try:
            things[name] = make(values, name)
        except ValueError as error:
            sentence = re.sub(r"^(Rope|Cloth|Handle)(?=[. ])", name, str(error))
            sentence = re.sub(r"^Winch\.", f"{name}.winch.", sentence)
            problems[name] = sentence if re.match(rf"{re.escape(name)}[. :]", sentence) else f"{name}: {sentence}"
    return things


def placed(pose: Any) -> dict[str, Any]:
    """Return the position and orientation of any object that has them, as fields."""
    return {"position": pose.position, "orientation": pose.orientation}


def _placed(collider: Any, pose: Pose) -> dict[str, Any]:
    place = placed(pose)
    if isinstance(collider, Plane):  # a plane's point and normal repeat its pose, and would win over it
        place |= {"point": None, "normal": None}
    return place
