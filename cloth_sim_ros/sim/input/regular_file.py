# SPDX-License-Identifier: Apache-2.0
"""Files are opened only where they are regular: a FIFO or a device may never end, and a device acts when opened."""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import BinaryIO

_OTHERS = {
    stat.S_IFBLK: "a device",
    stat.S_IFCHR: "a device",
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a FIFO",
    stat.S_IFLNK: "a symbolic link",
    stat.S_IFSOCK: "a socket",
}


def check_regular(status: os.stat_result) -> None:
    """Raise OSError, in words that follow "cannot be read: ", where `status` is not that of a regular file."""
    if not stat.S_ISREG(status.st_mode):
        raise OSError(f"{_OTHERS.get(stat.S_IFMT(status.st_mode), 'something else')} is there, and no regular file")


def open_regular(path: str | Path) -> BinaryIO:
    """A regular file opened to read its bytes; links are followed. Raises OSError, also where no regular file is."""
    return open(path, "rb", opener=_open_regular)


def _open_regular(path: str, flags: int) -> int:
    check_regular(os.stat(path))
    number = os.open(path, flags | os.O_NONBLOCK)  # it may be replaced by a FIFO meanwhile
    try:
        check_regular(os.fstat(number))
    except OSError:
        os.close(number)
        raise
    return number
