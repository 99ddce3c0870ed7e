# SPDX-License-Identifier: Apache-2.0
"""The numbers of a cable from markers on it, recorded in motion, finer than it is fitted and with noise."""

import numpy as np
import pytest
import yaml

from cloth_sim_ros.identify import fit_cable, recordings
from cloth_sim_ros.identify.cable import Cable, guesses, mean_error
from cloth_sim_ros.identify.cable_bag import CableTopics
from cloth_sim_ros.identify.cable_candidates import CableCandidates
from cloth_sim_ros.identify.cable_shape import PLACES, fit_shape
from cloth_sim_ros.identify.fit import by_least_squares, identify
from cloth_sim_ros.identify.markers import Markers
from cloth_sim_ros.sim import Handle, Rope, Scene, Settings, Simulation

RATE, LENGTH, MASS, SEEN, PER = 60.0, 0.8, 0.08, 9, 6
EI, BEND_DAMPING, DRAG, GJ = 4e-3, 0.05, 0.8, 3e-3


def record(seed, noise, frames=50, before=15, forces=None, clamp=0.0, turn=0.0):
    """Markers (F, 9, 3) of a cable whose start is held by two of them, and moved about; it moves as they begin.

    What it pulls at its start with (3,) goes into the list `forces`, a row a frame. Its start points by the angle
    `clamp` [rad] off the line of the markers there. Its end is turned by `turn` [rad].
    """
    random = np.random.default_rng(seed)
    marks = np.concatenate([[0.0], np.linspace(0.02, LENGTH - 0.02, SEEN - 2), [LENGTH]])
    at = np.concatenate([[0], 1 + PER * np.arange(SEEN - 2), [PER * (SEEN - 3) + 2]])
    points = np.zeros((at[-1] + 1, 3))
    points[:, 0] = np.interp(np.arange(len(points)), at, marks)
    held = [0, 1, len(points) - 2, len(points) - 1]
    rope = Rope(
        points=points,
        mass=MASS,
        radius=0.004,
        pins=None,
        stretch_compliance=1e-4,
        bend_compliance=1.0 / EI,
        bend_damping=BEND_DAMPING,
        twist_compliance=1.0 / GJ,
    )
    handles = {f"h{k}": Handle(position=tuple(points[i]), reach=0.001, attached=True) for k, i in enumerate(held)}
    settings = Settings(frame_dt=1 / RATE, substeps=40, global_damping=DRAG)
    sim = Simulation(Scene({"it": rope}, handles=handles), settings, "cpu")
    turns = np.zeros((1, len(points) - 2, 2))
    turns[0, 0] = clamp, 0.0
    sim.write("it", "rest_turns", turns)
    sim.set("it.end_turn", turn)
    swing, phase, rows = random.uniform(0.05, 0.1, 3), random.uniform(0, 6, 3), []
    for frame in range(before + frames):
        time = (frame + 1) / RATE
        moved = swing * (np.sin(6.0 * time + phase) - np.sin(phase))
        inwards = np.array([0.3 * LENGTH * min(1.0, 3.0 * time), 0.0, 0.0])
        for k, i in enumerate(held):
            sim.set_handle_pose(f"h{k}", points[i] + (moved if k < 2 else -inwards))
        sim.step()
        rows.append(sim.positions("it")[at].astype(np.float64))
        if forces is not None and frame >= before:
            forces.append(sim.handle_wrench("h0")[0] + sim.handle_wrench("h1")[0])
    seen = np.array(rows)[before:]
    seen[:, 2:-2] += noise * random.standard_normal(seen[:, 2:-2].shape)
    return seen


def fitted(runs, start=4):
    markers = Markers(runs, RATE)
    candidates = CableCandidates(Cable(markers.lengths(), between=PER, density=MASS / LENGTH), markers, 8, start, "cpu")
    return candidates, identify(candidates)[1]


@pytest.mark.long
def test_numbers_come_back_from_a_start_in_motion():
    """Markers do not tell how far the material lags behind its balance at the start, so that this is found as well."""
    candidates, found = fitted([record(1, 0.0), record(2, 0.0)])
    assert 1.0 / found.values[0] == pytest.approx(EI, rel=0.01)
    assert found.values[1] == pytest.approx(BEND_DAMPING, rel=0.03)
    assert found.values[2] == pytest.approx(DRAG, rel=0.03)
    assert 1.0 / found.values[3] == pytest.approx(GJ, rel=0.05)
    off = candidates.off(found.units[None])[0]
    assert mean_error(off) < 1e-3 < 0.1 * mean_error(guesses(Markers([record(1, 0.0)], RATE), 2)["blend"])


@pytest.mark.long
def test_noise_is_borne_and_told():
    """With 2 mm of noise on the markers between the hands."""
    _, found = fitted([record(3, 2e-3), record(4, 2e-3)])
    truth = np.array([1.0 / EI, BEND_DAMPING, DRAG, 1.0 / GJ, 1.0])
    assert found.values == pytest.approx(truth, rel=0.08)
    assert (found.low < truth).all() and (truth < found.high).all() and (found.high < 1.35 * found.low).all()


@pytest.mark.long
def test_a_wrist_force_tells_mass_and_rigidity_apart():
    """With 2 mm of noise on markers, 2 % on forces, and a density that is given wrong by half."""
    forces = [[], []]
    runs = [record(seed, 2e-3, forces=pulls) for seed, pulls in zip((1, 2), forces, strict=True)]
    random, pulls = np.random.default_rng(0), np.array(forces, dtype=np.float64)
    pulls += 0.02 * np.sqrt((pulls**2).sum(axis=2).mean()) * random.standard_normal(pulls.shape)
    markers = Markers(runs, RATE, list(pulls))
    cable = Cable(markers.lengths(), between=PER, density=1.5 * MASS / LENGTH)
    candidates = CableCandidates(cable, markers, 8, 4, "cpu")
    found = identify(candidates)[1]
    assert 1.0 / found.values[0] == pytest.approx(EI, rel=0.03)
    assert candidates.weighed(found.values).density == pytest.approx(MASS / LENGTH, rel=0.03)


def test_a_marker_that_is_not_seen_counts_nowhere():
    run = record(1, 0.0, frames=12)
    gone = run.copy()
    gone[6:, 4] = np.nan
    both = [Markers([each], RATE) for each in (run, gone)]
    candidates = [CableCandidates(Cable(both[0].lengths()), each, 1, 2, "cpu") for each in both]
    whole, part = (each.off(np.full((1, 5), 0.5))[0] for each in candidates)
    left = np.isfinite(part)
    assert np.count_nonzero(~left) == 3 * 6 and candidates[1].count == np.count_nonzero(left)
    assert mean_error(part) == pytest.approx(mean_error(whole[left]), rel=1e-6)
    assert np.isfinite(candidates[1].residuals(np.full((1, 5), 0.5))).all()
    assert np.isfinite([mean_error(each) for each in guesses(both[1], 2).values()]).all()


@pytest.mark.long
def test_a_clamp_that_points_off_its_markers_is_found():
    markers = Markers([record(seed, 0.0, clamp=0.15) for seed in (1, 2)], RATE)
    cable = Cable(markers.lengths(), between=PER, density=MASS / LENGTH)
    candidates = CableCandidates(cable, markers, 8, 4, "cpu", shaped=True)
    low, high = (np.log([getattr(each, end) for each in candidates.sought]) for end in ("low", "high"))
    units = (np.log([1.0 / EI, BEND_DAMPING, DRAG, 1.0 / GJ, 1.0]) - low) / (high - low)
    before = mean_error(candidates.off(units[None]))
    units = fit_shape(candidates, units)[0]
    at_start, at_end = np.linalg.norm(candidates.cable.bends[PLACES:], axis=1)
    # Bends nearby take a part, and shapes are found before lags at the start.
    assert at_start > 1.5 * at_end and 0.05 < at_start < 0.16
    assert mean_error(candidates.off(units[None])) < 0.2 * before


@pytest.mark.long
def test_another_turn_is_found_from_one_without_torsion():
    turn = 2.5
    markers = Markers([record(seed, 0.0, turn=turn) for seed in (1, 2)], RATE)
    candidates = CableCandidates(Cable(markers.lengths(), between=PER, density=MASS / LENGTH), markers, 12, 4, "cpu")
    low, high = (np.log([getattr(each, end) for each in candidates.sought]) for end in ("low", "high"))
    astray = (np.log([1.0 / EI, BEND_DAMPING, DRAG, np.exp(high[3]), np.exp(-0.5)]) - low) / (high - low)
    for start, arrives in ((astray, False), (candidates.others(astray)[0], True)):
        found = candidates.values(by_least_squares(candidates, start)[None])[0]
        assert (found[3:] == pytest.approx([1.0 / GJ, np.exp(turn)], rel=0.4)) is arrives


def test_frames_that_a_recorder_lost_are_put_back():
    run = record(1, 0.0)
    kept = np.r_[:20, 26 : len(run)]
    markers = Markers([run[kept], run], RATE)
    short, whole = markers.filled([0, 1, SEEN - 2, SEEN - 1]).runs
    assert short[kept] == pytest.approx(run[kept]) and np.isnan(short[20:26]).all() and len(short) == len(run)
    assert whole[: len(kept)] == pytest.approx(run[: len(kept)]) and np.isnan(whole[len(kept) :]).all()
    off = CableCandidates(Cable(Markers([run], RATE).lengths()), markers, 1, 2, "cpu").off(np.full((1, 5), 0.5))[0]
    assert np.isnan(off[18:24, 0]).all() and np.isfinite(off[24:, 0]).all()
    assert off[24 : len(kept) - 2, 0] == pytest.approx(off[24 : len(kept) - 2, 1], abs=2e-3)


def test_files_are_read_and_refused_in_one_sentence(tmp_path):
    run = record(1, 0.0, frames=12, before=1)
    np.savez(tmp_path / "a.npz", train=np.round(run[None] / 5e-5).astype(np.int16), unit=5e-5, rate_hz=RATE)
    rows = np.column_stack([np.arange(len(run)) / RATE, run.reshape(len(run), -1)])
    np.savetxt(tmp_path / "b.csv", rows, delimiter=",", header=",".join(["time"] + ["x", "y", "z"] * SEEN), comments="")
    both = Markers.read([tmp_path / "a.npz", tmp_path / "b.csv"])
    assert both.rate == pytest.approx(RATE, rel=1e-6) and len(both.runs) == 2
    assert both.runs[0] == pytest.approx(both.runs[1], abs=5e-5)
    (tmp_path / "c.csv").write_text("1,2\n3,4\n")
    np.savez(tmp_path / "d.npz", one=run, two=run, rate=RATE)
    np.savez(tmp_path / "e.npz", one=run)
    for name, why in {"c.csv": "2 columns", "d.npz": "2 arrays", "e.npz": "no even times", "f.npz": "be read"}.items():
        with pytest.raises(ValueError, match=why):
            Markers.read([tmp_path / name])
    with pytest.raises(ValueError, match="one run"):
        Markers([run], RATE).split(5)


def test_a_part_of_each_recording_is_used(tmp_path):
    run = record(1, 0.0, frames=30, before=1)
    np.savez(tmp_path / "a.npz", markers=run, rate=RATE, forces=run[:, 0])
    part = Markers.read([tmp_path / "a.npz"], begin=5 / RATE, end=20 / RATE)
    assert part.runs[0] == pytest.approx(run[5:21]) and part.forces[0] == pytest.approx(run[5:21, 0])
    assert Markers.read([tmp_path / "a.npz"], begin=4.5 / RATE).runs[0] == pytest.approx(run[5:])
    for span in ((-0.1, 1.0), (0.4, np.inf), (0.2, 0.3), (np.nan, 1.0)):
        with pytest.raises(ValueError, match="--begin is .*which lasts 0.483 s; allowed are times with 10 frames"):
            Markers.read([tmp_path / "a.npz"], CableTopics(), *span)


def test_the_command_fits_judges_and_writes(tmp_path, monkeypatch, capsys):
    runs = np.stack([record(seed, 0.0, frames=20) for seed in (1, 2)])
    np.savez(tmp_path / "runs.npz", markers=runs, rate=RATE)
    output = tmp_path / "found" / "cable.yaml"
    monkeypatch.setattr("sys.argv", ["fit_cable", str(tmp_path / "runs.npz"), "--output", str(output)])
    assert fit_cable.main() == 0
    told = capsys.readouterr().out
    assert "in 1 runs that were not fitted (1 were)" in told and output.with_suffix(".png").stat().st_size > 0
    cable = yaml.safe_load(output.read_text())["/**"]["ros__parameters"]["cable"]
    assert 0.5 * EI < 1.0 / cable["bend_compliance"] < 2.0 * EI
    monkeypatch.setattr("sys.argv", ["fit_cable", str(tmp_path / "none.csv")])
    assert fit_cable.main() == 2 and "cannot be read" in capsys.readouterr().err


@pytest.mark.long
def test_a_folder_of_cables_is_judged(tmp_path, monkeypatch, capsys):
    """A file of several runs is a cable, and files of one run are a cable together."""
    runs = [record(seed, 0.0, frames=12) for seed in (1, 2)]
    (tmp_path / "in" / "other").mkdir(parents=True)
    np.savez(tmp_path / "in" / "one.npz", markers=np.stack(runs), rate=RATE)
    for k, run in enumerate(runs):
        np.savez(tmp_path / "in" / "other" / f"{k}.npz", markers=run, rate=RATE)
    found = dict(recordings.cables(tmp_path / "in", CableTopics()))
    assert {name: len(files) for name, files in found.items()} == {"one": 1, "other": 2}
    command = ["recordings", str(tmp_path / "in" / "other"), "--output", str(tmp_path / "out"), "--worlds", "8"]
    monkeypatch.setattr("sys.argv", command)
    assert recordings.main() == 0
    told = capsys.readouterr().out
    assert "fitted  by marker [mm] 0.0 0.0 " in told and (tmp_path / "out" / "other.png").stat().st_size > 0
    monkeypatch.setattr("sys.argv", ["recordings", str(tmp_path / "out")])
    assert recordings.main() == 2 and "has no recordings" in capsys.readouterr().err


def test_forces_are_read_from_both_files(tmp_path):
    run, pulls = record(1, 0.0, frames=12), np.ones((12, 3))
    np.savez(tmp_path / "a.npz", markers=run, rate=RATE, forces=pulls)
    names = ",".join(["time", *["x", "y", "z"] * SEEN, "fx", "fy", "fz"])
    rows = np.column_stack([np.arange(len(run)) / RATE, run.reshape(len(run), -1), pulls])
    np.savetxt(tmp_path / "b.csv", rows, delimiter=",", header=names, comments="")
    both = Markers.read([tmp_path / "a.npz", tmp_path / "b.csv"])
    assert len(both.forces) == 2 and both.count == SEEN and np.concatenate(both.forces) == pytest.approx(1.0)
    np.savez(tmp_path / "c.npz", markers=run, rate=RATE, forces=pulls[:3])
    with pytest.raises(ValueError, match="forces of shape"):
        Markers.read([tmp_path / "c.npz"])
