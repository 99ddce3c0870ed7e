# SPDX-License-Identifier: Apache-2.0
"""Springs that may be solved at once: colours, red-black order, and the races without them."""

from __future__ import annotations

import numpy as np
from scipy.spatial import Delaunay

from cloth_sim_ros.sim import Cloth
from cloth_sim_ros.sim.topology import build
from cloth_sim_ros.study.colouring import colour
from cloth_sim_ros.study.relaxation import Springs, lost_writes
from cloth_sim_ros.viewer.curves import Curves
from cloth_sim_ros.viewer.drawing import Colour
from cloth_sim_ros.viewer.window import Page

PALETTE: tuple[Colour, ...] = (
    (214, 62, 62), (40, 44, 52), (46, 112, 176), (232, 168, 40), (58, 150, 98), (150, 96, 190), (32, 168, 178),
    (240, 120, 160), (140, 110, 70), (120, 190, 60), (90, 90, 240), (200, 200, 60),
)  # fmt: skip
WAITING: Colour = (206, 211, 218)
CONFLICT: Colour = (240, 20, 20)
SIDE = 7  # particles along an edge
CHAIN = 14  # segments of the rope
SHAPES = ("rope: red and black", "grid", "mesh of triangles")
ORDERS = ("in parallel, colour by colour", "one by one", "all at once, with races")
PULL = 0.25  # by how much the shape is stretched at the beginning
STEP = 1.0  # [s]: rigid springs do not depend on it


def shape_of(kind: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return rest positions (N, 3) [m], springs (E, 2) and their colours (E,) of one of SHAPES."""
    if kind == SHAPES[0]:
        points = np.stack([np.linspace(-0.7, 0.7, CHAIN + 1), np.zeros(CHAIN + 1), np.full(CHAIN + 1, 1.0)], axis=1)
        pairs = np.stack([np.arange(CHAIN), np.arange(1, CHAIN + 1)], axis=1)
        return points, pairs, np.arange(CHAIN) % 2
    if kind == SHAPES[1]:
        topology = build(Cloth(resolution=(SIDE, SIDE), shear_compliance=None), "it", False)
        pairs = topology.springs["structural"].particles
        along = pairs[:, 1] - pairs[:, 0] == 1
        colours = np.where(along, pairs[:, 0] % SIDE % 2, 2 + pairs[:, 0] // SIDE % 2)
    else:
        even = np.stack(np.meshgrid(*2 * [np.linspace(-0.5, 0.5, SIDE)]), axis=-1).reshape(-1, 2)
        flat = even + np.random.default_rng(3).uniform(-0.35, 0.35, even.shape) / (SIDE - 1)
        triangles = Delaunay(flat).simplices
        topology = build(Cloth.from_mesh(np.pad(flat, ((0, 0), (0, 1))), triangles), "it", False)
        pairs = topology.springs["structural"].particles
        colours = colour(pairs, len(flat))
    return (
        topology.layout[:, [0, 2, 1]] + (0.0, 0.0, 1.0),
        pairs.astype(int),
        np.unique(colours, return_inverse=True)[1],
    )


class Colouring(Page):
    """A net of rigid springs that is stretched and relaxed pass by pass. `passes` are those of a sweep."""

    title = "d. Colours and red-black order"
    text = (
        "Solving a spring moves its two particles. Two springs that share a particle must not be solved at once: "
        "one of the two writes would be lost. Springs of one **colour** share no particle. So each colour is a pass in "
        "parallel. Of a rope every second segment is red, the others are black."
    )
    camera = ((0.0, -2.5, 1.25), (0.0, 0.0, 1.0))

    def build(self) -> None:
        gui = self.gui
        self.shape = gui.add_dropdown("Shape", SHAPES, initial_value=SHAPES[1])
        self.order = gui.add_dropdown("Order", ORDERS)
        self.play = gui.add_checkbox("Play", True)
        self.pace = gui.add_slider("passes a second", 1, 30, 1, 2)
        self.buttons(("next pass", "a sweep", "start again"), self.press)
        self._numbers = gui.add_markdown("")
        self._curve = Curves(gui, "Largest error [mm]", ["largest error"], log=(1e-3, 1e3), span=1e9)
        self._frames = 0
        self._chosen: tuple[str, str] = ("", "")

    def press(self, label: str) -> None:
        """Act as the button of this label."""
        if label == "start again":
            self.start()
        for _ in range({"next pass": 1, "a sweep": len(self.passes)}.get(label, 0)):
            self.next_pass()

    def start(self) -> None:
        """Stretch the chosen shape anew."""
        self._chosen = (self.shape.value, self.order.value)
        rest, pairs, self.colours = shape_of(self.shape.value)
        lengths = np.linalg.norm(rest[pairs[:, 1]] - rest[pairs[:, 0]], axis=1)
        stretched = np.random.default_rng(5).normal(0.0, 0.1 * lengths.mean(), rest.shape) * (1.0, 0.0, 1.0)
        x = rest * (1.0 + PULL, 1.0, 1.0) + stretched
        self.springs = Springs(x, np.ones(len(x)), pairs, lengths, np.zeros(len(pairs)), ())
        everything = np.arange(len(pairs))
        self.passes = {
            ORDERS[0]: [np.flatnonzero(self.colours == k) for k in range(self.colours.max() + 1)],
            ORDERS[1]: list(everything[:, None]),
            ORDERS[2]: [everything],
        }[self.order.value]
        self.done, self.lost = 0, 0
        self.drawing.clear()
        self._curve.clear()
        self._draw(np.array([], int))

    @property
    def error(self) -> float:
        """Largest deviation [m] of a spring from its rest length."""
        return float(np.abs(self.springs.violation()).max())

    def next_pass(self) -> None:
        """Solve the springs of the next pass; of several writes to one particle only one is kept."""
        chosen = self.passes[self.done % len(self.passes)]
        self.lost += self.springs.race(chosen, np.zeros(len(self.springs.pairs)), STEP)
        self.done += 1
        self._draw(chosen)

    def frame(self) -> None:
        if (self.shape.value, self.order.value) != self._chosen:
            self.start()
        self._frames += 1
        if self.play.value and self._frames % max(1, round(60 / self.pace.value)) == 0:
            self.next_pass()

    def _draw(self, chosen: np.ndarray) -> None:
        springs = self.springs
        colours = np.tile(WAITING, (len(springs.pairs), 1))
        shown = np.arange(len(springs.pairs)) if not self.done else chosen
        colours[shown] = np.array(PALETTE)[self.colours[shown] % len(PALETTE)]
        used = np.bincount(springs.pairs[chosen].ravel(), minlength=len(springs.x))
        dots = np.where((used > 1)[:, None], CONFLICT, (70, 76, 86))
        self.drawing.lines("springs", springs.x[springs.pairs], colours, 5.0)
        self.drawing.dots("particles", springs.x + (0.0, -0.01, 0.0), dots, 0.02)
        self._curve.add(self.done, [1e3 * self.error])
        self._curve.draw()
        parallel = f"{len(chosen)} springs at once" if len(chosen) != 1 else "1 spring"
        self._numbers.content = (
            f"| | |\n|---|---|\n| springs | {len(springs.pairs)} |\n| colours | {self.colours.max() + 1} |\n"
            f"| passes a sweep | {len(self.passes)} |\n| passes done | {self.done} |\n| this pass | {parallel} |\n"
            f"| writes lost in it | {lost_writes(springs.pairs[chosen]) if len(chosen) else 0} |\n"
            f"| largest error | {1e3 * self.error:.2f} mm |\n\n"
            "Dots in bright red are particles that several springs write at once."
        )
