# SPDX-License-Identifier: Apache-2.0
"""The running simulation: built from parameter values, rebuilt when they change, fed with poses and wind."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import warp

from cloth_sim_ros.ros.inputs.added import Added
from cloth_sim_ros.ros.inputs.frames import Followers, Frames, Mounts
from cloth_sim_ros.ros.inputs.grasps import Grasps
from cloth_sim_ros.ros.inputs.grippers import Grippers, finger_names
from cloth_sim_ros.ros.inputs.pose_track import Pose, PoseTrack, Vector
from cloth_sim_ros.ros.inputs.winches import Winches
from cloth_sim_ros.ros.journal import Journal
from cloth_sim_ros.ros.outputs.log import Reported
from cloth_sim_ros.ros.parameters import names
from cloth_sim_ros.ros.parameters.feasibility import broken_meshes, broken_seams, check_solver
from cloth_sim_ros.ros.parameters.plan import Plan, make_plan, placed
from cloth_sim_ros.ros.state_notes import live_values, notes_of, read_notes
from cloth_sim_ros.ros.time.compiling import Compiling
from cloth_sim_ros.sim import Simulation
from cloth_sim_ros.sim.colliders.collider import Collider
from cloth_sim_ros.sim.substeps.limits import Unstable


class World:
    """Owned by the thread that simulates; only the tracks may be pushed to from elsewhere.

    log: any object with info(), warning() and error(). sim is None until a build succeeds, and `trouble` says why.
    """

    def __init__(self, values: Mapping[str, Any], log: Any, frames: Frames | None = None):
        self.sim: Simulation | None = None
        self.trouble = "not built yet"
        self.resets = 0
        self.simulated = 0.0  # [s] in all, through resets and rebuilds
        self.is_at_start = True  # no frame since the beginning, or since a reset
        moved = (*values["colliders"], *values["handles"], *values["grippers"])
        poses = {name: Pose.of(values, name) for name in moved}
        poses |= dict.fromkeys(finger_names(values["grippers"]), Pose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)))
        self.tracks = {name: PoseTrack(pose, values["pose_timeout"]) for name, pose in poses.items()}
        self.grasps = Grasps(log)
        self._followers = Followers(frames or Frames(values["frame_id"]), log)
        self.added = Added()
        self.mounts: Mounts = {}
        self.values: Mapping[str, Any] = values  # as they were when the simulation was built
        self.in_effect: Mapping[str, Any] = values  # with the live changes since then that the simulation took
        self.journal = Journal()
        self._reported = Reported(log)
        self._wind: Vector | None = None  # set by topic since the parameter was last set
        self._winches = Winches(log)
        self.grippers = Grippers()
        self.compiling = Compiling(log)
        self._log = log

    def build(self, values: Mapping[str, Any]) -> bool:
        """Build the simulation of `values`; return True if that succeeds.

        If not, the simulation before goes on and the log says why.
        """
        self._log.info("building the simulation; kernels that were never used here take up to two minutes to compile")
        try:
            plan = make_plan(values)
            broken = broken_meshes(plan, plan.scene.objects)
            plan = plan.without(broken)
            unsewn = broken_seams(plan)
            for sentence in (*plan.problems.values(), *broken.values(), *unsewn.values()):
                self._log.error(f"{sentence}; it is left out until that is mended")
            tracks = self._tracks_with(plan)
            drivers = self.grippers.prepare(plan.grippers, tracks)
            plan = plan.without(unsewn).with_poses({name: track.pose for name, track in tracks.items()})
            check_solver(plan)
            sim = Simulation(plan.scene, plan.settings, device=plan.device)
            sim.step()  # compiles what is left to compile, so that no later frame waits for it
            sim.reset()
        except Exception as error:
            goes_on = "the simulation before goes on" if self.sim else "waiting for a parameter change"
            self._log.error(f"cannot build the simulation: {error}; {goes_on}")
            if self.sim is None:
                self.trouble = str(error)
            return False
        self._keep_states(sim, values)
        self.tracks, self.mounts = tracks, plan.mounts
        self.journal.cut()
        self.grippers.build(drivers)
        self.sim, self.values, self.in_effect, self.trouble = sim, values, values, ""
        if self._wind is not None and sim.scene.wind is not None:
            sim.set_wind(self._wind)
        self._winches.drive(sim)
        self.added.put_all(sim)
        sizes = ", ".join(f"{name} ({len(sim.masses(name))} particles)" for name in plan.scene.objects)
        self._log.info(f"simulating {sizes or 'nothing'} on {sim.device}: {sim.method}")
        self.grasps.tell_empty(sim, values)
        self._reported.start(sim, values)
        self.compiling.start(sim)
        return True

    def _tracks_with(self, plan: Plan) -> dict[str, PoseTrack]:
        """Return the tracks of a simulation with the robot of `plan`, whose links go on from their poses."""
        tracks = {name: track for name, track in self.tracks.items() if name not in self.mounts}
        for name in plan.mounts:
            collider = plan.scene.colliders[name]
            start = PoseTrack(Pose(collider.position, collider.orientation), self.in_effect["pose_timeout"])
            tracks[name] = self.tracks.get(name, start)
        return tracks

    def _keep_states(self, sim: Simulation, values: Mapping[str, Any]) -> None:
        """Let objects of unchanged structure go on from their current states."""
        if self.sim is None:
            return
        for name in sim.scene.objects:
            if name in self.sim.scene.objects and _structure(values, name) == _structure(self.values, name):
                sim.take_over(name, self.sim)

    def set_live(self, name: str, value: Any, values: Mapping[str, Any]) -> bool:
        """Apply the changed live parameter `name`; `values` are all of them with the change.

        Returns False if explicit steps would be unstable with it: nothing has changed then.
        """
        self.journal.note("set_live", name, value)
        owner, _, field = name.rpartition(".")
        if name == "state_file" or field in ("timeout", "follow_frame"):
            pass  # read when it is needed
        elif name == "pose_timeout":
            for track in self.tracks.values():
                track.timeout = value
        elif owner in self.tracks and field in ("position", "orientation"):
            self.tracks[owner].place(Pose.of(values, owner))
        elif owner in values["grippers"]:
            self.grippers.set_parameter(self.sim, owner, field, value)
        else:
            if name == "wind.velocity":
                self._wind = None
            if field == "pay_out":
                self._winches.set_parameter(owner.removesuffix(".winch"), value, values)
            if self.sim is None:
                return True
            if not self._set_in_simulation(name, value):
                return False
        self.in_effect = {**self.in_effect, name: value}
        return True

    def _set_in_simulation(self, name: str, value: Any) -> bool:
        owner, _, field = name.rpartition(".")
        try:
            if owner in self.sim.scene.handles and field == "attached":
                self._reported.say(*self.grasps.set(self.sim, owner, value))
            else:
                self.sim.set(name, value)
            self._reported.reasons(self.sim, with_substeps=False)
        except Unstable as error:
            self._log.error(f"{name} is put back: {error}")
            return False
        except ValueError as error:
            self._reported.waits(name, str(error))
        return True

    def set_wind(self, velocity: Vector) -> None:
        """Set the wind [m/s] from a message."""
        self.journal.note("set_wind", velocity)
        self._wind = velocity
        if self.sim is not None and self.sim.scene.wind is not None:
            self.sim.set_wind(velocity)

    def set_pay_out(self, rope: str, rate: float) -> None:
        """Set the rate of a winch [m/s] from a message."""
        self.journal.note("set_pay_out", rope, rate)
        self._winches.command(self.sim, rope, rate, self.simulated)

    def set_gripper(self, name: str, what: str, value: float) -> None:
        """Set the opening [m] or the force [N] of a gripper from a message."""
        self.grippers.command(name, what, value)

    def move_gripper(self, name: str, points: Sequence[tuple[float, float]]) -> None:
        """Move a gripper through points of time from now on [s] and opening [m]; without any it stays."""
        self.grippers.follow(name, self.simulated, points)

    def reset(self) -> None:
        """Reset objects to their start and winches to their parameters.

        Colliders stay at their last poses, as their senders believe.
        """
        self.journal.note("reset")
        self.resets += 1
        self.is_at_start = True
        self._winches.release(self.sim, list(self._winches.rates), self.in_effect)
        if self.sim is None:
            return
        self.sim.reset()
        for name, pose in self.poses().items():
            if name in self.sim.scene.colliders:
                self.sim.set_collider_pose(name, pose.position, pose.orientation, sweep=False)
        self.grasps.reset(self.sim, self.tracks, self.in_effect)

    def poses(self) -> dict[str, Pose | Collider]:
        """Return name -> pose, or an object with position and orientation, of all colliders and handles."""
        return {**{name: track.pose for name, track in self.tracks.items()}, **self.added.colliders}

    def put(self, name: str, collider: Collider) -> tuple[bool, str]:
        """Add a collider, or move one that was added; return True, or False and the reason."""
        self.journal.note("put", name, collider)
        return self.added.put(self.sim, name, collider)

    def take_away(self, name: str) -> None:
        """Remove the added collider of this name, if there is one."""
        self.journal.note("take_away", name)
        self.added.take_away(self.sim, name)

    def place(self, name: str, pose: Pose) -> None:
        """Put a collider, or a handle that holds nothing, at `pose` at once, without a motion."""
        self.journal.cut()  # it has no act for that, nor for the next one
        if name in self.added.colliders:
            self.added.colliders[name] = replace(self.added.colliders[name], **placed(pose))
        else:
            self.tracks[name].rest(pose)
        put = self.sim.set_handle_pose if name in self.sim.scene.handles else self.sim.set_collider_pose
        put(name, pose.position, pose.orientation, sweep=False)

    def place_object(self, name: str, positions: np.ndarray | None, velocities: np.ndarray | None) -> None:
        """Set the positions (N, 3) [m] and velocities (N, 3) [m/s] of an object's particles; None leaves them."""
        self.journal.cut()
        if positions is not None:
            self.sim.set_positions(name, positions)
        if velocities is not None:
            self.sim.set_velocities(name, velocities)

    def attach(self, handle: str, on: bool) -> tuple[bool, str]:
        """Let a handle grasp or let go; return True if that succeeded, and one sentence about it."""
        if self.sim is None:
            return False, f"no simulation: {self.trouble}"
        self.journal.note("attach", handle, on)
        done, sentence = self.grasps.set(self.sim, handle, on)
        self.in_effect = {**self.in_effect, f"{handle}.attached": on and done}
        return done, sentence

    def is_empty(self, name: str) -> bool:
        """Return True for a handle that holds nothing."""
        return self.sim is not None and name in self.sim.scene.handles and not self.sim.held(name)

    def cut(self, polygon: list[Vector]) -> None:
        """Cut all objects that tear along a flat polygon [m], and log the cut springs."""
        self.journal.note("cut", polygon)
        if self.sim is None:
            return
        cuts = {name: self.sim.cut(name, polygon) for name in self.sim.scene.objects if self.sim.tears(name)}
        told = " and ".join(f"{count} springs of {name}" for name, count in cuts.items() if count)
        self._log.info(f"a cut goes through {told or 'nothing'}")

    def advance(self) -> float:
        """Simulate one frame and return its length [s]. On a GPU the frame may still be under way."""
        frame_dt = self.sim.settings.frame_dt
        self._winches.end_old_commands(self.sim, self.in_effect, self.simulated)
        for name in self._followers.advance(self.tracks, self.in_effect, self.mounts):
            self.sim.set_collider_pose(name, **vars(self.tracks[name].pose), sweep=False)
            self.journal.cut()  # it has no act that puts a collider elsewhere without a motion
        self.grippers.advance(self.sim, self.tracks, self.simulated + frame_dt)
        scene = self.sim.scene
        for name, track in self.tracks.items():
            move = self.sim.set_handle_pose if name in scene.handles else self.sim.set_collider_pose
            if name in scene.colliders or name in scene.handles:
                before, pose = track.pose, track.advance(frame_dt)
                if pose is not None and pose != before:  # else a sender who stands still would keep all awake
                    self.journal.note("move", name, pose.position, pose.orientation)
                    move(name, pose.position, pose.orientation)
        self.sim.step()
        self.grasps.watch(self.sim, self.in_effect)
        self.simulated += frame_dt
        self.is_at_start = False
        self.journal.note("advance")
        return frame_dt

    def save(self, path: Path) -> tuple[bool, str]:
        """Save the state with the commands of topics; return True if that succeeded, and one sentence."""
        if self.sim is None:
            return False, f"no simulation: {self.trouble}"
        try:
            self.sim.save(path, self.notes())
        except ValueError as error:
            return False, str(error)
        return True, f"the state at {self.sim.time:.6g} s is saved in {path}"

    def notes(self) -> dict[str, Any]:
        """Return the commands of topics, to be saved with the state."""
        notes = notes_of(self._wind, self._winches.rates, self.simulated, self.in_effect)
        return {**notes, "grippers": self.grippers.asked}

    def load(self, path: Path) -> tuple[bool, str, dict[str, Any]]:
        """Load a state; return True if that succeeded, one sentence, and the live parameters that differ now.

        The simulation stays as it is if the file cannot be loaded.
        """
        if self.sim is None:
            return False, f"no simulation: {self.trouble}", {}
        builds = self.sim.builds
        try:
            notes = self.sim.load(path)
        except ValueError as error:
            return False, str(error), {}
        self._wind, self._winches.rates, waiting, asked = read_notes(notes, self.simulated, self.in_effect)
        self.grippers.look(self.sim, asked)
        values = {**live_values(self.sim, self.in_effect), **waiting}
        self.in_effect = {**self.in_effect, **values}
        for name in {*self.sim.scene.colliders, *self.sim.scene.handles} & set(self.tracks):
            self.tracks[name].rest(Pose(self.sim.get(f"{name}.position"), self.sim.get(f"{name}.orientation")))
        self.added.look(self.sim, self.tracks)
        self.is_at_start = False
        self.journal.cut()
        self._reported.know(self.sim.report())
        self.grasps.look(self.sim)
        self._reported.reasons(self.sim)
        if self.sim.builds != builds:
            self.compiling.start(self.sim)
        return True, f"the simulation goes on at {self.sim.time:.6g} s from {path}", values

    def report(self) -> dict[str, dict[str, float]]:
        """Return the simulation's report, and log its events."""
        report = self.sim.report()
        self._reported.reasons(self.sim)
        self._reported.report(report, self.in_effect)
        self._reported.stitches(self.broken_stitches(), self.in_effect)
        return report

    def broken_stitches(self) -> dict[str, int]:
        """Return the number of broken stitches of each seam with a strength."""
        weak = [seam for seam in self.sim.scene.seams if self.in_effect[f"{seam}.strength"] > 0.0]
        return {seam: int(self.sim.stitches(seam)[2].sum()) for seam in weak}

    def forget_stamps(self) -> None:
        """Let colliders stay and take poses with any stamp, as the clock has gone back."""
        for track in self.tracks.values():
            track.restart()

    def fail(self, why: str) -> None:
        """Drop a simulation that cannot go on; the next structural parameter change builds another."""
        self._log.error(f"{why}; waiting for a parameter change")
        self.trouble, self.sim = why, None  # whoever sees that there is none finds out why

    def finish(self) -> None:
        """Wait until the device is idle."""
        warp.synchronize_device(self.sim.device)


def _structure(values: Mapping[str, Any], name: str) -> dict[str, Any]:
    return {row.name: values[f"{name}.{row.name}"] for row in names.object_rows(values[f"{name}.type"]) if row.anew}
