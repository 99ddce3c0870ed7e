# SPDX-License-Identifier: Apache-2.0
"""A save replaces saved states of its own and nothing else."""

import os
import socket

import numpy as np
import pytest

from cloth_sim_ros.sim import Rope, Scene, Simulation


@pytest.fixture(scope="module")
def sim():
    return Simulation(Scene({"rope": Rope(segments=4)}), device="cpu")


def refusal(sim, path):
    """The sentence with which a save to `path` is refused; nothing may be left beside it."""
    before = sorted(path.parent.iterdir())
    with pytest.raises(ValueError) as error:
        sim.save(path)
    sentence = str(error.value)
    assert sentence.startswith(f"{path} cannot be written: ") and "\n" not in sentence
    assert sentence.endswith("; allowed is a new file in a folder that takes it, or a saved state")
    assert sorted(path.parent.iterdir()) == before
    return sentence


def test_a_file_of_somebody_else_stays(sim, tmp_path):
    other = tmp_path / "other.npz"
    np.savez(other, positions=np.zeros(3))
    odd = tmp_path / "odd.npz"
    np.savez(odd, header=np.frombuffer(b'{"kind": "mine"}', np.uint8))
    (tmp_path / "thesis.odt").write_text("ten years of work")
    (tmp_path / "empty").touch()
    for file in list(tmp_path.iterdir()):
        before, status = file.read_bytes(), file.stat()
        assert "a file that is no saved state is there" in refusal(sim, file)
        assert file.read_bytes() == before and file.stat() == status


def test_what_is_no_regular_file_stays(sim, tmp_path):
    real, link, dangling = tmp_path / "real.npz", tmp_path / "link.npz", tmp_path / "dangling.npz"
    sim.save(real)
    before = real.read_bytes()
    link.symlink_to(real)
    dangling.symlink_to(tmp_path / "nothing.npz")
    for each in (link, dangling):
        assert "a symbolic link is there, and no regular file" in refusal(sim, each)
        assert each.is_symlink() and real.read_bytes() == before
    (tmp_path / "folder").mkdir()
    assert "a folder is there" in refusal(sim, tmp_path / "folder")
    os.mkfifo(tmp_path / "fifo")
    assert "a FIFO is there" in refusal(sim, tmp_path / "fifo") and (tmp_path / "fifo").is_fifo()
    with socket.socket(socket.AF_UNIX) as listens:
        listens.bind(str(tmp_path / "socket"))
        assert "a socket is there" in refusal(sim, tmp_path / "socket") and (tmp_path / "socket").is_socket()
    try:
        os.mknod(tmp_path / "device", 0o020666, os.makedev(1, 3))
    except PermissionError:
        return  # it takes root
    assert "a device is there" in refusal(sim, tmp_path / "device")
    assert (tmp_path / "device").is_char_device()


def test_a_saved_state_is_replaced_and_keeps_its_mode(sim, tmp_path):
    file = tmp_path / "state.npz"
    for mode in (0o600, 0o664, 0o400):
        sim.save(file)
        file.chmod(mode)
        before = file.read_bytes()
        sim.step()
        sim.save(file)
        assert file.read_bytes() != before and file.stat().st_mode & 0o7777 == mode


def test_no_folder_is_made(sim, tmp_path):
    with pytest.raises(ValueError, match="cannot be written: No such file or directory"):
        sim.save(tmp_path / "a/b.npz")
    assert not list(tmp_path.iterdir())
