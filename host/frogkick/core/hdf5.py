"""HDF5 files that are known to be whole before the HDF5 library reads them.

That library follows a file's addresses as they stand. A few damaged bytes can keep it in a loop that no
signal ends, or crash the process. A file of frogkick therefore begins with a block of 512 bytes that holds
the SHA-256 of all that follows. HDF5 calls it a user block, and every reader skips it. A file without it, as
of an older frogkick or of a run in progress, is first read by a process with a limit of time.
"""

from __future__ import annotations

import hashlib
import io
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import h5py

from frogkick.core.errors import InputError
from frogkick.core.files import atomic_path, write_bytes

BLOCK_BYTES = 512
MAGIC = b"\x89HDF\r\n\x1a\n"
"""How an HDF5 file without a user block begins."""
SEAL = b"frogkick sha256 "
PROBE_S = 60.0
"""Longest time in which a file without a checksum is read by the process that tries it out."""

_PROBE = """
import sys, h5py

def visit(name, node):
    for key in node.attrs:
        node.attrs[key]
    if isinstance(node, h5py.Dataset) and node.nbytes < 1 << 26:
        node[()]

how = {"libver": "latest", "swmr": True} if sys.argv[2:] else {}
with h5py.File(sys.argv[1], "r", locking=False, **how) as file:
    visit("/", file)
    file.visititems(visit)
"""


@contextmanager
def hdf5_to_write(target: Path | str, in_memory: bool = True) -> Iterator[h5py.File]:
    """Yield a new HDF5 file, and write it to ``target`` with its checksum, completely or not at all.

    Args:
        target: the file.
        in_memory: make it in memory, because the HDF5 library would end the process on a full disk; False for
            a large file, for which there is room on the disk.

    Raises:
        InputError: the folder cannot be written to, or the disk is full.
    """
    if in_memory:
        content = io.BytesIO()
        with h5py.File(content, "w", userblock_size=BLOCK_BYTES) as file:
            yield file
        _seal(content)
        write_bytes(target, content.getvalue())
        return
    with atomic_path(target) as temporary:
        with h5py.File(
            temporary, "w", libver=("v110", "v110"), userblock_size=BLOCK_BYTES, locking="best-effort"
        ) as file:
            yield file
        seal(temporary)


@contextmanager
def hdf5_to_read(path: Path) -> Iterator[h5py.File]:
    """Yield an HDF5 file, also one that a run is writing or that a killed run left.

    Raises:
        InputError: another program has it open to write.
        OSError: it is damaged, or no HDF5 file.
    """
    grows = False
    with path.open("rb") as stream:
        if _is_locked(stream):
            raise InputError(f"{str(path)!r} is open in another program, which may write it: close it there")
        block = stream.read(BLOCK_BYTES)
        if not block.startswith(SEAL):
            grows = _is_growing(path)
        elif block != _block(stream):
            raise OSError("its checksum does not match its content")
    how: dict[str, Any] = {"libver": "latest", "swmr": True} if grows else {}
    with h5py.File(path, "r", locking="best-effort", **how) as file:
        yield file


def is_hdf5(path: Path) -> bool:
    """Whether a file begins as an HDF5 file, with or without a checksum."""
    with path.open("rb") as stream:
        return stream.read(len(SEAL)).startswith((MAGIC, SEAL))


def seal(path: Path) -> None:
    """Write the checksum of a file with a user block, as of one that was changed on purpose."""
    with path.open("rb+") as file:
        _seal(file)


def _is_locked(stream: BinaryIO) -> bool:
    """Whether the HDF5 library of another program has a file open to write."""
    try:
        import fcntl

        fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except (ImportError, OSError) as error:  # Windows, or a disk without locks
        return isinstance(error, BlockingIOError)
    return False


def _block(stream: BinaryIO) -> bytes:
    """The user block for what follows in a stream."""
    digest = hashlib.sha256()
    while part := stream.read(1 << 20):
        digest.update(part)
    return (SEAL + digest.hexdigest().encode() + b"\n").ljust(BLOCK_BYTES, b"\0")


def _seal(stream: BinaryIO) -> None:
    stream.seek(BLOCK_BYTES)
    block = _block(stream)
    stream.seek(0)
    stream.write(block)


def _is_growing(path: Path) -> bool:
    """Try a file without a checksum in another process; return whether it reads only as one that grows."""
    for grows in (False, True):
        command = [sys.executable, "-P", "-c", _PROBE, str(path), *(["grows"] if grows else [])]
        try:
            done = subprocess.run(command, capture_output=True, timeout=PROBE_S, check=False)
        except subprocess.TimeoutExpired:
            raise OSError(f"it could not be read in {PROBE_S:.0f} s") from None
        if done.returncode == 0:
            return grows
    lines = done.stderr.decode("utf-8", "replace").strip().splitlines()
    raise OSError(lines[-1].partition(": ")[2] if lines else f"reading it ended with {done.returncode}")
