# SPDX-License-Identifier: Apache-2.0
"""Peers whose cloth is not made of springs, if installed: Newton's Style3D, and the flex of MuJoCo and MuJoCo Warp.

Our exact motion is not theirs, so each is judged by its own limit: its motion with ever smaller steps, as far as that
converges. Both get masses, fixed particles and triangles of the case's sheet. They get the moduli of its square grid of
springs k, as many across its cells as along them: C11 = 2 k, C66 = k, E = 1.5 k [N/m], Poisson's ratio 1/2. To add one,
add a function from a run to its frames and times, and its row.
"""

from __future__ import annotations

import contextlib
import dataclasses
import io
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from cloth_sim_ros.sim.topology import build
from cloth_sim_ros.study import norms
from cloth_sim_ros.study.case import BODY, FRAME_DT
from cloth_sim_ros.study.peers import Frames, Peer, finalized, record, run_newton

if TYPE_CHECKING:
    import mujoco

    from cloth_sim_ros.study.contenders import Run, Simulate

_COARSEST = 10  # substeps from which a limit is looked for


@dataclass(frozen=True)
class Limit:
    """Converged motion of a method: frames (F + 1, N, 3) [m] of its run of so many substeps and iterations.

    known [m]: RMS distance from the next coarser run; infinite if the method does not converge.
    """

    frames: np.ndarray
    known: float
    substeps: int
    iterations: int

    def judges(self, substeps: int, iterations: int) -> bool:
        """Return True if a run is coarser than this limit."""
        other = (substeps, iterations) != (self.substeps, self.iterations)
        return other and substeps <= self.substeps and iterations <= self.iterations


def limit(simulate: Simulate, run: Run, most: int) -> Limit:
    """Return the limit of `simulate` with the iterations of `run`.

    Substeps are doubled as long as runs draw nearer to one another, which rounding ends. most: largest number of sweeps
    a frame.
    """

    def frames_of(substeps: int) -> np.ndarray:
        return simulate(dataclasses.replace(run, substeps=substeps))[0]

    substeps, change, frames = _COARSEST, np.inf, frames_of(_COARSEST)
    while 2 * substeps * run.iterations <= most:
        finer = frames_of(2 * substeps)
        moved, apart = norms.rms(finer[1:] - finer[0]), norms.rms(finer - frames)
        if apart >= change:
            break
        substeps, frames = 2 * substeps, finer
        change = apart if apart < moved else np.inf  # where one of both blew up, they tell nothing
    return Limit(frames, change, substeps, run.iterations)


def style3d(run: Run) -> Frames:
    """Simulate by Newton's Style3D (projective dynamics), with at most 10 linear iterations in each iteration."""
    from newton import Axis, ModelBuilder, solvers  # an optional package, imported where it is used

    system, start = run.case.system(run.resolution, run.constant)
    sheet = build(run.case.body(run.resolution, run.constant), BODY, False)
    builder = ModelBuilder(up_axis=Axis.Z, gravity=system.gravity)
    solvers.SolverStyle3D.register_custom_attributes(builder)
    corners = sheet.triangles.ravel().tolist()
    solvers.style3d.add_cloth_mesh(
        builder,
        pos=wp.vec3(0.0, 0.0, 0.0),
        rot=wp.quat_identity(),
        vel=wp.vec3(0.0, 0.0, 0.0),
        vertices=[wp.vec3(*position) for position in start],
        indices=corners,
        density=1.0,
        panel_verts=sheet.layout[:, :2].tolist(),
        panel_indices=corners,
        tri_aniso_ke=wp.vec3(2.0 * run.constant, 2.0 * run.constant, run.constant),
        edge_aniso_ke=wp.vec3(0.0, 0.0, 0.0),
    )
    builder.particle_mass[:] = np.where(system.fixed, 0.0, system.masses).tolist()
    model = finalized(builder, run)
    config = solvers.SolverStyle3D.Config(iterations=run.iterations, linear_iterations=10)
    with contextlib.redirect_stdout(io.StringIO()):  # it tells how long it takes, into the study's table
        solver = solvers.SolverStyle3D(model, config=config)
    solver.collision = None
    return run_newton(solver, start, run)


_FLEX = """
<mujoco>
  <option timestep="{dt}" gravity="{gravity}" integrator="Euler" solver="CG"><flag contact="disable"/></option>
  <size memory="400M"/>
  <worldbody>
    <flexcomp name="cloth" type="direct" dim="2" radius="0.0005" mass="0.2" point="{points}" element="{triangles}">
      <edge damping="0"/>
      <elasticity young="{young}" poisson="0.49" thickness="0.001" elastic2d="stretch"/>
      <contact selfcollide="none"/>
      <pin id="{pins}"/>
    </flexcomp>
  </worldbody>
</mujoco>
"""


def flex(run: Run) -> Frames:
    """Simulate by MuJoCo's flex, an elastic membrane of finite elements.

    The integrator is the one that MuJoCo asks for with small steps. It takes no iterations. Elastic forces are
    explicit, so that too few substeps blow up.
    """
    import mujoco

    model, data, start = _flex(run)
    kinds = mujoco.mjtWarning
    bad = (kinds.mjWARN_BADQPOS, kinds.mjWARN_BADQVEL, kinds.mjWARN_BADQACC)

    def frame() -> None:
        for _ in range(run.substeps):
            mujoco.mj_step(model, data)

    def positions() -> np.ndarray:
        blown_up = any(data.warning[kind].number for kind in bad)  # MuJoCo then starts again from rest
        return np.where(blown_up, np.nan, _vertices(model, data))

    return record(frame, positions, start, run.case.frames, wp.get_device("cpu"))


def flex_on_gpu(run: Run) -> Frames:
    """Simulate as `flex` by MuJoCo Warp, all worlds at once and a captured graph a frame."""
    import mujoco
    import mujoco_warp

    model, data, start = _flex(run)
    mujoco.mj_forward(model, data)
    device = wp.get_device(None if run.device == "auto" else run.device)
    with wp.ScopedDevice(device):
        there, state = mujoco_warp.put_model(model), mujoco_warp.put_data(model, data, nworld=run.worlds)
        still = [wp.clone(array) for array in (state.qpos, state.qvel)]
        mujoco_warp.step(there, state)  # compiles
        with wp.ScopedCapture() as capture:
            for _ in range(run.substeps):
                mujoco_warp.step(there, state)
        for array, start_of in zip((state.qpos, state.qvel), still, strict=True):
            wp.copy(array, start_of)

        def positions() -> np.ndarray:
            data.qpos[:] = state.qpos.numpy()[0]
            return _vertices(model, data)

        return record(partial(wp.capture_launch, capture.graph), positions, start, run.case.frames, device)


def _vertices(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Return the vertex positions (N, 3) [m] that follow from the joints in MuJoCo's data."""
    import mujoco

    mujoco.mj_kinematics(model, data)
    mujoco.mj_flex(model, data)
    return data.flexvert_xpos.copy()


def _flex(run: Run) -> tuple[mujoco.MjModel, mujoco.MjData, np.ndarray]:
    """Return MuJoCo's model of the case, its state at rest, and the vertex positions (N, 3) [m] then."""
    import mujoco

    system, start = run.case.system(run.resolution, run.constant)
    sheet = build(run.case.body(run.resolution, run.constant), BODY, False)
    mujoco.set_mju_user_warning(lambda text: None)  # runs that blow up are part of the study
    text = _FLEX.format(
        dt=FRAME_DT / run.substeps,
        gravity=_listed(system.gravity),
        points=_listed(start),
        triangles=_listed(sheet.triangles),
        young=1.5 * run.constant / 0.001,
        pins=_listed(np.flatnonzero(system.fixed)),
    )
    model = mujoco.MjModel.from_xml_string(text)
    model.body_mass[model.flex_vertbodyid[~system.fixed]] = system.masses[~system.fixed]
    data = mujoco.MjData(model)
    mujoco.mj_setConst(model, data)
    mujoco.mj_resetData(model, data)
    return model, data, start


def _listed(numbers: np.ndarray) -> str:
    return " ".join(f"{number:.9g}" for number in np.ravel(numbers))


OTHER_MODELS = (
    Peer("Style3D, from its own limit", "newton", style3d, on_gpu=True),
    Peer("MuJoCo flex, from its own limit", "mujoco", flex, on_gpu=False, worlds=False, iterates=False),
    Peer("MuJoCo Warp flex, from its own limit", "mujoco_warp", flex_on_gpu, on_gpu=True, on_cpu=False, iterates=False),
)
