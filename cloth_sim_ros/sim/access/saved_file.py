# SPDX-License-Identifier: Apache-2.0
"""The file of a saved state: one .npz of plain arrays, with a header in JSON and no pickles.

The file is written beside its destination and then moved there, so a reader finds the whole old or new file. It
replaces only another saved state.
"""

from __future__ import annotations

import json
import os
import secrets
import stat
import zipfile
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from cloth_sim_ros.sim.input.regular_file import check_regular, open_regular

FORMAT = 22  # format number of files that this package writes and reads
ALLOWED = "allowed is a file that Simulation.save has written"
_KIND, _HEADER = "state of cloth_sim_ros", "header"
_MOST_HEADER = 64 << 20  # largest header [bytes]; 65,536 worlds with their scales need a tenth of it
_NPY_HEAD = 1 << 16  # largest header of an array [bytes]


def package_version() -> str:
    """The version of this package, "unknown" if it is not installed."""
    try:
        return metadata.version("cloth_sim_ros")
    except metadata.PackageNotFoundError:
        return "unknown"


def path_of(path: Any) -> Path:
    """Return `path` as a Path. Raises ValueError if it names no file."""
    try:
        return Path(path)
    except TypeError:
        raise ValueError(f"the path of a saved state is {path!r}; allowed is text or a pathlib.Path") from None


def reason(error: Exception) -> str:
    """Describe an error on one line of bounded length."""
    text = getattr(error, "strerror", None) or " ".join(str(error).split()) or type(error).__name__
    return text if len(text) <= 120 else text[:117] + "..."


def write_file(path: Path, header: dict[str, Any], arrays: dict[str, np.ndarray]) -> None:
    """Write arrays by name, and a JSON-serializable header.

    Raises ValueError if the file cannot be written, or if `path` holds anything but a saved state; nothing changes
    then. A replaced file keeps its mode.
    """
    header = {"kind": _KIND, "format": FORMAT, "package": package_version(), **header}
    try:
        text = np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)
        if len(text) > _MOST_HEADER:
            raise ValueError(f"they take {len(text) / 1e6:.0f} MB of at most {_MOST_HEADER / 1e6:.0f}")
    except (TypeError, ValueError, RecursionError) as error:
        raise ValueError(f"the notes for {path} cannot be kept: {error}; allowed is what JSON can hold") from None
    beside = path.parent / f"{path.name}.{secrets.token_hex(8)}.tmp"
    try:
        mode = _mode_of_ours(path)
        try:
            with open(beside, "xb") as file:
                if mode is not None:
                    os.fchmod(file.fileno(), mode)
                np.savez(file, **{_HEADER: text, **arrays})
                file.flush()
                os.fsync(file.fileno())
            os.replace(beside, path)
        finally:
            beside.unlink(missing_ok=True)
        _sync_folder(path.parent)
    except (OSError, ValueError) as error:
        raise ValueError(
            f"{path} cannot be written: {reason(error)}; allowed is a new file in a folder that takes it, or a saved "
            "state"
        ) from None


def _mode_of_ours(path: Path) -> int | None:
    """The permissions of the saved state at `path`; None if nothing is there.

    Raises OSError for anything else, which must not be replaced.
    """
    try:
        status = path.lstat()
    except FileNotFoundError:
        return None
    check_regular(status)
    with open_regular(path) as file:
        try:
            with zipfile.ZipFile(file) as box:
                is_ours = header_of(box) is not None
        except Exception:  # zipfile, NumPy and JSON raise whatever a foreign file leads them to
            is_ours = False
    if not is_ours:
        raise OSError("a file that is no saved state is there")
    return stat.S_IMODE(status.st_mode)


def _sync_folder(folder: Path) -> None:
    """Flush the folder to disk, so that the new name survives a loss of power, as the content does by fsync."""
    number = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)


class SavedFile:
    """A saved state for reading: first its `header`, then the arrays that the header asks for.

    Raises ValueError for a file that is missing, damaged, foreign or of another version.
    """

    def __init__(self, path: Path) -> None:
        self._path, self.header = path, {}
        try:
            self._file = open_regular(path)
        except (OSError, ValueError) as error:  # the latter for a name that no file can have
            raise ValueError(f"{path} cannot be read: {reason(error)}; {ALLOWED}") from None
        try:
            self._read_header()
        except ValueError:
            self._file.close()
            raise

    def __enter__(self) -> SavedFile:
        return self

    def __exit__(self, *_: Any) -> None:
        self._file.close()

    def _read_header(self) -> None:
        begins_well = self._file.read(2) == b"PK"
        try:
            self._box = zipfile.ZipFile(self._file)
            header = header_of(self._box)
            is_ours = header is not None and header["format"] == FORMAT
        except Exception as error:  # zipfile, NumPy and JSON raise whatever a damaged byte leads them to
            if begins_well:
                raise self._damaged(error) from None
            header = None
        if header is None:
            raise ValueError(f"{self._path} is no saved state of cloth_sim_ros; {ALLOWED}")
        if not is_ours:
            raise ValueError(
                f"{self._path} has format version {header['format']!r}, of package {header.get('package')}; "
                f"allowed is version {FORMAT}, as package {package_version()} writes it"
            )
        self.header = header

    def arrays(self, wanted: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Read all arrays by name; names, shapes and types must be those of `wanted`.

        Raises ValueError before reading a larger array, and if a number is not finite.
        """
        names = [name.removesuffix(".npy") for name in self._box.namelist()]
        if sorted(names) != sorted([_HEADER, *wanted]):
            raise self._unusable("its arrays are not those of its header")
        found = {}
        for name, like in wanted.items():
            try:
                found[name] = _read(self._box, name, like.nbytes)
            except Exception as error:
                raise self._damaged(error) from None
            if (found[name].shape, found[name].dtype) != (like.shape, like.dtype):
                raise self._unusable("its arrays are not those of its header")
            if not is_finite(found[name]):
                raise self._unusable(f"{name} has numbers that are not finite")
        return found

    def _damaged(self, error: Exception) -> ValueError:
        return ValueError(f"{self._path} is damaged or cut short: {reason(error)}; {ALLOWED}")

    def _unusable(self, why: str) -> ValueError:
        return ValueError(f"{self._path} cannot be used: {why}; {ALLOWED}")


def header_of(box: zipfile.ZipFile) -> dict[str, Any] | None:
    """The header, or None if the file is no saved state."""
    if f"{_HEADER}.npy" not in box.namelist():
        return None
    text = _read(box, _HEADER, _MOST_HEADER)
    if text.dtype != np.uint8:
        return None
    header = json.loads(text.tobytes())
    return header if isinstance(header, dict) and header.get("kind") == _KIND else None


def _read(box: zipfile.ZipFile, name: str, most: int) -> np.ndarray:
    """Read an array of at most `most` bytes; as `write_file` does not compress, it cannot grow while being read."""
    info = box.getinfo(f"{name}.npy")
    if info.compress_type != zipfile.ZIP_STORED or info.file_size > most + _NPY_HEAD:
        raise ValueError(f"{name} is compressed or too large")
    with box.open(info) as file:
        array = np.lib.format.read_array(file, allow_pickle=False)
        if file.read(1):  # reading to the end also compares the checksum
            raise ValueError(f"{name} is longer than it says")
    return array


def is_finite(array: np.ndarray) -> bool:
    """True if all floats of an array, also those in fields, are finite."""
    if array.dtype.names is not None:
        return all(is_finite(array[name]) for name in array.dtype.names)
    return array.dtype.kind != "f" or bool(np.isfinite(array).all())


def finite(array: np.ndarray) -> np.ndarray:
    """A copy with 0 in place of what is not finite: after a fault that stays in what is written before it is read."""
    array = array.copy()
    parts = [array[name] for name in array.dtype.names] if array.dtype.names is not None else [array]
    for part in parts:
        if not is_finite(part):
            part[~np.isfinite(part)] = 0.0
    return array
