# SPDX-License-Identifier: Apache-2.0
"""The whole cloth: drag it, cut it, blow at it, rub it over a ball."""

from __future__ import annotations

import numpy as np

from cloth_sim_ros.sim import Cloth, Plane, Readback, Scene, Sphere, Wind
from cloth_sim_ros.viewer.drawing import Click, Drag
from cloth_sim_ros.viewer.pages.stage import Stage
from cloth_sim_ros.viewer.scale import PowerSlider, powers
from cloth_sim_ros.viewer.scissors import Scissors
from cloth_sim_ros.viewer.window import Page

SIDE = 32  # particles along an edge
NORMAL = 0.04  # [m] as long as a normal is drawn
RED = (196, 60, 60)
PINS = ("corners", "top", "none")


class WholeCloth(Page):
    """A cloth that falls over a ball. Its numbers are those of `Simulation.report`."""

    title = "e. The whole cloth"
    text = (
        "All together, as a robot would use it: drag the cloth, blow at it, let it slide over the ball. Click on two "
        "places to cut it between them; it is whole again when you start again."
    )
    camera = ((1.6, -2.1, 1.5), (0.0, 0.0, 0.6))

    def build(self) -> None:
        cloth = Cloth(
            resolution=(SIDE, SIDE),
            size=(1.2, 1.2),
            mass=0.3,
            position=(0.0, 0.0, 1.1),
            pins="none",
            bend_compliance=0.1,
            damping=0.001,
            thickness=0.012,
            tear_strain=10.0,
        )
        scene = Scene(
            objects={"cloth": cloth},
            colliders={"floor": Plane(), "ball": Sphere(radius=0.3, position=(0.0, 0.0, 0.6))},
            wind=Wind(),
        )
        self.stage = Stage(self.drawing, scene)
        self.scissors = Scissors(lambda polygon: self.stage.sim.cut("cloth", polygon), self.tell)
        self.wind = [
            self.gui.add_slider(f"wind {axis} [m/s]", -10.0, 10.0, 0.1, 0.0, hint="Wind velocity.") for axis in "xyz"
        ]
        self.friction = self.gui.add_slider(
            "friction", 0.0, 1.5, 0.01, 0.5, hint="Coulomb coefficient of cloth and ball."
        )
        hint = "1 / spring constant in stretch"
        self.stretch = PowerSlider(self.gui, "compliance", powers(1e-5, 1.0), 1e-3, " m/N", hint, self.tell)
        self.pins = self.gui.add_dropdown("Held at", PINS, initial_value="none")
        self.normals = self.gui.add_checkbox(
            "Show normals", False, hint="Computed on the device, from its own positions."
        )
        self.button("Start again", self.stage.sim.reset)
        self._numbers = self.gui.add_markdown("")
        self._readback = Readback(self.stage.sim, "cloth", normals=True)
        self._frames = 0

    def dragged(self, drag: Drag) -> None:
        self.stage.drag(drag)

    def clicked(self, click: Click) -> None:
        if click.name == "cloth":
            self.scissors.click(click, self.stage.sim.positions("cloth"))

    def frame(self) -> None:
        self.stage.apply("wind.velocity", tuple(slider.value for slider in self.wind))
        for name in ("cloth", "ball", "floor"):
            for kind in ("static_friction", "kinetic_friction"):
                self.stage.apply(f"{name}.{kind}", self.friction.value)
        self.stage.apply("cloth.stretch_compliance", self.stretch.value)
        self.stage.apply("cloth.pins", self.pins.value)
        self.stage.step()
        self._draw_normals()
        if self._frames % 15 == 0:
            self._tell()
        self._frames += 1

    def particles(self) -> np.ndarray:
        """Return positions [m] and unit normals (N, 6), as the device has them."""
        self._readback.request()
        return self._readback.particles().copy()

    def _draw_normals(self) -> None:
        if not self.normals.value:
            if "normals" in self.drawing.handles:
                self.drawing.remove("normals")
            return
        found = self.particles()
        ends = np.concatenate([found[:, :3], found[:, :3] + NORMAL * found[:, 3:]])
        if "normals" in self.drawing.handles:
            self.drawing.move("normals", ends)
        else:
            roots = np.arange(len(found))
            self.drawing.net("normals", ends, np.stack([roots, roots + len(found)], axis=1), RED)

    def _tell(self) -> None:
        sim = self.stage.sim
        report = sim.report()["cloth"]
        force = np.linalg.norm(sim.wrench("ball")[0])
        self._numbers.content = (
            f"| | |\n|---|---|\n| largest strain | {100 * report['max_strain']:.1f} % |\n"
            f"| force on the ball | {force:.2f} N |\n| time | {sim.time:.1f} s |\n\n"
            f"The cloth {sim.choices['cloth'].reason}. {self.stage.refused}"
        )
