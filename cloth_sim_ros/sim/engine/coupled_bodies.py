# SPDX-License-Identifier: Apache-2.0
"""Objects that touch one another, or themselves, advance together: all end a substep before any begins the next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from cloth_sim_ros.sim.engine.batch import Batch
from cloth_sim_ros.sim.executors.graph import Graph, Member
from cloth_sim_ros.sim.features.self_contact.ccd_clamp import Bound
from cloth_sim_ros.sim.features.self_contact.early_out import Flat
from cloth_sim_ros.sim.features.self_contact.search import Search
from cloth_sim_ros.sim.features.self_contact.solve import Apart
from cloth_sim_ros.sim.features.self_contact.surfaces import members_of
from cloth_sim_ros.sim.kernels.cooperative import crew_of
from cloth_sim_ros.sim.topology import Topology


class Together:
    """Batches of such objects.

    topologies: by name. itself: names of those that are kept apart from themselves. among: whether all are kept apart
    from one another.
    """

    def __init__(
        self, batches: Sequence[Batch], topologies: Mapping[str, Topology], itself: Sequence[str], among: bool
    ) -> None:
        self.batches, device = batches, batches[0].device
        self._names = [name for batch in batches for name in batch.index]
        by_itself = [name in itself for name in self._names]
        each = [topologies[name] for name in self._names]
        members = members_of([batch.worlds for batch in batches], each, by_itself, among, device)
        crew = crew_of(members.worlds, device)
        self._search = Search(members, crew, device)
        flat = Flat(members, self._search.pairs, device)
        apart, bound = (kind(members, self._search.pairs, crew, device) for kind in (Apart, Bound))
        stages = [Member(batch.features, batch.worlds, device) for batch in batches]
        self._graph = Graph(stages, (flat, self._search, apart, bound))
        for batch in batches:
            batch.executor = self._graph

    def advance(self, finer: int = 1) -> None:
        """Simulate one frame of all, as their frames were written last."""
        frame = self.batches[0].frame
        self._graph.advance(finer * frame.substeps, frame.iterations)

    def report(self, world: int) -> dict[str, dict[str, int]]:
        """Name -> pairs and pairs_lost, of all objects of a world together, and crossings of this one."""
        pairs, lost = self._search.found(world)
        each = zip(self._names, self._search.crossings(world), strict=True)
        return {name: {"pairs": pairs, "pairs_lost": lost, "crossings": crossings} for name, crossings in each}
