# SPDX-License-Identifier: Apache-2.0
"""The subdomains of a batch on the device, and how large and how deep they are best (see subdomains.py)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from cloth_sim_ros.sim.executors.buffers import piece_memory
from cloth_sim_ros.sim.executors.halo_exchange import run_at_once
from cloth_sim_ros.sim.executors.subdomain_around import Around, all_around
from cloth_sim_ros.sim.model import Features, Model
from cloth_sim_ros.sim.state import Arrays, Sweep
from cloth_sim_ros.sim.topology.subdomains import Partition, cut, surround

PLACES = 4096  # a packed spring is a place in the subdomain, below this, and this times a type
IN_REGISTERS = 16  # springs around a particle, up to which their places and numbers stay in registers
WIDEST = 32  # springs around a particle
THREADS = 1024  # of a block; each has one member of a subdomain
DEEPEST = 9  # substeps for which a halo lasts
SWEPT = 32  # substeps whose colliders' motion is computed at a time
_TYPES = (1 << 31) // PLACES
# Microseconds on an H200: a launch with its loads and stores, an exchange within one, a substep however small, and a
# spring. A spring counts for every warp, with one warp on each of the four schedulers.
_LAUNCH, _EXCHANGE, _LEAST, _A_SPRING = 3.5, 0.65, 0.05, 0.028
_SCHEDULERS = 4
_OUTER = 8.0  # substeps between slow forces for which subdomains are planned; how many it will be may change live
OUTSIDE = 1 << 30  # ring of a place without a member
_WHOLE_FRAME = 1 << 30  # substeps a launch of bodies of one subdomain, which have no halo
_BYTES_A_MEMBER = 120  # positions, low parts and velocities of two substeps, and a gap after every fourth member


@wp.struct
class SubdomainArrays:
    """All T subdomains of a batch, each of C places (`capacity`) and B threads, and the second buffer of what they
    exchange."""

    body: wp.array(dtype=int)  # (T,)
    places: wp.array(dtype=int)  # (T B,) the place of each thread
    members: wp.array(dtype=int)  # (T C,) particles, counted in the batch
    rings: wp.array(dtype=int)  # (T C,) rings from the subdomain's own particles, OUTSIDE without a member
    incident_springs: wp.array(dtype=int)  # (T W C,) place of the other particle + PLACES x type
    panels: wp.array(dtype=int)  # (T P C,) places of the other corners, and which corner the member is, 3 for no panel
    plate: wp.array(dtype=wp.vec2)  # (T Q C,) place of a neighbour in the operator of bending, and its weight [1/m^2]
    positions: wp.array(dtype=wp.vec4)  # (worlds N,)
    low: wp.array(dtype=wp.vec4)  # (worlds N,)
    velocities: wp.array(dtype=wp.vec4)  # (worlds N,)
    messages: wp.array(dtype=wp.vec4)  # (2 x 3 worlds N,) where subdomains wait for one another (see halo_exchange.py)
    sent: wp.array(dtype=int)  # (1,) substeps of all frames so far, by which messages are numbered
    sweeps: wp.array(dtype=Sweep)  # (worlds T SWEPT K,)
    contacts: wp.array(dtype=wp.vec4)  # (worlds T C K,)
    forces: wp.array(dtype=wp.vec4)  # (worlds T C K,) of colliders in this frame so far [N]


class Unfit(ValueError):
    """Subdomains cannot serve a batch; the message says why."""

    def __init__(self, reason: str, allowed: str):
        super().__init__(f"the executor 'subdomains' is forced with {reason}; allowed is {allowed}")


@dataclass(frozen=True)
class Plan:
    """Partitions of all bodies and what lies around their particles. depth: substeps for which a halo lasts. cost:
    estimated microseconds a substep. waits: whether subdomains wait for one another within a launch, instead of having
    a launch each time."""

    partitions: list[Partition]
    around: list[Around]
    depth: int
    cost: float
    waits: bool

    @property
    def threads(self) -> int:
        """Threads of a subdomain: one for each of its members, rounded up to whole warps."""
        return -(-max(int(partition.ends[:, -1].max()) for partition in self.partitions) // 32) * 32

    @property
    def capacity(self) -> int:
        """Places of a subdomain; the last is for threads without a member."""
        return max(int(partition.places.max()) for partition in self.partitions) + 2


def plan(
    features: Features,
    model: Model,
    layouts: list[np.ndarray],
    worlds: int,
    device: wp.Device,
    size: int | None = None,
    depth: int | None = None,
    waits: bool | None = None,
) -> Plan:
    """The subdomains of `size` particles and `depth` rings for bodies of `layouts`, or those estimated to be fastest.

    waits: within a launch for one another; None: where they can. Raises Unfit where there are none.
    """
    if features.method != "verlet":
        raise Unfit("method 'xpbd'", "method 'verlet'")
    if features.forces:
        raise Unfit("forces of the scene's own", "weight, springs, bending and air")
    if features.handles:
        raise Unfit("handles", "a scene without them")
    if features.surface:
        raise Unfit("colliders that reach between particles", "rounder ones, or a finer sheet")
    if features.curved:
        raise Unfit("a sheet that resists bending and is curved at rest", "one that is flat at rest")
    around = all_around(model, features)
    if around[0].types.shape[1] > WIDEST:
        raise Unfit(f"more than {WIDEST} springs at a particle", "fewer")
    if model.spring_types.shape[0] > _TYPES:
        raise Unfit(f"more than {_TYPES} kinds of springs", "fewer")
    plans = [_whole(around, worlds, device)] if size is None and max(map(len, layouts)) <= THREADS else []
    subdomains = [cut(layout, size or _usual_size(model, worlds, device)) for layout in layouts]
    if not plans or max(subdomain.max() for subdomain in subdomains) > 0:
        plans += _deep(subdomains, around, depth, worlds, device, waits)
    return min(plans, key=lambda one: one.cost)


def _whole(around: list[Around], worlds: int, device: wp.Device) -> Plan:
    """One subdomain a body."""
    partitions = [surround(np.zeros(len(each.others), dtype=np.int64), each.others, 1) for each in around]
    return Plan(partitions, around, _WHOLE_FRAME, _substeps_cost(partitions, 1, worlds, device), False)


def _deep(
    subdomains: list[np.ndarray],
    around: list[Around],
    depth: int | None,
    worlds: int,
    device: wp.Device,
    waits: bool | None,
) -> list[Plan]:
    """Subdomains with halos of `depth` rings or of any number that fits a block. Raises Unfit where none does."""

    def halos(rings: int) -> list[Partition]:
        return [surround(subdomain, each.others, rings) for subdomain, each in zip(subdomains, around, strict=True)]

    deepest = halos(depth or DEEPEST)
    largest = np.max([partition.ends.max(axis=0) for partition in deepest], axis=0)
    room = piece_memory(device) // _BYTES_A_MEMBER
    reach = max(each.reach for each in around)
    depths = [d for d in range(1 + reach, len(largest)) if largest[d] <= min(room, THREADS)]
    needed = depth or 1 + reach
    if not depths or depth not in (None, *depths):
        raise Unfit(
            f"subdomains of {largest[0]} particles that have {largest[min(needed, len(largest) - 1)]} with halos of "
            f"{needed} rings, of which a substep uses up to {1 + reach}",
            f"at most {min(room, THREADS)} on {device.alias}",
        )
    able = waits is not False and run_at_once(worlds * sum(len(partition.ends) for partition in deepest), device)
    ways = [(d, wait) for d in depths for wait in {False, able} if depth in (None, d)]
    rings = 1.0 + reach / _OUTER
    costs = {
        (d, wait): (rings * (_EXCHANGE if wait else _LAUNCH) + _substeps_cost(deepest, d, worlds, device)) / d
        for d, wait in ways
    }
    chosen, wait = min(costs, key=costs.get)
    partitions = deepest if chosen == len(largest) - 1 else halos(chosen)
    return [Plan(partitions, around, chosen, costs[chosen, wait], wait)]


def _substeps_cost(partitions: list[Partition], depth: int, worlds: int, device: wp.Device) -> float:
    """Rough microseconds on an H200 that `depth` substeps from one halo take, bound by latency and instructions."""
    width = max(partition.incident_springs.shape[1] for partition in partitions)
    warps = np.ceil(np.max([partition.ends.max(axis=0) for partition in partitions], axis=0)[:depth] / 32.0)
    load = max(1.0, worlds * sum(len(partition.ends) for partition in partitions) / _multiprocessors(device))
    return float((_LEAST + width * _A_SPRING * np.ceil(load * warps / _SCHEDULERS)).sum())


def _usual_size(model: Model, worlds: int, device: wp.Device) -> int:
    """Particles of a subdomain, such that every multiprocessor has at most one: a power of two of them halve evenly."""
    particles = worlds * sum(body[3] for body in model.bodies.numpy().tolist())
    subdomains = 1 << (_multiprocessors(device).bit_length() - 1)
    return int(np.clip(-(-particles // subdomains), 32, 512))


def _multiprocessors(device: wp.Device) -> int:
    return device.sm_count if device.is_cuda else 1


def upload(chosen: Plan, worlds: list[Arrays], features: Features, device: wp.Device) -> SubdomainArrays:
    """The subdomains of all bodies on the device, with the second buffer of all worlds behind one another, and
    messages."""
    arrays = worlds[0]
    capacity, threads = chosen.capacity, chosen.threads
    body, parts = [], {"places": [], "members": [], "rings": [], "incident_springs": [], "panels": [], "plate": []}
    starts = [body[2] for body in arrays.model.bodies.numpy().tolist()]
    for b, (partition, around) in enumerate(zip(chosen.partitions, chosen.around, strict=True)):
        sizes, width = partition.ends[:, -1], around.types.shape[1]
        subdomains = len(sizes)
        body += [b] * subdomains
        first = np.repeat(np.cumsum(sizes) - sizes, sizes)
        nth = np.arange(len(partition.members)) - first
        subdomain = np.repeat(np.arange(subdomains), sizes)
        places = np.full((subdomains, threads), capacity - 1)
        places[subdomain, nth] = partition.places[partition.turns]
        place = partition.places
        members = np.repeat(partition.members[np.cumsum(sizes) - sizes][:, None], capacity, axis=1)
        members[subdomain, place] = partition.members
        rings = np.full((subdomains, capacity), OUTSIDE)
        rings[subdomain, place] = (nth[:, None] >= partition.ends[subdomain]).sum(axis=1)
        inner = partition.members[partition.inner]
        at = (subdomain[partition.inner], slice(None), place[partition.inner])
        around_them = place[first[partition.inner][:, None] + partition.incident_springs]
        plate = np.zeros((subdomains, around.plate.shape[1], capacity, 2))
        plate[at] = _plate_of(partition, around, place, subdomain)
        incident_springs = np.zeros((subdomains, width, capacity), dtype=np.int64)
        incident_springs[at] = around_them[:, :width] + PLACES * around.types[inner]
        panels = np.full((subdomains, around.corners.shape[1], capacity), 3 * PLACES**2)
        panels[at] = around_them[:, width::2] + PLACES * (
            around_them[:, width + 1 :: 2] + PLACES * around.corners[inner]
        )
        parts["places"].append(places.ravel())
        parts["plate"].append(plate.reshape(-1, 2))
        for name, rows in (
            ("members", members + starts[b]),
            ("rings", rings),
            ("incident_springs", incident_springs),
            ("panels", panels),
        ):
            parts[name].append(rows.ravel())
    found = SubdomainArrays()
    found.body = wp.array(np.array(body, dtype=np.int32), dtype=int, device=device)
    found.plate = wp.array(np.concatenate(parts.pop("plate")).astype(np.float32), dtype=wp.vec2, device=device)
    for name, rows in parts.items():
        setattr(found, name, wp.array(np.concatenate(rows).astype(np.int32), dtype=int, device=device))
    for name in ("positions", "low", "velocities"):
        size = len(worlds) * getattr(arrays.state, name).shape[0]
        setattr(found, name, wp.zeros(size, dtype=wp.vec4, device=device))
    messages = 6 * found.positions.shape[0] if chosen.waits else 0
    found.messages = wp.zeros(messages, dtype=wp.vec4, device=device)
    found.sent = wp.zeros(1, dtype=int, device=device)
    colliders = arrays.colliders.shape[0] if features.shapes else 0
    found.sweeps = wp.zeros(len(worlds) * len(body) * SWEPT * colliders, dtype=Sweep, device=device)
    met = len(worlds) * len(body) * capacity * colliders
    found.contacts, found.forces = (wp.zeros(met, dtype=wp.vec4, device=device) for _ in range(2))
    return found


def _plate_of(partition: Partition, around: Around, place: np.ndarray, subdomain: np.ndarray) -> np.ndarray:
    """Places of the neighbours in the operator of bending of all inner members, and their weights (M, Q, 2).

    Neighbours that lie outside of the subdomain are needed by no member that is still valid; they weigh nothing.
    """
    count = len(around.others)
    key = subdomain * count + partition.members
    order = np.argsort(key)
    inner = partition.members[partition.inner]
    wanted = subdomain[partition.inner][:, None] * count + around.plate[inner]
    slot = np.minimum(np.searchsorted(key[order], wanted), len(key) - 1)
    found = order[slot]
    there = key[found] == wanted
    return np.stack([np.where(there, place[found], 0), np.where(there, around.weights[inner], 0.0)], axis=2)
