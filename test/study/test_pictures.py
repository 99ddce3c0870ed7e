"""The pictures are drawn from what the product computes."""

import numpy as np
import pytest
from PIL import Image

from cloth_sim_ros.study.pictures import camera, command, curtain


def test_camera_sees_in_perspective():
    seen, distance = camera.Camera((0.0, -2.0, 0.0), (0.0, 0.0, 0.0)).see(np.array([[0.5, 0.0, 0.0], [0.5, 2.0, 1.0]]))
    assert distance == pytest.approx([2.0, 4.0])
    np.testing.assert_allclose(seen, [[0.25, 0.0], [0.125, 0.25]], atol=1e-12)


def test_curtain_is_pushed_by_the_ball_and_stays_out_of_it():
    cloths, balls, _ = curtain.shots(24, "cpu")
    assert len(cloths) == len(curtain.SHOTS)
    assert cloths[2][:, 1].max() > cloths[0][:, 1].max() + 0.3
    for points, centre in zip(cloths, balls, strict=True):
        assert np.linalg.norm(points - centre, axis=1).min() > curtain.RADIUS


def test_gathered_curtain_keeps_its_length():
    rest = np.stack([np.linspace(-0.95, 0.95, 500), np.zeros(500), np.zeros(500)], axis=1)
    length = np.linalg.norm(np.diff(curtain.gathered(rest), axis=0), axis=1).sum()
    assert length == pytest.approx(curtain.SIZE[0], rel=0.06)


def test_saved_picture_is_small_and_not_blank(tmp_path):
    path = command.save(curtain.draw("cpu", resolution=16), tmp_path / "curtain.png")
    assert path.stat().st_size < 200_000
    assert np.asarray(Image.open(path).convert("L")).std() > 10.0
