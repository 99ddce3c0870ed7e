# SPDX-License-Identifier: Apache-2.0
"""MuJoCo's side of a coupling: it moves handles and colliders of cloth, and feels the cloth's wrenches.

Both simulators take turns, so a wrench acts later than the motion that it answers. That is harmless for a light load. A
heavy one would be thrown to and fro, further each time (the added mass effect; Causin, Gerbeau and Nobile 2005). So the
acting wrench moves only a part of the way to the felt one: that of a step of Newton's method, I / (I + r c). There r is
the mass of the load over the inertia that MuJoCo has at that place. And c is the number of frames in which the load
answers: one, those of a delay, and those in which its bounce dies down. By the small-gain theorem this is stable if
each is as long as in truth or longer. At its resonance, of angular frequency w, a load of quality Q answers with Q
times its mass. Steps of h seconds lessen such a swing by c w h, where c h = Q / w is the time in which it dies down.
The momentum that a wrench owes, as it acts late, is paid back.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from cloth_sim_ros.sim import Simulation

try:
    import mujoco
except ImportError:
    raise ImportError("MuJoCo is missing; make extras, or pip install 'mujoco>=3.2,<4', adds it") from None

ROUNDING = 1e-9  # excess of a number of steps over a whole one that is rounding
CRITICAL = 4.0  # periods of smoothing in which owed momentum is paid back: critically damped
FORGOTTEN = 1.0  # [s] after which a wrench acts no more, if none has followed

Pose = tuple[tuple[float, ...], tuple[float, ...]]  # position [m], orientation x y z w


class Arm:
    """A MuJoCo model with its data, whose sites and geoms called `names` are handles and colliders of the cloth.

    It sets data.xfrc_applied of their bodies.

    load [kg]: mass that hangs on each of them. ringing [s]: time within which the load's bounce sinks to 1/e. delay:
    number of wrenches by which they are late, beyond the one that taking turns costs. Values above the true ones are
    stable too, and make wrenches later. Raises ValueError for a name that neither a site nor a geom has, and for
    numbers below 0.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        names: Iterable[str],
        load: float,
        ringing: float = 0.3,
        delay: float = 0.0,
    ):
        for name, value in {"load": load, "ringing": ringing, "delay": delay}.items():
            if not 0.0 <= value < math.inf:
                raise ValueError(f"{name} is {value:g}; allowed are numbers from 0 on")
        self.model, self.data = model, data
        self._parts = {name: _Part(model, data, name) for name in names}
        self._load, self._ringing, self._delay = load, ringing, delay
        mujoco.mj_forward(model, data)

    def advance(self, seconds: float) -> None:
        """Advance MuJoCo by equal steps of at most its timestep, with constant wrenches."""
        longest = self.model.opt.timestep
        count = math.ceil(seconds / longest * (1.0 - ROUNDING))
        if count == 0:
            return
        self.data.xfrc_applied[[part.body for part in self._parts.values()]] = 0.0
        for part in self._parts.values():
            part.push()
            part.wait(seconds)
        self.model.opt.timestep = seconds / count
        mujoco.mj_step(self.model, self.data, count)
        self.model.opt.timestep = longest
        mujoco.mj_forward(self.model, self.data)  # places belong to the end of the last step

    def poses(self) -> dict[str, Pose]:
        """Return the current poses of handles and colliders."""
        return {name: part.pose() for name, part in self._parts.items()}

    def feel(self, name: str, wrench: Any) -> None:
        """Take a wrench of the last frame: force [N], torque [N m] about the origin, in world axes.

        Raises ValueError if it is not finite.
        """
        part, felt = self._parts[name], np.asarray(wrench, dtype=float)
        if not np.isfinite(felt).all():
            raise ValueError(f"the wrench of {name} is not finite")
        if part.waited > 0.0:
            part.feel(felt, self._load * (1.0 + self._delay + self._ringing / part.waited))

    def wrench(self, name: str) -> np.ndarray:
        """Return the wrench (6,) that acts in MuJoCo: force [N], torque [N m] about the handle's or collider's
        origin."""
        return self._parts[name].wrench.copy()


class _Part:
    """A site or geom of MuJoCo, and the wrench on it."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, name: str):
        self._model, self._data, self.wrench = model, data, np.zeros(6)
        self._owed = np.zeros(6)  # momentum [N s] and angular momentum of wrenches felt that have not acted yet
        self.waited = 0.0  # seconds since it felt a wrench
        for kind, bodies, places in (
            (mujoco.mjtObj.mjOBJ_SITE, model.site_bodyid, (data.site_xpos, data.site_xmat)),
            (mujoco.mjtObj.mjOBJ_GEOM, model.geom_bodyid, (data.geom_xpos, data.geom_xmat)),
        ):
            number = mujoco.mj_name2id(model, kind, name)
            if number >= 0:
                self.body, (self._position, self._axes) = int(bodies[number]), (each[number] for each in places)
                size = model.site_size[number].max() if bodies is model.site_bodyid else model.geom_rbound[number]
                self._size = float(size)
                return
        raise ValueError(f"MuJoCo's model has neither a site nor a geom {name!r}; allowed is the name of one")

    def pose(self) -> Pose:
        """Return the current pose."""
        turn = np.zeros(4)
        mujoco.mju_mat2Quat(turn, self._axes)
        w, *xyz = turn.tolist()
        return tuple(self._position.tolist()), (*xyz, w)

    def push(self) -> None:
        """Add the wrench to those on the body, about its centre of mass."""
        force, torque = self.wrench[:3], self.wrench[3:]
        lever = self._position - self._data.xipos[self.body]
        self._data.xfrc_applied[self.body] += np.concatenate([force, torque + np.cross(lever, force)])

    def wait(self, seconds: float) -> None:
        """Let time pass without a new wrench; after FORGOTTEN none acts."""
        self.waited += seconds
        if self.waited > FORGOTTEN:
            self.wrench[:] = self._owed[:] = 0.0

    def feel(self, felt: np.ndarray, mass: float) -> None:
        """Move towards the wrench `felt`, as far as a load of `mass` [kg] at its line of action allows."""
        force, torque = felt[:3], felt[3:]
        at = np.cross(force, torque) / max(force @ force, np.finfo(float).tiny)
        at *= min(1.0, self._size / max(np.linalg.norm(at), np.finfo(float).tiny))
        arm = np.hstack([np.eye(3), -_cross(at)])  # acceleration there, of that of the origin and of the turning
        added = mass * (arm.T @ arm + np.diag([0.0] * 3 + [self._size**2] * 3))
        jacobian = np.zeros((6, self._model.nv))
        mujoco.mj_jac(self._model, self._data, jacobian[:3], jacobian[3:], self._position, self.body)
        moved = np.zeros_like(jacobian)
        mujoco.mj_solveM(self._model, self._data, moved, jacobian)
        part = np.linalg.inv(np.eye(6) + added @ (jacobian @ moved.T))
        self._owed += (felt - self.wrench) * self.waited
        self.wrench += part @ (felt - self.wrench + part @ self._owed / (CRITICAL * self.waited))
        self.waited = 0.0


def _cross(v: np.ndarray) -> np.ndarray:
    """Return the matrix whose product with a vector is the cross product of `v` with it."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def step(sim: Simulation, arm: Arm, frames: int = 1) -> None:
    """Simulate both for some frames: MuJoCo first, then the cloth, whose wrenches act in the frame after."""
    for _ in range(frames):
        arm.advance(sim.settings.frame_dt)
        poses = arm.poses()
        for name, pose in poses.items():
            move = sim.set_handle_pose if name in sim.scene.handles else sim.set_collider_pose
            move(name, *pose)
        sim.step()
        for things, rows in ((sim.scene.handles, sim.handle_wrenches), (sim.scene.colliders, sim.wrenches)):
            if poses.keys() & things.keys():
                for name, wrench in zip(things, rows(), strict=False):  # spare rows lie behind
                    if name in poses:
                        arm.feel(name, wrench)
