# SPDX-License-Identifier: Apache-2.0
"""A volume of signed distances on a grid; its size is the grid's spacing."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any
from zipfile import BadZipFile

import numpy as np
import warp as wp
from numpy.lib.npyio import NpzFile

from cloth_sim_ros import parameters as table
from cloth_sim_ros.sim.colliders.baking import CELLS, bake
from cloth_sim_ros.sim.colliders.collider import Collider, Solid, lengths
from cloth_sim_ros.sim.colliders.mesh import Mesh
from cloth_sim_ros.sim.colliders.on_device import OnDevice, content_of, shared
from cloth_sim_ros.sim.input.regular_file import open_regular
from cloth_sim_ros.sim.kernels.intrinsics import load_number
from cloth_sim_ros.sim.mesh_file import FORMATS, absent, local_path
from cloth_sim_ros.sim.physics.quaternion import Vector

_HEAD = 7  # numbers before the values: the number of values along each axis, the origin, and the width
_MOST = 1 << 24  # largest number of values
_MOST_BYTES = 8 * _MOST + (1 << 16)  # largest size of an array in a file [bytes]
_STEEPER = 1.05  # largest slope of the values; a distance has at most 1, but files may be rounded
_MOST_CELLS = 40  # along an axis, as it is drawn
_IN_FILE = ("values", "origin", "spacing")


@wp.func
def signed_distance(p: wp.vec3, size: wp.vec3, data: wp.uint64) -> wp.vec4:
    """Outward normal (x, y, z) and signed distance [m], positive outside, of local point p [m].

    Beyond the bounds, at b from their nearest point q, it is sqrt(b^2 + d(q)^2): the surface lies within the bounds,
    and these are convex, so that it is nowhere nearer.
    """
    at = wp.vec3(0.0)
    part = wp.vec3(0.0)
    beyond = wp.vec3(0.0)
    for k in range(3):
        last = load_number(data, k) - 1.0
        cells = (p[k] - load_number(data, 3 + k)) / size[k]
        inside = wp.clamp(cells, 0.0, last)
        at[k] = wp.min(wp.floor(inside), last - 1.0)
        part[k] = inside - at[k]
        beyond[k] = (cells - inside) * size[k]
    wide, high = int(load_number(data, 2)), int(load_number(data, 1))
    first = wp.static(_HEAD) + (int(at[0]) * high + int(at[1])) * wide + int(at[2])
    value = float(0.0)
    slope = wp.vec3(0.0)
    for corner in range(8):
        i, j, k = corner / 4, corner / 2 % 2, corner % 2
        v = load_number(data, first + (i * high + j) * wide + k)
        x = wp.where(i == 1, part[0], 1.0 - part[0])
        y = wp.where(j == 1, part[1], 1.0 - part[1])
        z = wp.where(k == 1, part[2], 1.0 - part[2])
        value += x * y * z * v
        slope += v * wp.vec3(float(2 * i - 1) * y * z, float(2 * j - 1) * x * z, float(2 * k - 1) * x * y)
    n = wp.cw_div(slope, size)
    steep = wp.length(n)
    n = wp.where(steep > 1.0e-6, n / wp.max(steep, 1.0e-6), wp.vec3(0.0, 0.0, 1.0))
    distance = value
    square = wp.length_sq(beyond)
    if square > 0.0:
        distance = wp.max(value, 0.0)
        n = beyond + distance * n
        distance = wp.sqrt(square + distance * distance)
        n = wp.normalize(n)
    return wp.vec4(n[0], n[1], n[2], distance)


@wp.func
def width(data: wp.uint64) -> float:
    """Twice the volume over the surface [m]."""
    return load_number(data, wp.static(_HEAD - 1))


@dataclass(frozen=True)
class SignedDistance(Collider):
    """A solid given by its signed distances `values` (X, Y, Z) [m] on a grid, negative inside.

    The first value lies at `origin` (x, y, z) [m] in local axes, and neighbours are `spacing` [m] apart, one number or
    three. Values are interpolated between grid points; the solid ends at the bounds. `file` is a mesh of it for
    viewers, in units of `scale` [m].
    """

    values: Any = field(default=(), repr=False, compare=False)
    origin: Vector = (0.0, 0.0, 0.0)
    spacing: Vector | float = (0.01, 0.01, 0.01)
    file: str = ""
    scale: float = 1.0
    content: str = field(init=False, default="", repr=False)
    dimensions = (
        replace(table.row(table.COLLIDER, "position"), name="origin"),
        replace(lengths("spacing"), live=False),
    )
    distance = signed_distance
    width = width

    def __post_init__(self) -> None:
        if np.ndim(self.spacing) == 0:
            object.__setattr__(self, "spacing", (self.spacing,) * 3)
        super().__post_init__()
        values = _checked(self.values, np.array(self.spacing))
        values.setflags(write=False)
        object.__setattr__(self, "values", values)
        object.__setattr__(self, "content", content_of(values))

    @classmethod
    def from_file(cls, file: str, scale: float = 1.0, **fields: Any) -> SignedDistance:
        """Read `values`, `origin` and `spacing` from an .npz file, or bake any other file that `Mesh.from_file` reads.

        scale: length of a unit in the file [m]. Raises ValueError.
        """
        file = str(file)
        if not file.endswith(".npz"):
            return cls.from_mesh(Mesh.from_file(file, scale), **fields)
        wrong, path = f"SignedDistance.from_file is {table.shown(file)}", local_path(file, "SignedDistance.from_file")
        try:
            with open_regular(path) as opened, NpzFile(opened) as arrays:
                if any(info.file_size > _MOST_BYTES for info in arrays.zip.infolist()):
                    raise ValueError(f"it has arrays of more than {_MOST} values")
                if not set(_IN_FILE) <= set(arrays.files):
                    raise ValueError(f"{wrong}, which has {arrays.files}; allowed is one with {list(_IN_FILE)}")
                values, origin, spacing = (np.asarray(arrays[name], np.float64) * scale for name in _IN_FILE)
        except FileNotFoundError:
            raise ValueError(f"{wrong}; {absent(path, f'.npz, {FORMATS}')}") from None
        except Exception as error:  # whatever NumPy and zipfile raise, the user gets one sentence
            if wrong in str(error):
                raise
            why = "it is no .npz file of numbers" if isinstance(error, BadZipFile) else error
            raise ValueError(f"{wrong}, which cannot be read: {why}") from None
        spacing = spacing.item() if spacing.size == 1 else tuple(spacing.ravel().tolist())
        return cls(values=values, origin=tuple(origin.ravel().tolist()), spacing=spacing, **fields)

    @classmethod
    def from_mesh(cls, mesh: Mesh, cells: int = CELLS, **fields: Any) -> SignedDistance:
        """The signed distance of a mesh, by `cells` along its longest side; computed once and then kept on disk.

        fields: those of Collider, which the mesh does not pass on. Raises ValueError.
        """
        if not isinstance(mesh, Mesh):
            raise ValueError(f"SignedDistance.from_mesh is given {mesh!r:.80}; allowed is a Mesh")
        values, origin, spacing = bake(mesh, cells)
        kept = {"file": mesh.file, "scale": mesh.scale, **fields}
        return cls(values=values, origin=origin, spacing=spacing, **kept)

    def solids(self) -> list[Solid]:
        """The cells along the surface, at most _MOST_CELLS along an axis."""
        step = -(-max(self.values.shape) // _MOST_CELLS)
        inside = self.values[::step, ::step, ::step] < 0.0
        share = np.lib.stride_tricks.sliding_window_view(inside, (2, 2, 2)).mean(axis=(3, 4, 5))
        spacing = step * np.array(self.spacing)
        cells = self.origin + spacing * (np.argwhere((share > 0.0) & (share < 1.0)) + 0.5)
        return [Solid("cells", tuple(spacing.tolist()), points=cells, file=self.file, unit=self.scale)]

    def size(self) -> tuple[float, float, float]:
        """spacing [m]."""
        return self.spacing

    def reach(self) -> float:
        """Upper bound of the distance to the farthest solid point [m]."""
        solid = np.argwhere(self.values < 0.0) * np.array(self.spacing) + self.origin
        return float(np.linalg.norm(solid, axis=1).max() + np.linalg.norm(self.spacing))

    def data(self, device: wp.Device) -> OnDevice:
        """The grid and its values."""

        def make() -> OnDevice:
            head = [*self.values.shape, *self.origin, _width_of(self.values < 0.0, np.array(self.spacing))]
            numbers = np.concatenate([head, self.values.ravel()]).astype(np.float32)
            return OnDevice(wp.array(numbers, dtype=float, device=device))

        return shared(f"volume {self.content} {self.origin}", device, make)


def _width_of(inside: np.ndarray, spacing: np.ndarray) -> float:
    """Twice the volume over the surface [m], counted in cells."""
    faces = [np.count_nonzero(np.diff(inside, axis=axis)) / spacing[axis] for axis in range(3)]
    return 2.0 * np.count_nonzero(inside) / max(sum(faces), 1.0)


def _checked(values: Any, spacing: np.ndarray) -> np.ndarray:
    """Return `values` as a new (X, Y, Z) float32 array. Raises ValueError if they cannot be signed distances."""
    try:
        values = np.array(values, np.float32)
    except (TypeError, ValueError):
        values = np.zeros(0, np.float32)
    if values.ndim != 3 or min(values.shape) < 2 or values.size > _MOST or not np.isfinite(values).all():
        raise ValueError(
            f"SignedDistance.values has shape {values.shape}; allowed are finite numbers, at least 2 along each of 3 "
            f"axes and {_MOST} in all"
        )
    if values.min() >= 0.0:
        raise ValueError(f"SignedDistance.values are at least {values.min():g}; allowed are some below 0, inside")
    for axis in range(3):
        steepest = float(np.abs(np.diff(values, axis=axis)).max() / spacing[axis])
        if steepest > _STEEPER:
            raise ValueError(
                f"SignedDistance.values change by {steepest:.3g} m a metre along axis {axis}; allowed is 1, as of "
                "distances"
            )
    return values
