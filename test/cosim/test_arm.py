# SPDX-License-Identifier: Apache-2.0
"""An arm in MuJoCo and a towel in its hand push one another, whatever their masses and however late wrenches are."""

import re
from collections import deque
from pathlib import Path

import numpy as np
import pytest

from cloth_sim_ros.sim import Box, Cloth, Handle, Scene, Settings, Simulation
from cloth_sim_ros.study.scene_file import read_plan

mujoco = pytest.importorskip("mujoco")
from cloth_sim_ros.cosim.arm import Arm, step  # noqa: E402

ROOT = Path(__file__).parents[2]
GRAVITY, FRAME, TOWEL = 9.81, 1.0 / 60.0, 0.2  # m/s^2, s, kg
FIXED = Settings(frame_dt=FRAME, method="xpbd", order=1, substeps=10)
UPRIGHT = (0.5, 0.5, 0.5, 0.5)


def arm_of(kg):
    """Model and data of the shipped arm, with all masses, gains and dampings in proportion, at its home."""
    model = mujoco.MjModel.from_xml_path(str(ROOT / "config/arm.xml"))
    for row in ("body_mass", "body_inertia", "dof_armature", "actuator_gainprm", "actuator_biasprm"):
        getattr(model, row)[:] *= kg / 5.0
    data = mujoco.MjData(model)
    mujoco.mj_setConst(model, data)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    assert model.body_subtreemass[1] == pytest.approx(kg)
    return model, data


def towel_at(hand, reach=0.05, **changes):
    """A towel that hangs from a hand by the middle of its upper edge."""
    given = {"resolution": (9, 9), "size": (0.4, 0.5), "mass": TOWEL, "pins": None, "orientation": UPRIGHT}
    given |= {"position": (hand[0], hand[1], hand[2] - 0.25), "bending": "dihedral", "bend_compliance": 3e3}
    given |= {"stretch_compliance": 2e-3, "shear_compliance": 1e-2, "damping": 2e-3, "thickness": 0.004}
    towel = Cloth(**given | changes)
    scene = Scene({"towel": towel}, handles={"hand": Handle(position=hand, reach=(reach,), attached=True)})
    return Simulation(scene, FIXED, device="cpu")


def run(sim, arm, seconds, delay, before=lambda t: None):
    """Wrenches (frames, 6) that the hand felt, which act `delay` frames later than they might."""
    late, felt = deque(), []
    for n in range(round(seconds / FRAME)):
        before(n * FRAME)
        arm.advance(FRAME)
        sim.set_handle_pose("hand", *arm.poses()["hand"])
        sim.step()
        felt.append(np.concatenate(sim.handle_wrench("hand")))
        late.append(felt[-1])
        if len(late) > delay:
            arm.feel("hand", late.popleft())
    return np.array(felt)


def moved_and_left(kg, delay, seconds, moved=4.0, **how):
    """What the hand felt while the arm swung for a while and then stayed, and what the motors then hold [N]."""
    model, data = arm_of(kg)
    arm = Arm(model, data, ["hand"], delay=delay, **{"load": TOWEL, **how})
    sim = towel_at(arm.poses()["hand"][0])
    home = data.ctrl.copy()

    def swing(t):
        data.ctrl[:] = home + (0.3 * np.sin(np.pi * t) * np.array([1, 0.5, -0.5, 1, 1, 1]) if t < moved else 0.0)

    felt = run(sim, arm, seconds, delay, swing)
    jacobian = np.zeros((6, 6))
    site = model.site("hand").id
    mujoco.mj_jac(model, data, jacobian[:3], jacobian[3:], data.site_xpos[site], model.site_bodyid[site])
    return felt, np.linalg.solve(jacobian.T, data.qfrc_actuator)


@pytest.mark.long
@pytest.mark.parametrize("delay", [0, 1, 3])
@pytest.mark.parametrize("kg", [0.5, 1.0, 5.0, 20.0])
def test_a_towel_comes_to_rest_on_light_and_heavy_arms(kg, delay):
    felt, motors = moved_and_left(kg, delay, 60.0)
    parts = felt[:, 2].reshape(12, -1)
    assert (parts.std(axis=1)[2:] < 0.1).all() and parts.std(axis=1)[-1] < 0.03
    assert np.abs(felt[:, :3]).max() < 3.0 * TOWEL * GRAVITY, "no more than it takes to swing it"
    assert parts[-1].mean() == pytest.approx(-TOWEL * GRAVITY, rel=1e-3)
    assert motors[2] == pytest.approx(TOWEL * GRAVITY, rel=0.01)
    assert np.abs(motors[:2]).max() < 0.1, "it still swings a little"


def test_the_lightest_arm_stays_in_hand_and_would_not_by_plain_turns():
    felt, motors = moved_and_left(0.5, 1, 16.0, moved=2.0)
    assert felt[-300:, 2].std() < 0.1 and motors[2] == pytest.approx(TOWEL * GRAVITY, rel=0.05)
    plain, _ = moved_and_left(0.5, 1, 8.0, moved=2.0, load=0.0)
    assert not plain[-120:, 2].std() < 2.0


@pytest.mark.parametrize(("ratio", "close"), [(0.1, 0.01), (0.4, 0.01), (1.0, 0.02), (10.0, 0.15)])
@pytest.mark.parametrize("delay", [0, 3])
def test_a_pushed_hand_and_its_load_go_as_one_mass(ratio, close, delay):
    """v = F t / (m + M), as of one rigid body; the load does not bounce."""
    hand, force = TOWEL / ratio, 0.5
    model, data = on_a_slide(hand, "1 0 0")
    model.opt.gravity[:] = 0.0
    data.qfrc_applied[0] = force
    arm = Arm(model, data, ["hand"], TOWEL, ringing=0.0, delay=delay)
    sim = towel_at((0.0, 0.0, 1.0), reach=1.0, size=(0.02, 0.02), resolution=(3, 3), position=(0.0, 0.0, 1.0))
    sim.set("gravity", (0.0, 0.0, 0.0))
    felt = run(sim, arm, 2.0, delay)
    assert data.qvel[0] == pytest.approx(force * 2.0 / (hand + TOWEL), rel=close)
    assert np.mean(felt[-30:, 0]) == pytest.approx(-force * TOWEL / (hand + TOWEL), rel=0.05 + close)


def on_a_slide(kg, axis, more=""):
    """Model and data of a plate of 0.4 m on a slide, whose middle is the site `hand`."""
    return body(f"""<joint type="slide" axis="{axis}" {more}/>
        <geom name="plate" type="box" size="0.2 0.2 0.01" mass="{kg}"/><site name="hand" size="0.02"/>""")


def body(text):
    """Model and data of one body at a height of 1 m; a step of MuJoCo is no part of a frame."""
    start = '<mujoco><option timestep="0.003"/><worldbody><body pos="0 0 1">'
    text = f"{start}{text}</body></worldbody></mujoco>"
    model = mujoco.MjModel.from_xml_string(text)
    return model, mujoco.MjData(model)


@pytest.mark.parametrize("kg", [0.5, 5.0])
def test_momentum_of_both_is_what_gravity_gave(kg):
    """A hand that was thrown with its towel, and turns as it flies."""
    shape = f'<geom type="box" size="0.05 0.04 0.03" mass="{kg}"/>'
    model, data = body(f'<freejoint/>{shape}<site name="hand" size="0.05"/>')
    arm = Arm(model, data, ["hand"], TOWEL)
    sim = towel_at(arm.poses()["hand"][0])
    thrown, masses, seconds = np.array([1.0, 0.3, 2.0]), sim.masses("towel")[:, None], 4.0
    data.qvel[:3] = thrown
    sim.set_velocities("towel", np.tile(thrown, (81, 1)))
    run(sim, arm, seconds, 0)
    after = kg * data.qvel[:3] + (masses * sim.velocities("towel")).sum(axis=0)
    given = np.array([0.0, 0.0, -(kg + TOWEL) * GRAVITY * seconds])
    assert np.linalg.norm(after - (kg + TOWEL) * thrown - given) < 0.01 * np.linalg.norm(given)


@pytest.mark.parametrize("delay", [0, 3])
def test_momentum_of_both_is_what_gravity_and_the_foot_gave(delay):
    """While the arm swings the towel; what the foot gives is read from a force sensor in each step of MuJoCo."""
    model, data = arm_of(5.0)
    arm = Arm(model, data, ["hand"], TOWEL, delay=delay)
    sim = towel_at(arm.poses()["hand"][0])
    home, masses, seconds, given = data.ctrl.copy(), sim.masses("towel")[:, None], 6.0, np.zeros(3)
    run(sim, arm, 2.0, delay)
    once = mujoco.mj_step

    def momentum():
        mujoco.mj_subtreeVel(model, data)
        return 5.0 * data.subtree_linvel[1] + (masses * sim.velocities("towel")).sum(axis=0)

    def watched(model, data, count):
        for _ in range(count):
            once(model, data)
            given[:] += model.opt.timestep * data.sensor("foot").data

    before = momentum()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("cloth_sim_ros.cosim.arm.mujoco.mj_step", watched)
        swing = np.array([1.0, 0.5, -0.5, 1.0, 1.0, 1.0])
        run(
            sim, arm, seconds, delay, lambda t: data.ctrl.__setitem__(slice(None), home + 0.3 * np.sin(3.0 * t) * swing)
        )
    weight = (5.0 + TOWEL) * GRAVITY * seconds
    error = momentum() - before - given + (0.0, 0.0, weight)
    assert np.abs(given[2]) > 0.9 * weight and np.linalg.norm(error) < 0.01 * weight


def test_what_lies_on_a_geom_weighs_on_it():
    """A plate on a spring sinks by m g / k under a cloth that falls on it."""
    model, data = on_a_slide(0.1, "0 0 1", 'stiffness="100" damping="1"')
    model.opt.gravity[:] = 0.0
    arm = Arm(model, data, ["plate"], TOWEL)
    cloth = Cloth(resolution=(7, 7), size=(0.3, 0.3), mass=TOWEL, pins=None, position=(0, 0, 1.03), thickness=0.004)
    plate = Box(half_extents=(0.2, 0.2, 0.01), position=(0.0, 0.0, 1.0))
    sim = Simulation(Scene({"cloth": cloth}, {"plate": plate}), FIXED, device="cpu")
    step(sim, arm, 600)
    assert data.qpos[0] == pytest.approx(-TOWEL * GRAVITY / 100.0, rel=0.01)


def test_a_wrench_that_nothing_follows_ends():
    model, data = on_a_slide(1.0, "1 0 0")
    arm = Arm(model, data, ["hand"], TOWEL)
    for _ in range(200):
        arm.advance(0.01)
        arm.feel("hand", (1.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert arm.wrench("hand")[0] == pytest.approx(1.0, abs=1e-3)
    arm.advance(1.5)
    assert not arm.wrench("hand").any()


def test_forces_that_others_apply_stay():
    ball = '<geom name="{0}" type="sphere" size="0.1" mass="2"/>'
    model, data = body(f'{ball.format("hand")}</body><body><joint type="slide"/>{ball.format("other")}')
    data.xfrc_applied[2, 2] = 2.0 * GRAVITY + 1.0
    Arm(model, data, ["hand"], TOWEL).advance(1.0)
    assert data.qvel[0] == pytest.approx(0.5, rel=1e-6)


def test_what_cannot_be_is_refused():
    model, data = on_a_slide(1.0, "1 0 0")
    with pytest.raises(ValueError, match="neither a site nor a geom 'foot'"):
        Arm(model, data, ["foot"], TOWEL)
    with pytest.raises(ValueError, match="load is -1; allowed are numbers from 0 on"):
        Arm(model, data, ["hand"], -1.0)
    with pytest.raises(ValueError, match="delay is nan"):
        Arm(model, data, ["hand"], TOWEL, delay=float("nan"))
    arm = Arm(model, data, ["hand"], TOWEL)
    arm.advance(0.01)
    with pytest.raises(ValueError, match="the wrench of hand is not finite"):
        arm.feel("hand", (float("nan"), 0.0, 0.0, 0.0, 0.0, 0.0))


def test_the_scene_has_the_shapes_of_the_model():
    scene = read_plan(ROOT / "config/arm.yaml").scene
    model, data = arm_of(5.0)
    arm = Arm(model, data, ["hand", "upper", "lower", "pedestal"], TOWEL)
    for name, (position, orientation) in arm.poses().items():
        thing = {**scene.colliders, **scene.handles}[name]
        assert thing.position == pytest.approx(position, abs=1e-6)
        assert abs(np.dot(thing.orientation, orientation)) == pytest.approx(1.0, abs=1e-9)
    assert scene.colliders["upper"].half_extents == pytest.approx(model.geom("upper").size)
    for name in ("lower", "pedestal"):
        radius, half_length, _ = model.geom(name).size
        assert (scene.colliders[name].radius, scene.colliders[name].half_length) == pytest.approx((radius, half_length))
    assert scene.handles["hand"].reach == pytest.approx(model.site("hand").size[:1])
    assert Simulation(scene, FIXED, device="cpu").masses("towel").sum() == pytest.approx(TOWEL, rel=0.02)


def test_the_example_of_the_guide_runs(monkeypatch, capsys):
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "docs/how-to/mujoco.md").read_text(), flags=re.DOTALL)
    monkeypatch.chdir(ROOT)
    exec(code, {})
    assert float(re.search(r"carries ([\d.]+) N", capsys.readouterr().out)[1]) == pytest.approx(0.2 * GRAVITY, rel=0.02)
