# SPDX-License-Identifier: Apache-2.0
"""Forward Euler, implicit Euler, Verlet and XPBD on one oscillator and one small cloth, with their energies."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cloth_sim_ros.sim import Cloth, Rope, Scene, Settings, Simulation
from cloth_sim_ros.study import motion
from cloth_sim_ros.study.implicit import implicit_step
from cloth_sim_ros.study.springs import SpringSystem
from cloth_sim_ros.viewer.curves import Curves
from cloth_sim_ros.viewer.drawing import COLOURS, STEEL
from cloth_sim_ros.viewer.scale import PowerSlider, powers
from cloth_sim_ros.viewer.window import Page

FRAME = 1.0 / 60.0  # [s]
MASS, FREQUENCY, LENGTH, STRETCH = 0.3, 6.0, 0.6, 0.2  # [kg], [rad/s], [m], [m] of the oscillator
SIDE, SIZE, CLOTH_MASS, CONSTANT = 6, 0.55, 0.1, 15.0  # particles along an edge, [m], [kg], [N/m] of the cloth
FAR = 3.0  # [m] from where it began: as far as a cloth may fly
LARGEST = 0.5  # [J] that is worth drawing
STEPS = (2.0, 400.0)  # [ms] the range of the slider
BEGIN = 10.0  # [ms]
TOLERANCE = 1e-6  # [m] of Newton's method
MOST = 4  # steps a frame: shorter ones are shown in slow motion
METHODS = ("forward Euler", "implicit Euler", "Verlet", "XPBD")
COILS, POINTS = 9, 90


def oscillator() -> tuple[SpringSystem, np.ndarray]:
    """Return one mass on one spring, and the positions (2, 3) [m] at which it is released."""
    system = SpringSystem(
        masses=np.array([MASS, MASS]),
        fixed=np.array([True, False]),
        pairs=np.array([[0, 1]]),
        rest_length=np.array([LENGTH]),
        constant=np.array([MASS * FREQUENCY**2]),
        gravity=(0.0, 0.0, 0.0),
    )
    return system, np.array([[0.0, 0.0, 0.0], [LENGTH + STRETCH, 0.0, 0.0]])


class ByFormula:
    """A system under a step from the study, which maps x, v (N, 3) to x, v."""

    def __init__(self, step: Callable, system: SpringSystem, x: np.ndarray, h: float):
        self._step, self.system, self._h = step, system, h
        self.x, self.v = np.array(x, float), np.zeros_like(x, float)

    def step(self) -> None:
        """Advance by one step."""
        with np.errstate(all="ignore"):
            self.x, self.v = self._step(self.system, self.x, self.v, self._h)


class ByProduct:
    """A simulation of the package, first-order XPBD with one step a frame."""

    def __init__(self, thing: Cloth | Rope, system: SpringSystem, x: np.ndarray, h: float):
        scene = Scene(objects={"it": thing}, gravity=system.gravity)
        settings = Settings(method="xpbd", order=1, substeps=1, iterations=10, frame_dt=h)
        self._sim, self.system = Simulation(scene, settings, device="cpu"), system
        self._sim.set_positions("it", x)
        self.x, self.v = np.array(x, float), np.zeros_like(x, float)

    def step(self) -> None:
        """Advance by one step."""
        self._sim.step()
        self.x, self.v = self._sim.positions("it").astype(float), self._sim.velocities("it").astype(float)


Body = ByFormula | ByProduct


def energy(body: Body) -> float:
    """Return the sum of kinetic, elastic and gravitational energy [J]."""
    with np.errstate(all="ignore"):
        return float(sum(body.system.energy(body.x, body.v)))


class Integrators(Page):
    """Four oscillators and four cloths. `energies` are those of the oscillators, relative to the start."""

    title = "b. Integrators"
    text = (
        "The same motion by four methods. **Forward Euler** adds energy until it blows up. **Implicit Euler** takes it "
        "away. **Verlet** keeps it, as long as the step is below 2/ω. **XPBD** is implicit Euler, solved by "
        "constraints. No friction is simulated here."
    )
    camera = ((0.0, -5.0, 1.7), (0.0, 0.0, 1.15))

    def build(self) -> None:
        self.length = PowerSlider(self.gui, "step", powers(*STEPS), BEGIN, " ms", "Length of a step.", self.tell)
        self.button("Start again", self.start)
        self._numbers = self.gui.add_markdown("")
        colours = COLOURS[: len(METHODS)]
        self._oscillators = Curves(self.gui, "Energy of the oscillators [1]", METHODS, (1e-3, 1e3), colours=colours)
        self._cloths = Curves(self.gui, "Energy of the cloths [J]", METHODS, colours=colours)
        self.start()

    @property
    def h(self) -> float:
        """Length of a step [s]."""
        return 1e-3 * self.length.value

    def start(self) -> None:
        """Restart all oscillators and cloths."""
        self._h, self.time, self._owed = self.h, 0.0, 0.0
        system, x = oscillator()
        rope = Rope(
            start=(0.0, 0.0, 0.0), end=(LENGTH, 0.0, 0.0), segments=1, particle_masses=[MASS, MASS],
            stretch_compliance=1.0 / (MASS * FREQUENCY**2 * LENGTH),
        )  # fmt: skip
        self.oscillators = _bodies(rope, system, x, self._h)
        cloth = Cloth(
            resolution=(SIDE, SIDE), size=(SIZE, SIZE), mass=CLOTH_MASS, stretch_compliance=1.0 / CONSTANT,
            shear_compliance=2.0 / CONSTANT,
        )  # fmt: skip
        sample = Simulation(
            Scene(objects={"it": cloth}), Settings(method="xpbd", substeps=1, iterations=1), device="cpu"
        )
        pins = np.array([SIDE * (SIDE - 1), SIDE * SIDE - 1])
        system = SpringSystem.from_springs(sample.masses("it"), pins, sample.springs("it"))
        self._triangles, x = sample.triangles("it"), sample.positions("it").astype(float)
        self.cloths = _bodies(cloth, system, x, self._h)
        self._first = {name: energy(body) for name, body in self.cloths.items()}
        self._gone: set[str] = set()
        self.drawing.clear()
        self._oscillators.clear()
        self._cloths.clear()
        self._draw_first()

    def frame(self) -> None:
        if self.h != self._h:
            self.start()
        self._owed += FRAME
        for _ in range(MOST):
            if self._owed < self._h:
                break
            self._owed -= self._h
            self.step()
        self._owed = min(self._owed, self._h)
        self._draw()

    def step(self) -> None:
        """Advance everything by one step."""
        self.time += self._h
        for body in self.oscillators.values():
            body.step()
        for name, body in self.cloths.items():
            if name not in self._gone:
                self._step_cloth(name, body)
        rows = self.energies
        self._oscillators.add(self.time, [rows[name] for name in METHODS])
        self._cloths.add(self.time, [self._cloth_energy(name) for name in METHODS])

    def _step_cloth(self, name: str, body: Body) -> None:
        try:
            body.step()
        except ArithmeticError:  # Newton's method finds no root
            self._gone.add(name)
        if not (np.isfinite(body.x).all() and np.abs(body.x).max() < FAR):
            self._gone.add(name)

    def _cloth_energy(self, name: str) -> float:
        change = energy(self.cloths[name]) - self._first[name]
        return change if name not in self._gone and change < LARGEST else np.nan

    @property
    def energies(self) -> dict[str, float]:
        """Method -> energy of its oscillator, 1 at the start; inf if it is not finite."""
        first = 0.5 * MASS * FREQUENCY**2 * STRETCH**2
        found = {name: energy(body) / first for name, body in self.oscillators.items()}
        return {name: value if np.isfinite(value) else np.inf for name, value in found.items()}

    # -- drawing -------------------------------------------------------------------------------------------------

    def _draw_first(self) -> None:
        for k, name in enumerate(METHODS):
            self.drawing.rope(f"{name} spring", self._coil(name), 0.008, COLOURS[k])
            self.drawing.ball(f"{name} mass", 0.055, self._mass(name), STEEL)
            self.drawing.label(f"{name} row", name, (-1.05, 0.0, self._mass(name)[2] - 0.03))
            self.drawing.cloth(name, self._cloth(name), self._triangles, COLOURS[k])
            above = 0.06 + 0.12 * (k % 2)  # neighbours would touch on a phone
            self.drawing.label(f"{name} label", name, self._place(k) + (0.0, 0.0, above))

    def _draw(self) -> None:
        for name in METHODS:
            self.drawing.move(f"{name} spring", self._coil(name))
            self.drawing.move(f"{name} mass", self._mass(name))
            if name not in self._gone:
                self.drawing.move(name, self._cloth(name))
            elif self.drawing.handles[name].visible:
                self.drawing.handles[name].visible = False
                self.drawing.handles[f"{name} label"].text = f"{name}: blown up"
        rows = "\n".join(f"| {name} | {_shown(value)} |" for name, value in self.energies.items())
        self._numbers.content = (
            f"Step {1e3 * self._h:.1f} ms, ωh = {FREQUENCY * self._h:.2f}, time {self.time:.1f} s\n\n"
            f"| method | oscillator's energy |\n|---|---|\n{rows}"
        )

    def _mass(self, name: str) -> np.ndarray:
        reach = np.clip(np.nan_to_num(self.oscillators[name].x[1, 0], posinf=9.0), 0.05, 1.7)
        return np.array([-0.7 + reach, 0.0, 1.95 - 0.16 * METHODS.index(name)])

    def _coil(self, name: str) -> np.ndarray:
        end = self._mass(name)
        t = np.linspace(0.0, 1.0, POINTS)
        turn, width = 2.0 * np.pi * COILS * t, 0.035
        along = -0.7 + t * (end[0] + 0.7)
        return np.stack([along, width * np.cos(turn), end[2] + width * np.sin(turn)], axis=1)

    def _place(self, k: int) -> np.ndarray:
        return np.array([0.75 * (k - 1.5), 0.5 * SIZE, 1.1])

    def _cloth(self, name: str) -> np.ndarray:
        return self.cloths[name].x + self._place(METHODS.index(name)) - (0.0, 0.5 * SIZE, 0.0)


def _bodies(thing: Cloth | Rope, system: SpringSystem, x: np.ndarray, h: float) -> dict[str, Body]:
    implicit = _implicit_along if isinstance(thing, Rope) else _implicit
    steps = (motion.forward_euler, implicit, motion.leapfrog)
    found = {name: ByFormula(step, system, x, h) for name, step in zip(METHODS, steps, strict=False)}
    return {**found, "XPBD": ByProduct(thing, system, x, h)}


def _implicit(system: SpringSystem, x: np.ndarray, v: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray]:
    return implicit_step(system, x, v, h, TOLERANCE)


def _implicit_along(system: SpringSystem, x: np.ndarray, v: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray]:
    """Take a step of implicit Euler of the oscillator, which is linear along x and needs no Newton's method."""
    stiffness = system.constant[0] / system.masses[1]
    new = v.copy()
    new[1, 0] = (v[1, 0] - h * stiffness * (x[1, 0] - LENGTH)) / (1.0 + h**2 * stiffness)
    return x + h * new, new


def _shown(value: float) -> str:
    return f"{value:.4g}" if value < 1e6 else "blown up"
