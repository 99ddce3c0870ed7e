# SPDX-License-Identifier: Apache-2.0
"""A film as one glTF 2.0 file: for each object a morph target a frame, for each collider keyframes of a node."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pygltflib as gltf
from trimesh import Trimesh

from cloth_sim_ros.record.film import Film

CLOTH, STEEL = (0.18, 0.44, 0.69, 1.0), (0.6, 0.62, 0.68, 1.0)
UPRIGHT = [-math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)]  # glTF has y up


class _File:
    """A file under construction: arrays become accessors of one buffer."""

    def __init__(self):
        self.file, self._bytes = gltf.GLTF2(), bytearray()

    def put(self, array: np.ndarray, kind: str, target: int | None = None) -> int:
        """Add an array of float32 or uint32; return its accessor."""
        data = np.ascontiguousarray(array, np.uint32 if array.dtype.kind in "iu" else np.float32)
        self.file.bufferViews.append(
            gltf.BufferView(buffer=0, byteOffset=len(self._bytes), byteLength=data.nbytes, target=target)
        )
        self._bytes += data.tobytes()
        rows = data.reshape(len(data), -1)
        self.file.accessors.append(
            gltf.Accessor(
                bufferView=len(self.file.bufferViews) - 1,
                componentType=gltf.UNSIGNED_INT if data.dtype == np.uint32 else gltf.FLOAT,
                count=data.size if kind == gltf.SCALAR else len(data),
                type=kind,
                min=[data.min().item()] if kind == gltf.SCALAR else rows.min(axis=0).tolist(),
                max=[data.max().item()] if kind == gltf.SCALAR else rows.max(axis=0).tolist(),
            )
        )
        return len(self.file.accessors) - 1

    def mesh(self, name: str, vertices: np.ndarray, normals: np.ndarray, triangles: np.ndarray, material: int) -> int:
        """Add a mesh with vertices and normals (T, V, 3), of which the first is the shape at rest; return its node."""
        base = gltf.Attributes(
            POSITION=self.put(vertices[0], gltf.VEC3, gltf.ARRAY_BUFFER),
            NORMAL=self.put(normals[0], gltf.VEC3, gltf.ARRAY_BUFFER),
        )
        targets = [
            {"POSITION": self.put(v - vertices[0], gltf.VEC3), "NORMAL": self.put(n - normals[0], gltf.VEC3)}
            for v, n in zip(vertices[1:], normals[1:], strict=True)
        ]
        indices = self.put(triangles.ravel(), gltf.SCALAR, gltf.ELEMENT_ARRAY_BUFFER)
        part = gltf.Primitive(attributes=base, indices=indices, material=material, targets=targets)
        self.file.meshes.append(gltf.Mesh(name=name, primitives=[part], weights=[0.0] * len(targets)))
        self.file.nodes.append(gltf.Node(name=name, mesh=len(self.file.meshes) - 1))
        return len(self.file.nodes) - 1

    def animate(self, node: int, path: str, times: int, values: int) -> None:
        """Animate a node's `path` (weights, translation or rotation) with values at times, both accessors."""
        motion = self.file.animations[0]
        motion.samplers.append(gltf.AnimationSampler(input=times, output=values, interpolation=gltf.ANIM_LINEAR))
        target = gltf.AnimationChannelTarget(node=node, path=path)
        motion.channels.append(gltf.AnimationChannel(sampler=len(motion.samplers) - 1, target=target))

    def save(self, path: Path) -> None:
        """Write the file as .glb."""
        self.file.buffers.append(gltf.Buffer(byteLength=len(self._bytes)))
        self.file.set_binary_blob(bytes(self._bytes))
        self.file.save_binary(str(path))


def write_glb(film: Film, path: Path) -> None:
    """Write `film`; between frames a viewer interpolates linearly."""
    out = _File()
    for name, colour in (("cloth", CLOTH), ("collider", STEEL)):
        paint = gltf.PbrMetallicRoughness(baseColorFactor=list(colour), metallicFactor=0.0, roughnessFactor=0.8)
        out.file.materials.append(gltf.Material(name=name, pbrMetallicRoughness=paint, doubleSided=True))
    out.file.animations.append(gltf.Animation(name="recording"))
    times = out.put(film.times, gltf.SCALAR)
    nodes = []
    for name, shape in film.objects.items():
        normals = np.stack([_normals(each, shape.triangles) for each in shape.vertices])
        nodes.append(out.mesh(name, shape.vertices, normals, shape.triangles, material=0))
        weights = np.eye(len(film.times))[:, 1:]  # frame k is target k - 1, and the first is the mesh itself
        out.animate(nodes[-1], "weights", times, out.put(weights.ravel(), gltf.SCALAR))
    for name, body in film.colliders.items():
        normals = _normals(body.vertices, body.triangles)
        nodes.append(out.mesh(name, body.vertices[None], normals[None], body.triangles, material=1))
        node = out.file.nodes[nodes[-1]]  # whose place at the start is for readers that do not play
        node.translation, node.rotation = body.positions[0].tolist(), body.orientations[0].tolist()
        out.animate(nodes[-1], "translation", times, out.put(body.positions, gltf.VEC3))
        out.animate(nodes[-1], "rotation", times, out.put(body.orientations, gltf.VEC4))
    out.file.nodes.append(gltf.Node(name="world", rotation=UPRIGHT, children=nodes))
    out.file.scenes.append(gltf.Scene(nodes=[len(out.file.nodes) - 1]))
    out.file.scene = 0
    out.file.asset = gltf.Asset(generator="cloth_sim_ros", version="2.0")
    out.save(path)


def _normals(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return unit normals (V, 3) at the vertices."""
    normals = np.array(Trimesh(vertices, triangles, process=False).vertex_normals)
    normals[np.linalg.norm(normals, axis=1) < 0.5] = (0.0, 0.0, 1.0)  # of what has no area
    return normals
