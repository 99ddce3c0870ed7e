# SPDX-License-Identifier: Apache-2.0
"""Log of the objects while they run: each event once, and again when it is new."""

from __future__ import annotations

import logging
import re
from collections.abc import Mapping
from itertools import combinations
from typing import Any

import numpy as np

from cloth_sim_ros.sim import Simulation

_NUMBER = re.compile(r"\d[\d.e+-]*")


class Forwarded(logging.Handler):
    """Forwards warnings of the simulation, which knows no ROS, to the `log` of the node."""

    def __init__(self, log: Any):
        super().__init__(logging.WARNING)
        self._log = log

    def emit(self, record: logging.LogRecord) -> None:
        """Forward one warning."""
        self._log.warning(record.getMessage())


Report = Mapping[str, dict[str, float]]


class Reported:
    """Remembers what `log` has reported, for all the simulations of a node."""

    def __init__(self, log: Any):
        self._log = log
        self._chosen: dict[str, tuple] = {}  # name -> method, softening and bounds of substeps
        self._reasons: dict[str, set[str]] = {}  # name -> reasons logged for it, without their numbers
        self._waiting: set[str] = set()
        self._stopped: set[str] = set()
        self._deep: set[str] = set()
        self._crossed: set[tuple[str, str]] = set()
        self._recoveries: dict[str, float] = {}
        self._redone: dict[str, float] = {}  # name -> count when it was last logged, so that it is logged rarely
        self._torn: dict[str, float] = {}
        self._broken: dict[str, int] = {}  # seam -> broken stitches
        self._passing = False  # True once it was logged that objects pass through one another

    def say(self, is_good: bool, sentence: str) -> None:
        """Log one sentence, as a warning if it is not good."""
        if is_good:  # a line of code logs with one severity alone
            self._log.info(sentence)
        else:
            self._log.warning(sentence)

    def start(self, sim: Simulation, values: Mapping[str, Any]) -> None:
        """Report a new simulation: how each object is computed, if objects pass through one another, and bad starts.

        A bad start lies in a collider or intersects itself.
        """
        self._chosen.clear()
        self._waiting.clear()
        self.reasons(sim)
        if not (self._passing or sim.scene.object_contact):
            self._tell_passing(sim)
        for name, (deep, way) in sim.moved.items():
            where = f"{deep:.2g} m deep in a collider and was moved out by up to {way:.2g} m"
            self._log.warning(f"{name} starts {where}; start them apart")
        for name, each in sim.report().items():
            if each["max_penetration"] > 1.01 * _half_thickness(name, each, values):
                deep = f"{each['max_penetration']:.2g} m deep in a collider"
                self._log.warning(f"{name} starts {deep}, which pushes it out hard; start them apart")
            if each.get("crossings"):
                self._crossed.add((name, "crossings"))
                edges = f"{each['crossings']} edges"
                self._log.warning(f"{name} intersects itself at the start ({edges}) and may stay so; start it unfolded")

    def _tell_passing(self, sim: Simulation) -> None:
        """Report that two objects pass through one another, if any two may meet."""
        for one, other in combinations(sim.scene.objects, 2):
            if _may_meet(sim, one, other):
                self._passing = True
                remedy = "object_contact is false; true keeps objects apart"
                self._log.info(f"{one} and {other} pass through one another where they meet, as {remedy}")
                return

    def reasons(self, sim: Simulation, with_substeps: bool = True) -> None:
        """Report how each object is computed, if that is chosen, and an error that is missed.

        Without `with_substeps`, a change of only the substeps waits for the next call: a slider sets many in a second.
        Substeps picked within their bounds are not reported, nor is an error that is missed once more.
        """
        for name, choice in sim.choices.items():
            softer = choice.bending_share < 1.0
            chosen = (choice.words, softer, choice.least, choice.most)
            if not with_substeps and self._chosen.get(name, ())[:2] == chosen[:2]:
                continue
            if self._chosen.get(name) != chosen:
                self._chosen[name], self._reasons[name] = chosen, set()
            kind = _NUMBER.sub("", choice.reason)
            if kind not in self._reasons[name] and (softer or sim.settings.method == "auto"):
                self.say(not softer, f"{name} {choice.reason}")
            self._reasons[name].add(kind)

    def waits(self, name: str, why: str) -> None:
        """Report that a parameter acts with the next rebuild, once until then."""
        if name not in self._waiting:
            self._waiting.add(name)
            self._log.info(f"{name} is noted for the next rebuild, it has no effect now: {why}")

    def report(self, report: Report, values: Mapping[str, Any]) -> None:
        """Report the events in a simulation's report that a user should know."""
        self._tell_stopped(report)
        self._tell_deep(report, values)
        self._tell_crossed(report)
        self._tell_torn(report)
        for name, each in report.items():
            more = each["recoveries"] - self._recoveries.get(name, 0)
            if more > 0:
                self._log.warning(f"{name} was not finite or ran away and was put back, at rest, {more} times")
            if each["redone"] >= max(1, 2 * self._redone.get(name, 0)):
                self._redone[name] = each["redone"]
                chosen, remedy = values["solver.substeps"] == 0, "raise solver.substeps, or set it to 0"
                count, were = ("1 frame", "was") if each["redone"] == 1 else (f"{each['redone']} frames", "were")
                again = f"{count} of {name} {were} computed again with more substeps, as it moved hard"
                self.say(chosen, f"{again}; {'nothing need be done' if chosen else remedy}")
        self.know(report)

    def know(self, report: Report) -> None:
        """Take the counts of a report as known, so that they are not reported."""
        self._recoveries = {name: each["recoveries"] for name, each in report.items()}
        self._redone |= {name: each["redone"] for name, each in report.items() if each["redone"] == 0}

    def _tell_stopped(self, report: Report) -> None:
        """Report winches that have reached a limit of their length and still have a rate."""
        stopped = {name for name, each in report.items() if each.get("winch_stopped")}
        for name in stopped - self._stopped:
            limits = "winch.shortest, winch.longest or the rope itself"
            self._log.warning(f"{name}'s winch stopped at {report[name]['paid_out']:.4g} m, a limit set by {limits}")
        self._stopped = stopped

    def _tell_crossed(self, report: Report) -> None:
        """Report objects that intersect themselves, and those with more near pairs than their list holds."""
        remedy = "more substeps or a larger thickness help"
        for key, what in (("crossings", "edges go through it"), ("pairs_lost", "near parts found no room in the list")):
            for name, each in report.items():
                if not each.get(key):
                    self._crossed.discard((name, key))
                elif (name, key) not in self._crossed:
                    self._crossed.add((name, key))
                    self._log.warning(f"{name} is not kept apart from itself: {each[key]} {what}; {remedy}")

    def _tell_torn(self, report: Report) -> None:
        """Report objects that have torn further, and the number of springs that have failed."""
        for name, each in report.items():
            torn = each.get("torn", 0)
            if torn > self._torn.get(name, 0):
                self._log.info(f"{name} is torn: {torn} of its springs have failed")
            self._torn[name] = torn

    def stitches(self, broken: Mapping[str, int], values: Mapping[str, Any]) -> None:
        """Report seams of which more stitches have broken; `broken` has their number for each seam that may break."""
        for seam, count in broken.items():
            if count > self._broken.get(seam, 0):
                why = f"loads were larger than {seam}.strength, {values[f'{seam}.strength']:g} N"
                stitches, are = ("1 stitch", "is") if count == 1 else (f"{count} stitches", "are")
                self._log.info(f"{stitches} of {seam} {are} broken: {why}")
            self._broken[seam] = count

    def _tell_deep(self, report: Report, values: Mapping[str, Any]) -> None:
        """Report objects that colliders enter between particles."""
        for name, each in report.items():
            deep = each["max_penetration"] - each["particle_penetration"]
            if deep <= _half_thickness(name, each, values):
                self._deep.discard(name)
            elif name not in self._deep:
                self._deep.add(name)
                yields = any(values[f"{each}.compliance"] for each in (*values["colliders"], *values["grippers"]))
                remedy = "more substeps, a finer object or a start outside of all colliders help"
                remedy = f"one with a compliance gives way like that; else {remedy}" if yields else remedy
                self.say(yields, f"{name} lies {deep:.2g} m deep in a collider between its particles; {remedy}")


def _may_meet(sim: Simulation, one: str, other: str) -> bool:
    """True if the middles of two objects are no farther apart than both measure, but for a way that they may fall."""
    corners = np.array([[x.min(axis=0), x.max(axis=0)] for x in (sim.positions(one), sim.positions(other))])
    apart, gravity = np.subtract(*corners.mean(axis=1)), np.array(sim.scene.gravity)
    if gravity.any():
        apart -= gravity * (gravity @ apart) / (gravity @ gravity)
    return bool(np.linalg.norm(apart) <= np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1).sum())


def _half_thickness(name: str, each: Mapping[str, float], values: Mapping[str, Any]) -> float:
    """Return the distance [m] at which an object of this row of a report is kept from colliders."""
    return values[f"{name}.{'radius' if 'max_tension' in each else 'thickness'}"]
