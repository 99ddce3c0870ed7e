# SPDX-License-Identifier: Apache-2.0
"""A cable that MuJoCo computed: the numbers that are found, and what they predict of a motion that was not fitted."""

import numpy as np
import pytest

from cloth_sim_ros.identify.cable import Cable
from cloth_sim_ros.identify.cable_candidates import CableCandidates
from cloth_sim_ros.identify.fit import identify
from cloth_sim_ros.identify.markers import Markers

mujoco = pytest.importorskip("mujoco")

RATE, SEGMENTS, LENGTH, RADIUS, DENSITY = 100.0, 40, 0.8, 0.004, 0.1
EI, GJ, VISCOSITY = 4e-3, 3e-3, 0.01
STEPS = 50  # a frame
AT = [0, 1, *range(4, 37, 4), 39, 40]  # markers among the ends of segments
AREA = 0.25 * np.pi * RADIUS**4  # second moment [m^4]
HELD = 'solref="0.0004 1" solimp="0.999 0.9999 0.0001"'
CABLE = f"""
<mujoco>
  <extension><plugin plugin="mujoco.elasticity.cable"/></extension>
  <option timestep="{1.0 / (RATE * STEPS)}" viscosity="{VISCOSITY}" integrator="implicitfast"/>
  <worldbody>
    <body name="start" mocap="true"/>
    <body name="end" mocap="true"/>
    <composite type="cable" curve="s" count="{SEGMENTS + 1} 1 1" size="{LENGTH}" initial="free">
      <plugin plugin="mujoco.elasticity.cable">
        <config key="twist" value="{GJ / (2 * AREA)}"/>
        <config key="bend" value="{EI / AREA}"/>
      </plugin>
      <joint kind="main" damping="1"/>
      <geom type="capsule" size="{RADIUS}" mass="{DENSITY * LENGTH / SEGMENTS}" contype="0" conaffinity="0"/>
    </composite>
  </worldbody>
  <equality>
    <weld body1="start" body2="B_first" relpose="0 0 0 1 0 0 0" {HELD}/>
    <weld body1="end" body2="B_last" relpose="{-LENGTH / SEGMENTS} 0 0 1 0 0 0" {HELD}/>
  </equality>
</mujoco>
"""


def record(seed, bend_damping, frames=100, before=25):
    """Markers (F, M, 3) of MuJoCo's cable, whose ends are moved about; it moves as they begin."""
    random = np.random.default_rng(seed)
    model = mujoco.MjModel.from_xml_string(CABLE)
    model.dof_damping[6:] = EI * bend_damping * SEGMENTS / LENGTH  # of all joints, in twist too
    data, rows = mujoco.MjData(model), []
    swing, phase = random.uniform(0.05, 0.1, 3), random.uniform(0, 6, 3)
    for step in range(1, (before + frames) * STEPS + 1):
        time = step / (RATE * STEPS)
        data.mocap_pos[0] = swing * (np.sin(6.0 * time + phase) - np.sin(phase))
        data.mocap_pos[1] = LENGTH * (1.0 - 0.3 * min(1.0, 3.0 * time)), 0.0, 0.0
        mujoco.mj_step(model, data)
        if step % STEPS == 0:
            rows.append(np.vstack([data.body("B_first").xpos, *data.xpos[4 : 3 + SEGMENTS], data.site("S_last").xpos]))
    return np.array(rows)[before:, AT]


def predicted(bend_damping):
    """Values that two runs tell, and by which share of its RMS motion a third is off."""
    runs = [record(seed, bend_damping) for seed in (1, 2, 3)]
    fitted, judged = Markers(runs[:2], RATE), Markers(runs[2:], RATE)
    candidates = CableCandidates(Cable(fitted.lengths(), density=DENSITY), fitted, 16, 2, "cpu")
    found = identify(candidates)[1]
    off = CableCandidates(candidates.cable, judged, 1, 2, "cpu").off(found.units[None])[0][:, 0]
    moved = runs[2][2:] - runs[2][1]
    return found.values, np.sqrt((off**2).sum() / (moved**2).sum())


@pytest.mark.long
@pytest.mark.parametrize("bend_damping", [0.002, 0.05])
def test_a_motion_of_another_simulator_is_predicted(bend_damping):
    """MuJoCo's joints damp bends that grow, bends that go about the cable, and twist."""
    values, share = predicted(bend_damping)
    assert 1.0 / values[0] == pytest.approx(EI, rel=0.05)
    assert values[1] == pytest.approx(bend_damping, rel=0.15)
    assert share < 0.01
