"""Whole files or none: write beside the target, flush to disk, rename."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from frogkick.errors import InputError


def existing_file(path: Path | str, what: str) -> Path:
    """Return the path if it names a readable, non-empty file.

    Args:
        path: the file.
        what: what it should be, for the error text ("table image").

    Raises:
        InputError: the file is missing, a directory, or empty.
    """
    file = Path(path)
    if not file.exists():
        raise InputError(f"{what} {str(path)!r} does not exist: check the path")
    if not file.is_file():
        raise InputError(f"{what} {str(path)!r} is not a file: name the file itself")
    if file.stat().st_size == 0:
        raise InputError(f"{what} {str(path)!r} is empty (0 bytes): make it again")
    return file


@contextmanager
def atomic_path(target: Path | str) -> Iterator[Path]:
    """Yield a temporary path beside ``target``; rename it there on success, remove it on any error.

    Raises:
        InputError: the folder of ``target`` cannot be made or written to.
    """
    final = Path(target)
    try:
        final.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{final.name}.", suffix=final.suffix, dir=final.parent)
    except OSError as error:
        raise InputError(f"cannot write {str(target)!r}: {error.strerror}; choose another --out") from error
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        with temporary.open("rb+") as file:
            os.fsync(file.fileno())
        os.chmod(temporary, 0o644)
        os.replace(temporary, final)
    finally:
        temporary.unlink(missing_ok=True)


def write_bytes(target: Path | str, content: bytes) -> None:
    """Write ``content`` to ``target``, wholly or not at all."""
    with atomic_path(target) as temporary:
        temporary.write_bytes(content)


def write_text(target: Path | str, content: str) -> None:
    """Write UTF-8 ``content`` to ``target``, wholly or not at all."""
    write_bytes(target, content.encode("utf-8"))
