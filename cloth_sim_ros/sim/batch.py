"""The device side of all objects that share a kernel: their arrays, their state and the schedule that advances them."""

from __future__ import annotations

import numpy as np
import warp as wp

from cloth_sim_ros.sim.model import Features, ModelArrays
from cloth_sim_ros.sim.schedules.coloured import Coloured
from cloth_sim_ros.sim.schedules.resident import Resident, capacity
from cloth_sim_ros.sim.state import Arrays, LiveArray, Material, make_state
from cloth_sim_ros.sim.topology import Topology


class Batch:
    """Bodies of equal `features`, by name, behind one another in flat arrays.

    Raises ValueError where schedule "resident" is asked for and a body does not fit a block of the device.
    """

    def __init__(
        self,
        topologies: dict[str, Topology],
        features: Features,
        schedule: str,
        frame: LiveArray,
        colliders: LiveArray,
        device: wp.Device,
    ):
        self.features, self.device = features, device
        self.index = {name: b for b, name in enumerate(topologies)}
        self._rest = {name: topology.rest for name, topology in topologies.items()}
        self._inverse_mass = {
            name: np.where(topology.pinned, 0.0, 1.0 / topology.masses) for name, topology in topologies.items()
        }
        collected = ModelArrays(spokes=features.method == "verlet")
        for topology in topologies.values():
            collected.add(topology)
        self.spring_order = collected.spring_order
        self.starts = [body[2] for body in collected.bodies]
        self.counts = [body[3] for body in collected.bodies]
        self.materials = LiveArray(Material, len(topologies), device)
        self.arrays = Arrays()
        self.arrays.model = collected.upload(device)
        self.arrays.state = make_state(collected, features, colliders.array.shape[0], device)
        self.arrays.frames, self.arrays.colliders = frame.array, colliders.array
        self.arrays.materials = self.materials.array
        self.schedule = self._make_schedule(schedule)
        for name in topologies:
            self.reset(name)

    def _make_schedule(self, wanted: str) -> Resident | Coloured:
        largest, limit = max(self.counts), capacity(self.device, self.features)
        if wanted == "resident" and largest > limit:
            raise ValueError(
                f"solver.schedule is 'resident' with a body of {largest} particles; allowed are up to {limit} on "
                f"{self.device.alias}, or schedule 'auto'"
            )
        if wanted == "coloured" or largest > limit:
            return Coloured(self.features, self.arrays, self.device)
        return Resident(self.features, self.arrays, self.device, largest)

    def span(self, name: str) -> slice:
        """Where the particles of a body lie."""
        start = self.starts[self.index[name]]
        return slice(start, start + self.counts[self.index[name]])

    def segments(self, name: str) -> slice:
        """Where the chain segments of a rope lie."""
        if not self.features.chain:
            return slice(0, 0)
        b = self.index[name]
        start = sum(count - 1 for count in self.counts[:b])
        return slice(start, start + self.counts[b] - 1)

    def reset(self, name: str) -> None:
        """Back to the rest shape, at rest."""
        self.write_positions(name, self._rest[name])
        self.write_velocities(name, np.zeros((len(self._rest[name]), 3)))
        self.arrays.state.recoveries[self.index[name] : self.index[name] + 1].zero_()

    def write_positions(self, name: str, positions: np.ndarray) -> None:
        """Positions (N, 3) float64 [m], kept to more digits than float32 has; history and multipliers start anew."""
        high = positions.astype(np.float32)
        state, span = self.arrays.state, self.span(name)
        state.positions[span].assign(np.column_stack([high, self._inverse_mass[name]]).astype(np.float32))
        state.low[span].assign(_padded(positions - high.astype(np.float64)))
        wp.copy(state.good_positions[span], state.positions[span])
        wp.copy(state.good_low[span], state.low[span])
        self._forget(name)

    def write_velocities(self, name: str, velocities: np.ndarray) -> None:
        """Velocities (N, 3) [m/s]; history and multipliers start anew."""
        self.arrays.state.velocities[self.span(name)].assign(_padded(velocities))
        self._forget(name)

    def forget_steps(self) -> None:
        """The length of a substep changed: order 2 starts from its first-order substep again."""
        self.arrays.state.history.zero_()

    def _forget(self, name: str) -> None:
        state, segments = self.arrays.state, self.segments(name)
        if segments.stop > segments.start:
            state.tensions[segments].zero_()
        if self.features.looks_back:
            b = self.index[name]
            state.history[b : b + 1].zero_()


def _padded(rows: np.ndarray) -> np.ndarray:
    return np.pad(rows, ((0, 0), (0, 1))).astype(np.float32)
