# SPDX-License-Identifier: Apache-2.0
"""Integrity of a bag: a digest of its messages, and the repair of a file that a killed recorder has left."""

from __future__ import annotations

import hashlib
import shutil
import struct
from pathlib import Path

from cloth_sim_ros.sim.input.regular_file import open_regular

DIGEST = "cloth_sim_digest"  # under custom_data in metadata.yaml

_MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")  # head of an MCAP record: its kind and the number of bytes that follow
# Records that end a file which has no summary, https://mcap.dev/spec: DataEnd and Footer, both without checksums.
_END = _HEAD.pack(0x0F, 4) + bytes(4) + _HEAD.pack(0x02, 20) + bytes(20) + _MAGIC


class Digest:
    """A sum of hashes of messages, in any order."""

    def __init__(self) -> None:
        self._sum = 0

    def add(self, topic: str, stamp: int, data: bytes) -> None:
        """Add a message that came at `stamp` [ns]."""
        found = hashlib.blake2b(f"{topic}\0{stamp}\0".encode(), digest_size=8)
        found.update(data)
        self._sum = (self._sum + int.from_bytes(found.digest(), "little")) % (1 << 64)

    def __str__(self) -> str:
        return f"{self._sum:016x}"


def is_cut_short(path: Path) -> bool:
    """Return True if a folder is a bag in one MCAP file that its recorder did not finish."""
    return path.is_dir() and not (path / "metadata.yaml").exists() and len(list(path.glob("*.mcap"))) == 1


def mend(path: Path, folder: Path) -> Path:
    """Return a copy, in `folder`, of the file of a bag that is cut short.

    The copy ends properly after the last whole record. Raises ValueError if the file cannot be read.
    """
    (file,) = path.glob("*.mcap")
    copy = folder / file.name
    try:
        with open_regular(file) as source, open(copy, "wb") as target:
            shutil.copyfileobj(source, target)
        with open(copy, "r+b") as target:
            size, end = copy.stat().st_size, len(_MAGIC)
            while end + _HEAD.size <= size:
                target.seek(end)
                kind, length = _HEAD.unpack(target.read(_HEAD.size))
                if end + _HEAD.size + length > size or kind == 0x0F:
                    break
                end += _HEAD.size + length
            target.seek(end)
            target.truncate()
            target.write(_END)
    except OSError as error:
        raise ValueError(f"{path} cannot be read: {error.strerror or error}") from None
    return copy
