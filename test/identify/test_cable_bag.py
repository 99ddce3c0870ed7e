# SPDX-License-Identifier: Apache-2.0
"""A cable found in bags: markers of several kinds of messages, and forces in the axes of a sensor that turns."""

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

pytest.importorskip("rosbags")

from robot_messages import array, cloud, pose, transforms, wrench, write
from test_cable import EI, LENGTH, MASS, PER, RATE, record

from cloth_sim_ros.identify import fit_cable
from cloth_sim_ros.identify.cable import Cable
from cloth_sim_ros.identify.cable_bag import CableTopics
from cloth_sim_ros.identify.cable_candidates import CableCandidates
from cloth_sim_ros.identify.fit import identify
from cloth_sim_ros.identify.markers import Markers

START = 1_700_000_000.0  # [s], of the first frame
CAMERA = Rotation.from_euler("xyz", [2.0, 0.3, -0.7]), np.array([0.4, -1.2, 0.8])  # in the frame "world"
TOPICS = CableTopics(["/start", "/between", "/end"], ["/wrist"], "world")
COMMAND = ["--markers", *TOPICS.markers, "--wrench", "/wrist", "--frame", "world"]


def wrist(time):
    """How the sensor is turned: about a fixed axis, which interpolation of tf follows."""
    return Rotation.from_rotvec([0.0, 0.0, 0.3]) * Rotation.from_rotvec([1.5 * time, 0.0, 0.0])


def bag_of(path, run, pulls, lost=(), **changed):
    """Two markers of the start, what a camera sees between in its own axes, and two of the end; a wrist's sensor."""
    stamps = [(k, START + k / RATE) for k in range(len(run)) if k not in lost]
    seen = [CAMERA[0].inv().apply(each[2:-2] - CAMERA[1]) for each in run]
    fine = np.arange(-0.1, len(run) / RATE + 0.1, 0.002)
    pull = np.stack([np.interp(fine, np.arange(len(run)) / RATE, column) for column in np.transpose(pulls)], axis=1)
    between = [of_cloud(stamp, "camera", seen[k]) for k, stamp in stamps]
    write(
        path,
        {
            "/tf_static": [transforms(0, "world", "camera", *CAMERA)],
            "/tf": [transforms(START + time, "world", "wrist", wrist(time), [1.0, 2.0, 3.0]) for time in fine],
            "/start": [array(stamp, "world", run[k][:2]) for k, stamp in stamps],
            "/between": between,
            "/end": [array(stamp, "world", run[k][-2:]) for k, stamp in stamps],
            "/wrist": [
                wrench(START + time, "wrist", wrist(time).inv().apply(force))
                for time, force in zip(fine, pull, strict=True)
            ],
        }
        | changed,
    )
    return path


def of_cloud(stamp, frame, points):
    """A cloud of just these points, in one row."""
    whole = cloud(stamp, frame, points, "<f8")
    whole.height, whole.width = 1, len(points)
    whole.row_step = whole.point_step * whole.width
    whole.data = whole.data[: whole.row_step]
    return whole


def test_all_is_brought_into_one_frame_and_even_times(tmp_path):
    pulls = []
    run = record(1, 0.0, frames=20, forces=pulls)
    lost = [8, 9, 10]
    markers = Markers.read([bag_of(tmp_path / "bag", run, pulls, lost)], TOPICS)
    assert markers.rate == pytest.approx(RATE, rel=1e-5)
    (seen,), (felt,) = markers.runs, markers.forces
    kept = np.delete(np.arange(20), lost)
    assert seen[kept] == pytest.approx(run[kept], abs=1e-6) and np.isnan(seen[lost]).all()
    assert felt == pytest.approx(np.array(pulls), abs=2e-2 * np.abs(pulls).max())
    off = CableCandidates(Cable(markers.lengths()), markers, 1, 2, "cpu").off(np.full((1, 6), 0.5))[0]
    assert np.isnan(off[6:9, :, :-1]).all() and np.isfinite(off[9:]).all() and np.isfinite(off[:, :, -1]).all()


def test_each_marker_may_have_a_topic(tmp_path):
    run = record(1, 0.0, frames=12)
    still = Rotation.identity()
    topics = {
        f"/marker_{m}": [pose(START + k / RATE, "mocap", row[m], still) for k, row in enumerate(run)]
        for m in range(run.shape[1])
    }
    write(tmp_path / "bag", topics)
    markers = Markers.read([tmp_path / "bag"], CableTopics(list(topics)))
    assert markers.forces is None and markers.runs[0] == pytest.approx(run, abs=1e-6)


@pytest.mark.long
def test_a_wrench_in_a_bag_tells_mass_and_rigidity_apart(tmp_path):
    """With a density that is given wrong by half."""
    paths = []
    for seed in (1, 2):
        pulls = []
        run = record(seed, 0.0, forces=pulls)
        paths.append(bag_of(tmp_path / f"bag_{seed}", run, pulls))
    markers = Markers.read(paths, TOPICS)
    cable = Cable(markers.lengths(), between=PER, density=1.5 * MASS / LENGTH)
    candidates = CableCandidates(cable, markers, 8, 4, "cpu")
    found = identify(candidates)[1]
    assert 1.0 / found.values[0] == pytest.approx(EI, rel=0.03)
    assert candidates.weighed(found.values).density == pytest.approx(MASS / LENGTH, rel=0.03)


@pytest.mark.long
def test_the_command_fits_bags(tmp_path, monkeypatch, capsys):
    for seed in (1, 2):
        pulls = []
        run = record(seed, 0.0, frames=20, forces=pulls)
        bag_of(tmp_path / f"run_{seed}", run, pulls)
    output = tmp_path / "cable.yaml"
    command = ["fit_cable", str(tmp_path / "run_1"), "--judge", str(tmp_path / "run_2"), "--no-shape", *COMMAND]
    monkeypatch.setattr("sys.argv", [*command, "--output", str(output)])
    assert fit_cable.main() == 0
    assert "and forces tell them apart" in capsys.readouterr().out
    assert yaml.safe_load(output.read_text())["/**"]["ros__parameters"]["cable"]["mass"] == pytest.approx(
        MASS, rel=0.05
    )


RUN = np.arange(12 * 4 * 3, dtype=float).reshape(12, 4, 3) / 1e3
PULLS = np.ones((12, 3))


@pytest.mark.parametrize(
    ("arguments", "changed", "words"),
    [
        ([], {}, "BAG is a bag; allowed are bags with --markers /TOPIC, of markers in their order"),
        (
            ["--markers", "/nothing"],
            {},
            "/nothing is not there in BAG; allowed is a topic of sensor_msgs/msg/PointCloud2",
        ),
        (["--markers", "/tf"], {}, "/tf is tf2_msgs/msg/TFMessage in BAG; allowed is a topic of sensor_msgs/msg/Point"),
        (
            ["--markers", "/start", "--wrench", "/end"],
            {},
            "/end is geometry_msgs/msg/PoseArray in BAG; allowed is a topic",
        ),
        (
            ["--markers", "/start", "--frame", "map"],
            {},
            "BAG has no transform between 'world' of its messages and 'map'",
        ),
        (["--markers", "/start"], {}, "BAG has 12 frames of 2 markers; allowed are at least 10 of 4"),
        (
            COMMAND,
            {"/end": [array(START + k, "world", RUN[0][: 1 + k]) for k in range(2)]},
            "/end has messages of 1 to 2 markers in BAG; allowed are as many in each",
        ),
        (
            COMMAND,
            {"/end": [array(60 + k, "world", RUN[0][:2]) for k in range(2)]},
            "the topics in BAG have no time in common; allowed are stamps of one clock",
        ),
        (
            [*COMMAND, "--begin", "0.1"],
            {},
            "--begin is 0.1 and --end inf of BAG, which lasts 0.183 s; allowed are times with 10 frames between them",
        ),
        (
            ["--markers", "/far"],
            {"/far": [array(START + 1e6 * k, "world", RUN[0]) for k in range(2)]},
            "stamps in BAG are 1000000 s apart; allowed are at most 3600 s",
        ),
    ],
)
def test_what_cannot_be_is_said_in_one_sentence(tmp_path, monkeypatch, capsys, arguments, changed, words):
    bag = bag_of(tmp_path / "bag", RUN, PULLS, **changed)
    monkeypatch.setattr("sys.argv", ["fit_cable", str(bag), *arguments])
    assert fit_cable.main() == 2
    told = capsys.readouterr().err.replace(str(bag), "BAG")
    assert told.startswith(f"error: {words}") and told.count("\n") == 1, told


def test_topics_of_a_file_are_refused(tmp_path):
    with pytest.raises(ValueError, match="--markers and --wrench name topics, and .*a.csv is no bag"):
        Markers.read([tmp_path / "a.csv"], TOPICS)
