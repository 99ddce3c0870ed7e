# SPDX-License-Identifier: Apache-2.0
"""Structural, shear and bending springs of a sheet, each switched on and off while it moves."""

from __future__ import annotations

import numpy as np

from cloth_sim_ros.sim import Cloth, Plane, Scene, Settings, Sphere
from cloth_sim_ros.viewer.drawing import Drag
from cloth_sim_ros.viewer.pages.stage import Stage
from cloth_sim_ros.viewer.scale import PowerSlider, powers
from cloth_sim_ros.viewer.window import Page

SIDE = 16  # particles along an edge
OFF = 1e6  # [m/N] as good as no spring at all
KINDS = {  # kind -> (parameter, compliance [m/N], colour, what it does)
    "structural": ("stretch_compliance", 1e-3, (30, 84, 150), "keeps neighbours at their distance"),
    "shear": ("shear_compliance", 3e-3, (222, 104, 44), "keeps the cells square"),
    "bending": ("bend_compliance", 3e-2, (40, 140, 90), "keeps the sheet from folding"),
}
PINS = ("corners", "top", "none")


class SpringNetwork(Page):
    """A sheet that hangs by two corners over a ball. `show` returns the number and largest strain of each kind."""

    title = "a. The spring network"
    text = (
        "A cloth is a net of springs. **Structural** springs join neighbours. **Shear** springs cross each cell. "
        "**Bending** springs reach over two edges. Switch one kind off and see what it was good for. Drag the cloth."
    )
    camera = ((1.3, -1.7, 1.3), (0.0, 0.3, 0.72))

    def build(self) -> None:
        sheet = Cloth(
            resolution=(SIDE, SIDE),
            size=(1.0, 1.0),
            mass=0.3,
            position=(0.0, 0.0, 1.2),
            pins="corners",
            bending="springs",
            damping=0.002,
            **{parameter: compliance for parameter, compliance, _, _ in KINDS.values()},
        )
        scene = Scene(
            objects={"sheet": sheet},
            colliders={"floor": Plane(), "ball": Sphere(radius=0.2, position=(0.05, 0.42, 0.72))},
        )
        settings = Settings(method="xpbd", substeps=12, iterations=1, global_damping=0.2)
        self.stage = Stage(self.drawing, scene, settings)
        self.switches, self.sliders = {}, {}
        for kind, (_, compliance, _, text) in KINDS.items():
            self.switches[kind] = self.gui.add_checkbox(f"{kind} springs", True, hint=text)
            hint = "1 / spring constant"
            self.sliders[kind] = PowerSlider(
                self.gui, "compliance", powers(1e-5, 10.0), compliance, " m/N", hint, self.tell
            )
        self.pins = self.gui.add_dropdown("Held at", PINS)
        self.lines = self.gui.add_checkbox("Show the springs", True)
        self.button("Start again", self._reset)
        self._numbers = self.gui.add_markdown("")

    def _reset(self) -> None:
        self.stage.sim.reset()

    def dragged(self, drag: Drag) -> None:
        self.stage.drag(drag)

    def frame(self) -> None:
        for kind, (parameter, _, _, _) in KINDS.items():
            value = self.sliders[kind].value if self.switches[kind].value else OFF
            self.stage.apply(f"sheet.{parameter}", value)
        self.stage.apply("sheet.pins", self.pins.value)
        self.stage.step()
        self._draw()

    def show(self) -> dict[str, tuple[int, float]]:
        """Return kind -> number of its springs, and the largest strain of any of them now."""
        positions = self.stage.sim.positions("sheet")
        found = {}
        for kind, (pairs, rest, _) in self.stage.sim.springs("sheet").items():
            length = np.linalg.norm(positions[pairs[:, 1]] - positions[pairs[:, 0]], axis=1)
            found[kind] = (len(pairs), float(np.abs(length / rest - 1.0).max()))
        return found

    def _draw(self) -> None:
        rows = ["| springs | number | largest strain |", "|---|---|---|"]
        for kind, (number, strain) in self.show().items():
            rows.append(
                f"| {kind} | {number} | {100 * strain:.1f} % |" if self.switches[kind].value else f"| {kind} | off | |"
            )
        self._numbers.content = "\n".join([*rows, "", self.stage.refused])
        positions = self.stage.sim.positions("sheet")
        self.drawing.handles["sheet"].opacity = 0.4 if self.lines.value else None
        for kind, (pairs, _, _) in self.stage.sim.springs("sheet").items():
            shown = self.lines.value and self.switches[kind].value
            if shown and kind in self.drawing.handles:
                self.drawing.move(kind, positions)
            elif shown:
                self.drawing.net(kind, positions, pairs, KINDS[kind][2])
            elif kind in self.drawing.handles:
                self.drawing.remove(kind)
