# SPDX-License-Identifier: Apache-2.0
"""THE table of every parameter: name, type, default, unit, range, live or structural, one sentence.

`sim` checks its dataclasses against it, `ros` declares ROS parameters from it, and the parameter reference in
docs/reference/parameters.md is printed from it. To add a parameter, add its row here; nothing else declares one.
Imports the standard library only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

INFINITY = math.inf


@dataclass(frozen=True)
class Parameter:
    """One row: `live` values take effect at the next frame, `fixed` ones hold until a restart, others rebuild.

    anew: True if a change restarts the object; otherwise the object goes on from its state.

    kind: "bool", "integer", "double", "string", "path" (of a file), "string_array", "double_array" or "pins" (a word or
    a list of indices). low, high: inclusive bounds of a number or of every element of an array. length: that of an
    array, 0 for any.
    """

    name: str
    kind: str
    default: Any
    text: str
    unit: str = ""
    low: float = -INFINITY
    high: float = INFINITY
    live: bool = False
    choices: tuple[str, ...] = ()
    length: int = 0
    fixed: bool = False
    anew: bool = False


def number(name, default, text, unit="", low=-INFINITY, high=INFINITY, live=True):
    """Return a row of one number, live unless said otherwise."""
    return Parameter(name, "double", float(default), text, unit, float(low), float(high), live)


def _integer(name, default, text, low, high, live=False, anew=False):
    return Parameter(name, "integer", default, text, "", low, high, live, anew=anew)


def vector(name, default, text, unit="", low=-INFINITY, high=INFINITY, length=3, **when):
    """Return a row of `length` numbers."""
    value = tuple(map(float, default))
    return Parameter(name, "double_array", value, text, unit, low, high, length=length, **when)


def _choice(name, default, text, choices):
    return Parameter(name, "string", default, text, choices=choices)


_FAR = 1e4  # [m] from the origin, along an axis: an object counts as run away at 1e6 m

_PLACE = (
    vector("position", (0, 0, 0), "Position of the local origin.", "m", -_FAR, _FAR, anew=True),
    vector(
        "orientation", (0, 0, 0, 1), "Orientation quaternion x y z w of the local axes.", "", -1, 1, length=4, anew=True
    ),
)

_SURFACE = (
    number("static_friction", 0.5, "Coulomb coefficient while sticking; a pair uses the geometric mean.", "", 0, 10),
    number(
        "kinetic_friction",
        0.4,
        "Coulomb coefficient of slips from 5 cm/s on; a pair uses the geometric mean.",
        "",
        0,
        10,
    ),
)

_BODY = (
    number("mass", 0.2, "Total mass, pinned particles included.", "kg", 1e-9, 1e6),
    number("damping", 0.0, "Axial damping: time constant of every spring's dashpot, c = damping x k.", "s", 0, 1e3),
    Parameter("self_contact", "bool", False, "Whether its parts keep twice the thickness or radius from one another."),
)

SOLVER = (
    _choice(
        "method",
        "auto",
        "auto and xpbd: implicit, holds when stiff; verlet: explicit, for soft sheets and ropes without bending.",
        ("auto", "verlet", "xpbd"),
    ),
    _integer("order", 0, "Of xpbd: 1 is implicit Euler, 2 is BDF2; 0 is chosen.", 0, 2),
    _integer("substeps", 0, "Substeps a frame; 0 is chosen for each object.", 0, 10000, live=True),
    _integer("iterations", 0, "Sweeps of xpbd a substep; 0 is chosen for each object.", 0, 1000, live=True),
    number(
        "error",
        1e-2,
        "Wanted error: of positions, RMS, over the RMS of how far they moved, in half a second from rest.",
        "",
        1e-6,
        1,
    ),
    number("budget", 0.5, "Share of real time that the substeps chosen for all objects may take.", "", 1e-3, 1e4),
    number(
        "speed",
        0,
        "Speed of the device for solver.budget, of 1 for the core that prices are of; 0 is measured once a machine.",
        "",
        0,
        1e3,
    ),
    Parameter(
        "sleep", "bool", True, "Whether an object at rest is not computed until something around it changes.", live=True
    ),
    number("global_damping", 0.0, "Drag on every particle, relative to its momentum.", "1/s", 0, 1e4),
)

FRAME_DT = number("frame_dt", 1 / 60, "Simulated time a frame.", "s", 1e-6, 1.0, live=False)

SCALE = number("scale", 1, "How many times as large as its scene says an object is; its mass stays.", "", 1e-3, 1e3)

WIND = (
    Parameter("enabled", "bool", False, "Whether the scene has wind; without it no aerodynamics is compiled in."),
    vector(
        "velocity",
        (0, 0, 0),
        "Wind velocity; one on ~/wind acts in its place until this is set again, and /diagnostics tells which blows.",
        "m/s",
        -1000,
        1000,
        live=True,
    ),
    number("air_density", 1.225, "Density of the air.", "kg/m^3", 0, 1e4),
    number(
        "drag_coefficient",
        1.2,
        "Drag coefficient across the flow; of a surface at incidence a times sin^3 a.",
        "",
        0,
        100,
    ),
    number(
        "lift_coefficient",
        0.6,
        "Lift of a surface at incidence a, over sin a sin 2a; half of the drag coefficient is pressure alone.",
        "",
        0,
        100,
    ),
)

CLOTH = (
    Parameter(
        "resolution", "integer_array", (32, 32), "Particles along local x and y.", "", 2, 2048, length=2, anew=True
    ),
    vector("size", (1, 1), "Width and height.", "m", 1e-4, 1e4, length=2, anew=True),
    Parameter(
        "pins", "pins", "corners", "Fixed particles: corners (the top two), top, edges, none, or indices.", live=True
    ),
    number(
        "stretch_compliance",
        1e-3,
        "Compliance in stretch along the warp: 1/spring constant of a square grid; of a mesh 1/Young's modulus.",
        "m/N",
        0,
        1e6,
    ),
    number(
        "shear_compliance",
        3e-3,
        "Compliance in shear: 1/constant of the diagonal springs of a square grid; of a mesh 1/shear modulus.",
        "m/N",
        0,
        1e6,
    ),
    number(
        "weft_compliance",
        0,
        "Compliance in stretch along the weft, of a grid along y; 0 is that of the warp.",
        "m/N",
        0,
        1e6,
        live=False,
    ),
    number(
        "poisson", 0, "Contraction of a mesh along the weft over its stretch along the warp.", "", -1, 2, live=False
    ),
    _choice(
        "bending",
        "none",
        "none; springs: distance springs over two edges [m/N]; dihedral: angle between triangles [1/(N m)].",
        ("none", "springs", "dihedral"),
    ),
    number(
        "bend_compliance",
        1.0,
        "springs: 1/spring constant [m/N]; dihedral: 1/flexural rigidity of the sheet [1/(N m)]; 0 is rigid.",
        "m/N or 1/(N m)",
        0,
        1e12,
    ),
    number(
        "weft_bend_compliance",
        0,
        "dihedral: 1/rigidity of a strip along the weft; 0 is that of the warp.",
        "1/(N m)",
        0,
        1e12,
        live=False,
    ),
    number(
        "diagonal_bend_compliance",
        0,
        "dihedral: 1/rigidity of a strip at 45 degrees; 0 is the mean of warp and weft.",
        "1/(N m)",
        0,
        1e12,
        live=False,
    ),
    number("thickness", 0.005, "Distance from a collider at which the middle surface touches it.", "m", 0, 1.0),
    number(
        "tear_strain",
        0,
        "Strain beyond which a structural or shear spring fails for good, and the surface there; 0 is never.",
        "",
        0,
        1e3,
        live=False,
    ),
    *_BODY,
    *_SURFACE,
    *_PLACE,
)

ROPE = (
    _integer("segments", 32, "Straight segments from start to end.", 1, 65535, anew=True),
    vector("start", (0, 0, 1), "First end, in the local axes.", "m", -_FAR, _FAR, anew=True),
    vector("end", (1, 0, 1), "Last end, in the local axes.", "m", -_FAR, _FAR, anew=True),
    vector(
        "path", (), "x y z of each corner of its way, in place of start and end.", "m", -_FAR, _FAR, length=0, anew=True
    ),
    Parameter("pins", "pins", "start", "Fixed particles: start, end, both, none, or indices.", live=True),
    number("radius", 0.005, "Radius of the rope.", "m", 1e-6, 10.0),
    number("end_mass", 0, "Mass of a load at the end, beside that of the rope.", "kg", 0, 1e6),
    number("stretch_compliance", 1e-4, "1/EA: strain per tension; 0 is rigid.", "1/N", 0, 1e6),
    _choice("bending", "none", "none; angle: resists curvature with 1/bend_compliance = EI.", ("none", "angle")),
    number(
        "bend_compliance",
        1e2,
        "1/EI: curvature per bending moment; 0 is rigid, as far as float64 resolves.",
        "1/(N m^2)",
        0,
        1e12,
    ),
    number("bend_damping", 0.0, "Time constant of the dashpot beside the stiffness in bending and twist.", "s", 0, 1e3),
    *_BODY,
    *_SURFACE,
    *_PLACE,
)

TWIST = (
    Parameter(
        "twist",
        "bool",
        False,
        "Whether a rope that bends resists twist between two clamps: ends of two particles that are pinned or held.",
        anew=True,
    ),
    number("twist_compliance", 1e2, "1/GJ: twist per length and torsional moment.", "1/(N m^2)", 1e-6, 1e12),
    number("end_turn", 0, "By how much the end is turned about its axis against the start.", "rad", -1e4, 1e4),
)

WINCH = (
    Parameter(
        "enabled",
        "bool",
        False,
        "Whether a winch at the start, which is held, pays the rope out and hauls it in.",
        anew=True,
    ),
    Parameter(
        "length",
        "double",
        1e4,
        "Paid out at the beginning, laid from the start along the rope's path; the whole rope where that is shorter.",
        "m",
        1e-6,
        1e4,
        anew=True,
    ),
    number("pay_out", 0, "Rate at which rope is paid out, below 0 hauled in, unstretched.", "m/s", -100, 100),
    number("max_rate", 1, "Largest rate of the winch, both ways; more than that is cut to it.", "m/s", 0, 100),
    number("acceleration", 1, "How fast the rate changes at most.", "m/s^2", 1e-3, 1e4),
    number("shortest", 0, "Hauls in no further than this, nor than half of the last segment.", "m", 0, 1e4),
    number("longest", 1e4, "Pays out no further than this, nor than the rope is long.", "m", 1e-6, 1e4),
)

WINCH_TOPIC = (
    number(
        "timeout",
        0.5,
        "A rate by topic holds this long in simulated time, then pay_out acts again; so does it after a reset.",
        "s",
        0.01,
        3600,
    ),
)

FOLLOW_FRAME = Parameter(
    "follow_frame",
    "string",
    "",
    "A frame of tf that it goes with, without a topic; needs tf2_ros; empty is none.",
    live=True,
)

UNIT = number("scale", 1, "Length of a unit in the file of a mesh or signed_distance.", "m", 1e-6, 1e6, live=False)

COLLIDER = (
    Parameter("shape", "string", "sphere", "Shape of the collider, of those in sim/colliders/ or of a plugin."),
    Parameter(
        "dimensions",
        "double_array",
        (0.2,),
        "As in shape_msgs/SolidPrimitive: box x y z; sphere radius; cylinder and capsule height of the cylinder, "
        "radius; ellipsoid diameters x y z; plane none.",
        "m",
        1e-6,
        1e6,
    ),
    Parameter(
        "mesh",
        "string",
        "",
        "File of a closed surface, read by trimesh: a path, file:///PATH or package://NAME/PATH. FILE.urdf#LINK is a "
        "robot's link, as far as it collides. For signed_distance that or an .npz of values, origin and spacing.",
    ),
    number("compliance", 0, "Depth of a point of contact over the force there; 0 is rigid.", "m/N", 0, 1e6),
    UNIT,
    *_SURFACE,
    *_PLACE,
)

HANDLE = (
    Parameter(
        "reach",
        "double_array",
        (0.03,),
        "What is grasped lies within this: the radius of a ball, or x y z of a box, around the handle.",
        "m",
        1e-6,
        1e6,
        live=True,
    ),
    Parameter("object", "string", "", "The one object that it grasps; empty is any.", live=True),
    number("compliance", 0, "Of its hold on all that it grasps, along each axis; 0 is rigid.", "m/N", 0, 1e6),
    number("break_force", 0, "It lets go where it is pulled harder than this; 0 is never.", "N", 0, 1e9),
    Parameter("attached", "bool", False, "Whether it holds what was within its reach when it grasped.", live=True),
    *_PLACE,
)

ROBOT = (
    Parameter(
        "description",
        "string",
        "",
        "Topic of std_msgs/String, latched, that sets urdf, such as /robot_description; empty is none.",
        fixed=True,
    ),
    Parameter(
        "urdf", "string", "", "Description of a robot, whose links collide: a file as of a mesh, or the text itself."
    ),
    Parameter("links", "string_array", ("*",), "Patterns of the names of links that collide, such as finger_*."),
    Parameter(
        "joint_states",
        "string",
        "",
        "Topic of sensor_msgs/JointState by which the links go; empty: they go by tf, which needs tf2_ros.",
        fixed=True,
    ),
    *(replace(row, text=f"{row.text[:-1]}; of every link.", live=False) for row in _SURFACE),
    *(replace(row, text=f"{row.text[:-1]} of the root link, with joint_states.", anew=False) for row in _PLACE),
)

FORCE = (Parameter("type", "string", "", "What the force is, of those that plugins add.", fixed=True),)

CONSTRAINT = (
    Parameter("type", "string", "", "What the constraint is, of those that plugins add.", fixed=True),
    Parameter("object", "string", "", "The object whose particles it joins."),
    Parameter("between", "integer_array", (), "The particles that it joins, two by two.", low=0, high=1 << 31),
)

SEAM = (
    number("compliance", 0, "Gap of each stitch over its load; 0 is rigid.", "m/N", 0, 1e6),
    number("strength", 0, "Load at which a stitch breaks for good; 0 is never.", "N", 0, 1e9),
    number("closing_speed", 0.5, "How fast a stitch that begins open closes at most.", "m/s", 1e-3, 100),
)

SEAM_PLACE = (
    Parameter("first", "string", "", "The object whose particles are sewn on.", fixed=True),
    Parameter("second", "string", "", "The object that they are sewn to, which may be the first itself.", fixed=True),
    *(
        Parameter(f"{which}_particles", "integer_array", (), text, low=0, high=1 << 31, fixed=True)
        for which, text in (
            ("first", "Corners of the line in the first object, which follows its border or its edges between them."),
            ("second", "Corners of the line in the second object, in the same order."),
        )
    ),
    Parameter(
        "points", "bool", False, "Whether these particles alone are sewn, one to one, without lines.", fixed=True
    ),
    Parameter(
        "slides",
        "bool",
        False,
        "Whether stitches slide freely along the second object, a rope, like eyelets along a draw-string.",
        fixed=True,
    ),
)

GRIPPER = (
    vector("finger_size", (0.02, 0.01, 0.04), "Edges of each finger, a box; the gripper opens along y.", "m", 1e-4, 10),
    number("max_opening", 0.08, "Widest gap between the faces of the fingers.", "m", 1e-4, 10, live=False),
    number(
        "opening", 0.08, "The gap that they go to; of this and the force, the one acts that was set last.", "m", 0, 10
    ),
    number("force", 0, "With which each finger presses; 0: they go to the opening.", "N", 0, 1e4),
    number("speed", 0.1, "How fast the opening changes at most.", "m/s", 1e-4, 100),
    number("compliance", 0.01, "Depth of a point of contact over the force there.", "m/N", 1e-9, 1e6),
    *(replace(row, default=0.8) for row in _SURFACE),
    *_PLACE,
)

GRIPPER_JOINT = (
    *(
        Parameter(name, "string", "", text, fixed=True)
        for name, text in (
            ("joint", "Name of its joint in the messages of these topics; empty: the gripper's own."),
            ("joint_commands", "Topic of sensor_msgs/JointState that moves it, as of ros2_control; empty is none."),
            ("joint_trajectory", "Topic of trajectory_msgs/JointTrajectory that moves it; empty is none."),
            ("joint_states", "Topic of sensor_msgs/JointState on which its joint is told; empty is none."),
        )
    ),
    replace(number("joint_closed", 0, "Position of the joint where its fingers meet.", "", -1e3, 1e3), fixed=True),
    replace(number("joint_open", 0.08, "Position of the joint at max_opening.", "", -1e3, 1e3), fixed=True),
)

SPARE_COLLIDERS = Parameter(
    "spare_colliders",
    "integer",
    0,
    "How many colliders may be added on ~/scene while the node runs; 0 is none, and costs nothing.",
    low=0,
    high=1000,
    fixed=True,
)

OBJECT_CONTACT = Parameter(
    "object_contact", "bool", False, "Whether objects keep the sum of their thicknesses, or radii, from one another."
)

GRAVITY = vector("gravity", (0, 0, -9.81), "Acceleration of gravity.", "m/s^2", -1e4, 1e4, live=True)

NODE = (
    Parameter("objects", "string_array", (), "Names of the objects; each prefixes its own parameters.", fixed=True),
    Parameter("colliders", "string_array", (), "Names of the colliders; each prefixes its own parameters.", fixed=True),
    Parameter("handles", "string_array", (), "Names of the handles; each prefixes its own parameters.", fixed=True),
    Parameter("grippers", "string_array", (), "Names of the grippers; each prefixes its own parameters.", fixed=True),
    Parameter("forces", "string_array", (), "Names of the forces; each prefixes its own parameters.", fixed=True),
    Parameter(
        "constraints", "string_array", (), "Names of the constraints; each prefixes its own parameters.", fixed=True
    ),
    Parameter("seams", "string_array", (), "Names of the seams; each prefixes its own parameters.", fixed=True),
    Parameter(
        "plugins",
        "string_array",
        (),
        "Python modules that are imported at the start and add shapes, forces, constraints and topics.",
        fixed=True,
    ),
    Parameter("device", "string", "auto", "Where to compute: auto, cpu, cuda:0, ..."),
    Parameter("frame_id", "string", "world", "Frame of everything sent and received.", fixed=True),
    number("rate", 60, "Frames a second, simulated and sent.", "Hz", 1, 1000, live=False),
    number(
        "pose_timeout",
        0.5,
        "A collider stays put after its last pose; a gap longer than this between two poses is crossed in one frame.",
        "s",
        0.01,
        60,
    ),
    Parameter(
        "state_file",
        "path",
        "cloth_sim_state.npz",
        "File that ~/save writes and ~/load reads; a relative path starts in ROS_HOME, or else in ~/.ros. ~/save "
        "replaces saved states alone.",
        live=True,
    ),
    Parameter("publish_clock", "bool", False, "Whether to send /clock and to stamp with simulated time.", fixed=True),
    SPARE_COLLIDERS,
    OBJECT_CONTACT,
    GRAVITY,
)

VIEW = (
    vector(
        "position",
        (0, 0, 0),
        "Where the page's camera begins; at look_at: where all is seen.",
        "m",
        -_FAR,
        _FAR,
        fixed=True,
    ),
    vector("look_at", (0, 0, 0), "What it looks at.", "m", -_FAR, _FAR, fixed=True),
)

PUBLISH = (
    Parameter("normals", "bool", False, "Whether particles carry normal_x normal_y normal_z.", live=True),
    Parameter("velocities", "bool", False, "Whether particles carry vx vy vz [m/s].", live=True),
    Parameter(
        "tensions",
        "bool",
        False,
        "Whether a rope's particles carry tension [N], of the segment that begins at each; the last repeats.",
        live=True,
    ),
    Parameter("mesh", "bool", True, "Whether there is a mesh marker to draw.", live=True),
)

OBJECT = (
    Parameter("type", "string", "cloth", "What the object is.", choices=("cloth", "rope"), fixed=True),
    Parameter(
        "material",
        "string",
        "",
        "One of the materials below, or none: sets what is not set here, the mass by the size, and bending.",
    ),
)

SHEET = (
    Parameter(
        "mesh",
        "string",
        "",
        "File of a triangle mesh in place of the grid, read by trimesh; FILE#PART is one part of it.",
        anew=True,
    ),
    replace(UNIT, text="Length of a unit in the file of the mesh.", anew=True),
    Parameter(
        "shear", "bool", True, "Whether a grid has diagonal springs, and a mesh moduli; else its edges carry shear."
    ),
    vector("warp", (1, 0, 0), "Direction of the warp of a mesh, in the local axes; of a grid it is x.", "", -1, 1),
    Parameter("uv", "bool", False, "Whether `warp` is along u and v of the texture of the mesh, [0, 1, 0] along v."),
)


def row(group: tuple[Parameter, ...], name: str) -> Parameter:
    """Return the row called `name` of `group`. Raises KeyError if there is none."""
    for parameter in group:
        if parameter.name == name:
            return parameter
    raise KeyError(name)


def allowed(parameter: Parameter) -> str:
    """Return the allowed values of `parameter` in words, for messages and the reference."""
    if parameter.choices:
        return "one of " + ", ".join(parameter.choices)
    if parameter.kind == "pins":
        return "a name such as 'none' or a list of particle indices"
    words = {
        "bool": "true or false",
        "integer": "a whole number",
        "double": "a finite number",
        "string": "text",
        "path": "the path of a file, where ~/ is your home",
    }
    text = words.get(parameter.kind) or f"{parameter.length or 'a list of'} {_element(parameter)}"
    low, high = parameter.low, parameter.high
    if low > -INFINITY and high < INFINITY:
        text += f" from {low:g} to {high:g}"
    elif low > -INFINITY:
        text += f" of at least {low:g}"
    return text + (f" [{parameter.unit}]" if parameter.unit else "")


def check(parameter: Parameter, value: Any, name: str | None = None) -> Any:
    """Return `value` as the type of `parameter`. Raises ValueError, which names the thing, the value and what is
    allowed.

    Whole numbers count as doubles, tuples and arrays as lists; booleans never count as numbers.
    """
    try:
        return _CHECKS[parameter.kind](parameter, value)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{name or parameter.name} is {shown(value)}; allowed is {allowed(parameter)}") from None


def shown(value: Any) -> str:
    """Return a foreign value on one line of bounded length: text in quotes, its control characters escaped.

    Tuples and arrays are lists, as in YAML. A long value keeps both ends: the last part of a path says most.
    """
    text = repr(_listed(value))
    return text if len(text) <= 80 else f"{text[:37]}...{text[-40:]}"


def _listed(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _listed(item) for name, item in value.items()}
    value = value.tolist() if hasattr(value, "tolist") else value
    return [_listed(item) for item in value] if isinstance(value, (list, tuple)) else value


def _element(parameter: Parameter) -> str:
    return {"double_array": "finite numbers", "integer_array": "whole numbers", "string_array": "names"}[parameter.kind]


def _number(parameter: Parameter, value: Any) -> float:
    if isinstance(value, (bool, str, bytes)) or type(value).__name__ == "bool_":
        raise TypeError
    number = float(value)
    if not math.isfinite(number) or not parameter.low <= number <= parameter.high:
        raise ValueError
    return number


def _whole(parameter: Parameter, value: Any) -> int:
    number = _number(parameter, value)
    if number != int(number):
        raise ValueError
    return int(number)


def _text(parameter: Parameter, value: Any) -> str:
    if not isinstance(value, str) or (parameter.choices and value not in parameter.choices):
        raise ValueError
    return value


def _path(parameter: Parameter, value: Any) -> str:
    path = _text(parameter, value)
    first, last = path.split("/")[0], path.split("/")[-1]
    is_folder = last in ("", ".", "..", "~")
    if is_folder or (first.startswith("~") and first != "~") or any(letter < " " for letter in path):
        raise ValueError
    return path


def _flag(parameter: Parameter, value: Any) -> bool:
    if not isinstance(value, bool):
        raise TypeError
    return value


def _array(convert):
    def check_array(parameter: Parameter, value: Any) -> tuple:
        if isinstance(value, (str, bytes)):
            raise TypeError
        items = tuple(convert(parameter, item) for item in value)
        if parameter.length and len(items) != parameter.length:
            raise ValueError
        return items

    return check_array


def _pins(parameter: Parameter, value: Any) -> Any:
    if value is None or isinstance(value, str):
        return value
    return tuple(_whole(parameter, item) for item in value)


_CHECKS = {
    "bool": _flag,
    "integer": _whole,
    "double": _number,
    "string": _text,
    "path": _path,
    "string_array": _array(_text),
    "double_array": _array(_number),
    "integer_array": _array(_whole),
    "pins": _pins,
}
