# SPDX-License-Identifier: Apache-2.0
"""Environment variables that a program sets before ROS and Warp are imported."""

from __future__ import annotations

import os
import stat
import tempfile
from pathlib import Path


def set_up() -> None:
    """Set the middleware up for large messages, and folders that can be written, unless the user has chosen them."""
    if "FASTDDS_BUILTIN_TRANSPORTS" not in os.environ:
        profile = Path(__file__).with_name("fastdds.xml")
        os.environ.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(profile))
    home = Path.home()
    for variable, usual in (
        ("XDG_CACHE_HOME", home / ".cache"),  # of kernels and signed distances
        ("ROS_LOG_DIR", Path(os.environ.get("ROS_HOME") or home / ".ros") / "log"),
    ):
        if variable not in os.environ and not _can_be_written(usual):
            os.environ[variable] = str(_own_folder() / variable.lower())


def _can_be_written(folder: Path) -> bool:
    """Return True if the folder can be written to, or can be made."""
    while not folder.exists():
        folder = folder.parent
    return os.access(folder, os.W_OK | os.X_OK)


def _own_folder() -> Path:
    """Return a folder for temporary files that later starts find again, as it has kernels.

    Nobody else may write there.
    """
    folder = Path(tempfile.gettempdir()) / f"cloth_sim_{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    about = folder.lstat()
    if stat.S_ISDIR(about.st_mode) and about.st_uid == os.getuid() and not about.st_mode & 0o022:
        return folder
    return Path(tempfile.mkdtemp(prefix="cloth_sim_"))
