# SPDX-License-Identifier: Apache-2.0
"""The file of a saved state: one .npz of plain arrays, with a header in JSON. Nothing in it is a pickle.

It is written beside its place and then moved there, so that a reader finds the old file or the new one, whole.
"""

from __future__ import annotations

import json
import os
import secrets
import zipfile
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

FORMAT = 9  # of files that this package writes and reads
ALLOWED = "allowed is a file that Simulation.save has written"
_KIND, _HEADER = "state of cloth_sim_ros", "header"


def package_version() -> str:
    """The version of this package, "unknown" where it runs without being installed."""
    try:
        return metadata.version("cloth_sim_ros")
    except metadata.PackageNotFoundError:
        return "unknown"


def path_of(path: Any) -> Path:
    """`path` as a Path. Raises ValueError for what names no file."""
    try:
        return Path(path)
    except TypeError:
        raise ValueError(f"the path of a saved state is {path!r}; allowed is text or a pathlib.Path") from None


def reason(error: Exception) -> str:
    """Why something failed, on one line of bounded length."""
    text = getattr(error, "strerror", None) or " ".join(str(error).split()) or type(error).__name__
    return text if len(text) <= 120 else text[:117] + "..."


def write_file(path: Path, header: dict[str, Any], arrays: dict[str, np.ndarray]) -> None:
    """Write arrays by name, and a header of what JSON can hold.

    Raises ValueError where the file cannot be written; one that was there before is then untouched.
    """
    header = {"kind": _KIND, "format": FORMAT, "package": package_version(), **header}
    try:
        text = np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)
    except (TypeError, ValueError) as error:
        raise ValueError(f"the notes for {path} cannot be kept: {error}; allowed is what JSON can hold") from None
    beside = path.parent / f"{path.name}.{secrets.token_hex(8)}.tmp"
    try:
        try:
            with open(beside, "xb") as file:
                np.savez(file, **{_HEADER: text, **arrays})
                file.flush()
                os.fsync(file.fileno())
            os.replace(beside, path)
        finally:
            beside.unlink(missing_ok=True)
        _sync_folder(path.parent)
    except (OSError, ValueError) as error:
        raise ValueError(
            f"{path} cannot be written: {reason(error)}; allowed is a file in a folder that takes it"
        ) from None


def _sync_folder(folder: Path) -> None:
    """Have the new name in the folder outlive a loss of power, as fsync has the file's content."""
    number = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)


def read_file(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Header and arrays of a file. Raises ValueError for what is missing, damaged, foreign or of another version."""
    try:
        with open(path, "rb") as file:
            begins_well = file.read(2) == b"PK"
    except (OSError, ValueError) as error:  # the latter for a name that no file can have
        raise ValueError(f"{path} cannot be read: {reason(error)}; {ALLOWED}") from None
    header = None
    try:
        with zipfile.ZipFile(path) as box:
            names = [name.removesuffix(".npy") for name in box.namelist()]
            header = header_of(box) if _HEADER in names else None
            if header is not None and header["format"] == FORMAT:
                return header, {name: _read(box, name) for name in names if name != _HEADER}
    except Exception as error:  # zipfile and NumPy raise whatever a damaged byte leads them to
        if begins_well:
            raise ValueError(f"{path} is damaged or cut short: {reason(error)}; {ALLOWED}") from None
    if header is None:
        raise ValueError(f"{path} is no saved state of cloth_sim_ros; {ALLOWED}")
    raise ValueError(
        f"{path} has format version {header['format']!r}, of package {header.get('package')}; "
        f"allowed is version {FORMAT}, as package {package_version()} writes it"
    )


def header_of(box: zipfile.ZipFile) -> dict[str, Any] | None:
    """The header, or None where it is not one of ours."""
    text = _read(box, _HEADER)
    if text.dtype != np.uint8:
        return None
    header = json.loads(text.tobytes())
    return header if isinstance(header, dict) and header.get("kind") == _KIND else None


def _read(box: zipfile.ZipFile, name: str) -> np.ndarray:
    with box.open(f"{name}.npy") as file:
        array = np.lib.format.read_array(file, allow_pickle=False)
        if file.read(1):  # its end is also where the checksum is compared
            raise ValueError(f"{name} is longer than it says")
    return array
