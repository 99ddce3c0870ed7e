# SPDX-License-Identifier: Apache-2.0
"""States that are whole but hold what no simulation can go on from are refused, before anything large is read."""

import json
import os

import numpy as np
import pytest
from driven_scenes import contents, drive, make, saved, torn_scene

from cloth_sim_ros.sim import Simulation

SIMULATIONS = {"driven": lambda: make("auto", "cpu"), "torn": lambda: Simulation(torn_scene(), device="cpu")}


@pytest.fixture(scope="module", params=SIMULATIONS)
def state(request, tmp_path_factory):
    """A simulation, a file of its state, and what that holds: name -> array."""
    sim, path = SIMULATIONS[request.param](), tmp_path_factory.mktemp("state") / "good.npz"
    for k in range(8):
        if request.param == "driven":
            drive(sim, k)
        sim.step()
    sim.save(path)
    with np.load(path) as file:
        return sim, path, {name: file[name] for name in file.files}


def refusal(state, changed, save=np.savez):
    """The sentence with which the file is refused in which arrays are changed; the simulation stays as it is."""
    sim, path, arrays = state
    bad = path.with_name("bad.npz")
    save(bad, **{**arrays, **changed})
    with pytest.raises(ValueError) as error:
        sim.load(bad)
    sentence = str(error.value)
    assert "\n" not in sentence and str(bad) in sentence and "; allowed is" in sentence
    assert saved(sim, path.with_name("after.npz")) == contents(path)
    return sentence


def parts(array):
    """An array, or its fields one by one."""
    return [array[name] for name in array.dtype.names] if array.dtype.names else [array]


def test_numbers_that_are_not_finite_are_refused(state):
    _, _, arrays = state
    found = 0
    for name, rows in arrays.items():
        for k, part in enumerate(parts(rows)):
            if part.dtype.kind == "f" and part.size:
                bad = rows.copy()
                parts(bad)[k].flat[0] = (np.nan, np.inf, -np.inf)[found % 3]
                assert f"cannot be used: {name} has numbers that are not finite" in refusal(state, {name: bad})
                found += 1
    assert found > 30


def test_nothing_is_inflated(state):
    _, _, arrays = state
    assert "header is compressed or too large" in refusal(state, {}, np.savez_compressed)
    positions = arrays["batch0/positions"]
    huge = np.zeros((1, 1 << 16, 4), np.float32)
    assert "batch0/positions is compressed or too large" in refusal(state, {"batch0/positions": huge})
    assert "its arrays are not those" in refusal(state, {"batch0/positions": positions[:, :-1]})
    assert "its arrays are not those" in refusal(state, {"batch7/positions": positions})


def header(arrays):
    return json.loads(arrays["header"].tobytes())


def with_header(described):
    return {"header": np.frombuffer(json.dumps(described).encode(), np.uint8)}


def odd_headers(described):
    """Headers, each with one odd entry."""
    name = next(iter(described["choices"]))
    choice = described["choices"][name]
    for frames in (-1, True, 1e400, float("nan"), None, [1], 1 << 60):
        yield {"frames": frames}
    for field, values in {
        "method": ("auto", "euler", 3),
        "order": (0, 3, 1.5),
        "substeps": (0, -1, 1 << 30, True, "2"),
        "iterations": (0, 1 << 30),
        "safe_substeps": (0, 1 << 30),
        "surface": (2, None),
        "error": ("much",),
        "more": (1,),
    }.items():
        for value in values:
            yield {"choices": {**described["choices"], name: {**choice, field: value}}}
    for odd in (None, 1, "x", [], [[]], {"no such": 1}, {"no such": [1.0]}):
        for entry in ("choices", "settings", "structure", "pins", "grasps", "added"):
            if odd != described[entry]:
                yield {entry: odd}
    for entry, odd in (("scales", {"no such": 1}), ("scales", 1)):
        yield {entry: odd}
    for row in (0, -1, 1.5, 99, "1"):
        yield {"added": {"more": [row, "box", {}]}}


def test_odd_headers_are_refused(state):
    described = header(state[2])
    for odd in odd_headers(described):
        assert refusal(state, with_header({**described, **odd})), odd


def test_a_frame_without_end_is_refused(state):
    """Millions of substeps, and a trial that never ends, would hold up all who wait, and no signal ends them."""
    _, _, arrays = state
    numbers, found = {"substeps": (-1, 4_751_424), "factors": (-1, 1, 4_751_424), "divisors": (-1, 2, 50_529_024)}, 0
    for name, rows in arrays.items():
        for number in numbers.get(name.rpartition("/")[2], ()):
            assert "has numbers that are out of range" in refusal(state, {name: np.full_like(rows, number)})
            found += 1
    assert found >= 8


def test_indices_of_nothing_are_refused(state):
    _, _, arrays = state
    fields = {"grips": (..., 3), "panels": ..., "panel_parts": (..., 0), "winches": "index", "good_winches": "index"}
    found = 0
    for name, rows in arrays.items():
        field = fields.get(name.rpartition("/")[2])
        if field is not None and rows.size:
            for index in (-7, 1000):
                bad = rows.copy()
                bad[field] = index
                assert "has numbers that are out of range" in refusal(state, {name: bad})
                found += 1
    assert found


def test_what_is_no_regular_file_is_not_opened(state):
    sim, path, _ = state
    fifo = path.with_name("fifo")
    os.mkfifo(fifo)
    with pytest.raises(ValueError, match="fifo cannot be read: a FIFO is there, and no regular file; allowed is"):
        sim.load(fifo)


OTHERS = ("verlet, two worlds", "order 2, a launch a stage", "ropes")
LONG = [pytest.param(case, marks=pytest.mark.long) for case in OTHERS]


@pytest.mark.parametrize("case", ["auto", *LONG])
def test_a_state_after_a_fault_is_finite_and_goes_on_to_the_same_bits(case, device, tmp_path):
    """A body that was put back leaves NaN in what is written anew before it is read."""
    sim, other = make(case, device), make(case, device)
    sim.step(2)
    for name in sim.scene.objects:
        arrays, span, _ = sim.device_arrays(name)
        rows = arrays.state.velocities[span]
        rows.fill_(np.nan)
    sim.step()
    sim.save(tmp_path / "state.npz")
    other.load(tmp_path / "state.npz")
    for each in (sim, other):
        each.step(3)
    assert saved(sim, tmp_path / "one.npz").keys() == saved(other, tmp_path / "other.npz").keys()
    for name in sim.scene.objects:
        assert sim.report()[name]["recoveries"] == other.report()[name]["recoveries"] == 1
        assert sim.positions(name).tobytes() == other.positions(name).tobytes()


def test_particles_that_are_not_finite_are_not_saved(tmp_path):
    sim = Simulation(torn_scene(), device="cpu")
    arrays, span, _ = sim.device_arrays("sheet")
    arrays.state.velocities[span].fill_(np.nan)
    with pytest.raises(ValueError, match="cannot be written: batch.*/velocities are not finite; allowed are"):
        sim.save(tmp_path / "state.npz")
    assert not list(tmp_path.iterdir())
