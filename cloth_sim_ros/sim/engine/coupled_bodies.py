# SPDX-License-Identifier: Apache-2.0
"""Objects that touch or are sewn, advanced in step: all end a substep before any begins the next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from cloth_sim_ros.sim.engine.batch import Batch
from cloth_sim_ros.sim.engine.in_step import InStep
from cloth_sim_ros.sim.executors.graph import Graph, Meeting, Member
from cloth_sim_ros.sim.features.seams.sew import Sewing
from cloth_sim_ros.sim.features.self_contact.ccd_clamp import ccd_clamp
from cloth_sim_ros.sim.features.self_contact.early_out import early_out
from cloth_sim_ros.sim.features.self_contact.search import Search
from cloth_sim_ros.sim.features.self_contact.solve import contact_solve
from cloth_sim_ros.sim.features.self_contact.surfaces import members_of
from cloth_sim_ros.sim.kernels.cooperative import cooperative_group_of
from cloth_sim_ros.sim.topology import Topology


class CoupledBodies:
    """Batches of objects that touch or are sewn.

    topologies: by name. itself: names of objects with self contact. among: True if objects have contact with one
    another.
    """

    def __init__(
        self, batches: Sequence[Batch], topologies: Mapping[str, Topology], itself: Sequence[str], among: bool
    ) -> None:
        self._device = batches[0].device
        self._touching = [batch for batch in batches if batch.features.coupled]
        self._names = [name for batch in self._touching for name in batch.index]
        self._search: Search | None = None
        meeting = self._meet(topologies, itself, among) if self._touching else None
        stages = [Member(batch.features, batch.worlds, self._device) for batch in batches]
        graph = Graph(stages, meeting, self._sew(batches, topologies))
        for batch in batches:
            batch.executor = graph
        self.in_step = InStep(batches, graph)

    def _meet(self, topologies: Mapping[str, Topology], itself: Sequence[str], among: bool) -> Meeting:
        """Contact between the objects that touch."""
        by_itself = [name in itself for name in self._names]
        each = {name: topologies[name] for name in self._names}
        members = members_of([batch.worlds for batch in self._touching], each, by_itself, among, self._device)
        group = cooperative_group_of(members.worlds, self._device)
        self._search = Search(members, group, self._device)
        pairs = self._search.pairs
        velocities, clamp = ccd_clamp(members, pairs, group, self._device)
        begin = [velocities, *early_out(members, pairs, self._device)]
        solve = contact_solve(members, pairs, group, self._device)
        return Meeting(
            [pairs.sums.zero_, *(each.launch for each in begin)], self._search.look, solve.launch, clamp.launch
        )

    def _sew(self, batches: Sequence[Batch], topologies: Mapping[str, Topology]) -> Sewing | None:
        """Seams of the objects that are sewn, if any is."""
        sewn = [batch for batch in batches if batch.features.sewn]
        if not sewn:
            return None
        homes = {name: (k, b) for k, batch in enumerate(sewn) for name, b in batch.index.items()}
        orders = [batch.features.order for batch in sewn]
        return Sewing([batch.worlds for batch in sewn], orders, homes, topologies, self._device)

    def report(self, world: int) -> dict[str, dict[str, int]]:
        """Name -> pairs and pairs_lost of all objects of a world together, and crossings of this object."""
        if self._search is None:
            return {}
        pairs, lost = self._search.found(world)
        each = zip(self._names, self._search.crossings(world), strict=True)
        return {name: {"pairs": pairs, "pairs_lost": lost, "crossings": crossings} for name, crossings in each}
