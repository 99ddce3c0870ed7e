# SPDX-License-Identifier: Apache-2.0
"""Run many combinations, those with the same kernels one after another, in one process or in several."""

from __future__ import annotations

import itertools
import multiprocessing
from collections.abc import Callable

import warp as wp

from cloth_sim_ros.sim import Rope
from cloth_sim_ros.sim.colliders import shapes_of
from cloth_sim_ros.study.hard.bodies import BODY, bends_by_angles
from cloth_sim_ros.study.hard.judge import METHODS, Combination, Verdict, judge, make_trial

Numbered = tuple[int, Combination]


def kernels_of(combination: Combination) -> tuple:
    """Return the properties of a combination that select its kernels; equal ones compile once."""
    scene = make_trial(combination).scene
    body, shapes = scene.objects[BODY], shapes_of(scene.colliders.values())
    method = METHODS[combination.method]
    bends = bends_by_angles(body), getattr(body, "bending", "") == "dihedral" and body.bend_compliance is not None
    return isinstance(body, Rope), bends, *method.values(), shapes, scene.wind is not None


def grouped(every: list[Combination]) -> list[list[Numbered]]:
    """Return numbered combinations in groups that share kernels, the largest group first."""
    groups: dict[tuple, list[Numbered]] = {}
    for number, combination in enumerate(every):
        groups.setdefault(kernels_of(combination), []).append((number, combination))
    return sorted(groups.values(), key=len, reverse=True)


def run_all(groups: list[list[Numbered]], device: str, jobs: int, done: Callable[[Combination, Verdict], None]) -> dict:
    """Return number -> verdict of all combinations.

    Args:
        groups: Combinations, a group to a process.
        device: Where they run.
        jobs: Number of processes.
        done: Called with each combination and its verdict when it is known.
    """
    found: dict[int, Verdict] = {}
    if jobs == 1:
        for number, combination in itertools.chain(*groups):
            found[number] = judge(combination, device)
            done(combination, found[number])
        return found
    combinations = dict(itertools.chain(*groups))
    with multiprocessing.get_context("spawn").Pool(jobs, quietly) as pool:
        for some in pool.imap_unordered(_judge_group, [(group, device) for group in groups]):
            for number, verdict in some:
                found[number] = verdict
                done(combinations[number], verdict)
    return found


def quietly() -> None:
    """Silence Warp's reports of kernels, as each process begins."""
    wp.config.log_level = wp.LOG_WARNING


def _judge_group(task: tuple[list[Numbered], str]) -> list[tuple[int, Verdict]]:
    group, device = task
    return [(number, judge(combination, device)) for number, combination in group]
