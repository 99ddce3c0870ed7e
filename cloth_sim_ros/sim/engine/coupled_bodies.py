# SPDX-License-Identifier: Apache-2.0
"""Objects in contact with one another or themselves, advanced in step: all end a substep before any begins the next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from cloth_sim_ros.sim.engine.batch import Batch
from cloth_sim_ros.sim.engine.in_step import InStep
from cloth_sim_ros.sim.executors.graph import Graph, Member
from cloth_sim_ros.sim.features.self_contact.ccd_clamp import CcdClamp
from cloth_sim_ros.sim.features.self_contact.early_out import EarlyOut
from cloth_sim_ros.sim.features.self_contact.search import Search
from cloth_sim_ros.sim.features.self_contact.solve import ContactSolve
from cloth_sim_ros.sim.features.self_contact.surfaces import members_of
from cloth_sim_ros.sim.kernels.cooperative import cooperative_group_of
from cloth_sim_ros.sim.topology import Topology


class CoupledBodies:
    """Batches of coupled objects.

    topologies: by name. itself: names of objects with self contact. among: True if objects have contact with one
    another.
    """

    def __init__(
        self, batches: Sequence[Batch], topologies: Mapping[str, Topology], itself: Sequence[str], among: bool
    ) -> None:
        device = batches[0].device
        self._names = [name for batch in batches for name in batch.index]
        by_itself = [name in itself for name in self._names]
        each = [topologies[name] for name in self._names]
        members = members_of([batch.worlds for batch in batches], each, by_itself, among, device)
        group = cooperative_group_of(members.worlds, device)
        self._search = Search(members, group, device)
        pairs = self._search.pairs
        early_out = EarlyOut(members, pairs, device)
        solve, clamp = (kind(members, pairs, group, device) for kind in (ContactSolve, CcdClamp))
        stages = [Member(batch.features, batch.worlds, device) for batch in batches]
        graph = Graph(stages, (early_out, self._search, solve, clamp))
        for batch in batches:
            batch.executor = graph
        self.in_step = InStep(batches, graph)

    def report(self, world: int) -> dict[str, dict[str, int]]:
        """Name -> pairs and pairs_lost of all objects of a world together, and crossings of this object."""
        pairs, lost = self._search.found(world)
        each = zip(self._names, self._search.crossings(world), strict=True)
        return {name: {"pairs": pairs, "pairs_lost": lost, "crossings": crossings} for name, crossings in each}
