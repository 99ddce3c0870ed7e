# SPDX-License-Identifier: Apache-2.0
"""One rope under PBD, under XPBD and in this package, dragged and measured."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cloth_sim_ros.sim import Handle, Rope, Scene, Settings, Simulation
from cloth_sim_ros.study.closed_forms.ropes import hanging_extensions
from cloth_sim_ros.study.relaxation import HangingRope
from cloth_sim_ros.viewer.curves import Curves, make_chart
from cloth_sim_ros.viewer.drawing import COLOURS, STEEL, Drag
from cloth_sim_ros.viewer.scale import PowerSlider, powers
from cloth_sim_ros.viewer.window import Page

SEGMENTS, LENGTH, RADIUS = 24, 1.2, 0.012  # -, [m], [m]
MASS, LOAD = 0.12, 0.03  # [kg] of the rope, and at its end
FRAME = 1.0 / 60.0  # [s]
GRAVITY = 9.81  # [m/s^2]
NAMES = ("PBD", "XPBD", "this package")
PLACES = {name: np.array([x, 0.0, 1.9]) for name, x in zip(NAMES, (-0.6, 0.0, 0.6), strict=True)}  # [m] of the tops
COUNTS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64)  # of iterations that are measured
SETTLE, MEAN = 240, 60  # frames until a rope is taken to hang still, and over which its stretch is averaged
SWING, PERIOD = 0.25, 3.0  # [m], [s] of the tops


def masses() -> np.ndarray:
    """Return the masses of the particles (SEGMENTS + 1,) [kg], from the top."""
    found = np.full(SEGMENTS + 1, MASS / SEGMENTS)
    found[[0, -1]] *= 0.5
    found[-1] += LOAD
    return found


def hanging(compliance: float | None, place: np.ndarray) -> HangingRope:
    """Return a rope of 1/EA `compliance` [1/N], or None for PBD, that hangs from `place` (3,) [m]."""
    segment = LENGTH / SEGMENTS
    each = None if compliance is None else compliance * segment
    return HangingRope(place, masses(), np.full(SEGMENTS, segment), each)


def stretch_at_rest(compliance: float) -> float:
    """Return the relative elongation of a rope of 1/EA `compliance` [1/N] that hangs at rest, by the closed form."""
    constants = np.full(SEGMENTS, SEGMENTS / (compliance * LENGTH))
    return float(hanging_extensions(masses(), constants, GRAVITY).sum() / LENGTH)


class Iterations(Page):
    """Three ropes that are led alike. `stretch` is the relative elongation of each."""

    title = "c. Iterations: PBD and XPBD"
    text = (
        "Three equal ropes with a load, led alike. **PBD** knows no material: how far it stretches is a matter of "
        "iterations. **XPBD** has a compliance and comes to its stretch with enough iterations. **This package** "
        "solves a rope in one go. Drag a rope; turn the iterations up and down."
    )
    camera = ((0.0, -3.6, 1.5), (0.0, 0.0, 1.25))

    def build(self) -> None:
        gui = self.gui
        self.iterations = gui.add_slider("iterations", 1, 64, 1, 4, hint="Sweeps of PBD and XPBD in a step.")
        self.substeps = gui.add_slider("substeps", 1, 20, 1, 1, hint="Steps a frame.")
        self.compliance = PowerSlider(gui, "compliance", powers(1e-5, 0.3), 0.03, " 1/N", "1/EA", self.tell)
        self.swing = gui.add_checkbox("Swing", True)
        self.button("Measure over iterations", self._measure)
        self._numbers = gui.add_markdown("")
        self._curves = Curves(gui, "Stretch [%]", NAMES, span=10.0)
        labels = (*NAMES[:2], "closed form")
        self._chart = make_chart(gui, "Stretch at rest over iterations [%]", "iterations", labels)
        self._measuring: Iterator[None] | None = None
        self.measured: list[tuple[int, float, float]] = []
        self._hand = np.zeros(3)  # [m] by how much the tops are away from their places
        self._time = 0.0
        self._start()
        self._draw_first()

    def _start(self) -> None:
        compliance = self.compliance.value
        tops = {name: place + self._hand for name, place in PLACES.items()}
        self._ropes = {"PBD": hanging(None, tops["PBD"]), "XPBD": hanging(compliance, tops["XPBD"])}
        top = tops["this package"]
        rope = Rope(
            start=tuple(top), end=tuple(top - (0.0, 0.0, LENGTH)), segments=SEGMENTS, mass=MASS, end_mass=LOAD,
            radius=RADIUS, stretch_compliance=compliance, pins=None,
        )  # fmt: skip
        hand = Handle(position=tuple(top), reach=0.5 * LENGTH / SEGMENTS, attached=True)
        scene = Scene(objects={"rope": rope}, handles={"hand": hand}, gravity=(0.0, 0.0, -GRAVITY))
        self._sim = Simulation(scene, Settings(method="xpbd", substeps=8, iterations=1, global_damping=2.0))
        self._compliance = compliance

    def _draw_first(self) -> None:
        for k, name in enumerate(NAMES):
            points = self._points(name)
            self.drawing.rope(name, points, RADIUS, COLOURS[k])
            self.drawing.ball(f"{name} load", 0.045, points[-1], STEEL)
            self.drawing.label(f"{name} label", name, points[0])

    def dragged(self, drag: Drag) -> None:
        name = drag.name
        if name in PLACES:
            self.swing.value = False
            self._hand = np.clip(drag.pointer - PLACES[name] + (0.0, 0.0, self._grip(drag)), -0.5, 0.5)

    def _grip(self, drag: Drag) -> float:
        """Return the distance [m] of the grasped point below the top."""
        if drag.phase == "start":
            self._below = float(self._points(drag.name)[0, 2] - drag.grasped[2])
        return self._below

    def _points(self, name: str) -> np.ndarray:
        return self._sim.positions("rope") if name == NAMES[2] else self._ropes[name].springs.x

    def frame(self) -> None:
        if self.compliance.value != self._compliance:
            self._start()
        if self._measuring is not None and next(self._measuring, "done") == "done":
            self._measuring = None
        self._time += FRAME
        if self.swing.value:
            self._hand = np.array([SWING * np.sin(2.0 * np.pi * self._time / PERIOD), 0.0, 0.0])
        for name, rope in self._ropes.items():
            rope.step(PLACES[name] + self._hand, FRAME, self.substeps.value, self.iterations.value, GRAVITY)
        self._sim.set_handle_pose("hand", PLACES[NAMES[2]] + self._hand)
        self._sim.step()
        self._draw()

    @property
    def stretch(self) -> dict[str, float]:
        """Name -> relative elongation of its rope."""
        lengths = {name: np.linalg.norm(np.diff(self._points(name), axis=0), axis=1).sum() for name in NAMES}
        return {name: float(length / LENGTH - 1.0) for name, length in lengths.items()}

    def _draw(self) -> None:
        stretch = self.stretch
        for name in NAMES:
            points = self._points(name)
            self.drawing.move(name, points)
            self.drawing.move(f"{name} load", points[-1])
            self.drawing.label(f"{name} label", name, points[0] + (0.0, 0.0, 0.05))
        self._curves.add(self._time, [100.0 * stretch[name] for name in NAMES])
        if round(self._time / FRAME) % 12 == 0:
            rows = "\n".join(f"| {name} | {100.0 * stretch[name]:.2f} % |" for name in NAMES)
            still = f"| closed form, hanging still | {100.0 * stretch_at_rest(self._compliance):.2f} % |"
            self._numbers.content = f"| rope | stretch now |\n|---|---|\n{rows}\n{still}"

    # -- measuring -----------------------------------------------------------------------------------------------

    def _measure(self) -> None:
        self._measuring = self.measure(self._compliance, self.substeps.value)

    def measure(self, compliance: float, substeps: int) -> Iterator[None]:
        """Hang both ropes with each of COUNTS iterations; `measured` gets the count and their stretches."""
        self.measured = []
        rest = stretch_at_rest(compliance)
        for count in COUNTS:
            ropes = [hanging(None, PLACES["PBD"]), hanging(compliance, PLACES["PBD"])]
            sums = np.zeros(2)
            for k in range(SETTLE):
                for rope in ropes:
                    rope.step(PLACES["PBD"], FRAME, substeps, count, GRAVITY)
                if k >= SETTLE - MEAN:
                    sums += [rope.stretch for rope in ropes]
                if k % max(1, 64 // count) == 0:
                    yield
            self.measured.append((count, *(sums / MEAN)))
            table = np.array(self.measured)
            self._chart.data = (
                table[:, 0],
                100.0 * table[:, 1],
                100.0 * table[:, 2],
                np.full(len(table), 100.0 * rest),
            )
