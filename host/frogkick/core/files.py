"""Whole files or none: write beside the target, flush to disk, rename. Where compiled things are kept."""

from __future__ import annotations

import csv
import errno
import math
import os
import shutil
import stat
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from frogkick.core.errors import InputError


def existing_file(path: Path | str, what: str) -> Path:
    """Return the path if it names a readable, non-empty file.

    Args:
        path: the file.
        what: what it should be, for the error text ("table image").

    Raises:
        InputError: no path, or the file is missing, a directory, or empty.
    """
    if not isinstance(path, str | os.PathLike):
        raise InputError(f"{what} is given as {type(path).__name__}: give a file's name")
    file = Path(path)
    if not file.exists():
        raise InputError(f"{what} {str(path)!r} does not exist: check the path")
    if not file.is_file():
        raise InputError(f"{what} {str(path)!r} is not a file: name the file itself")
    if file.stat().st_size == 0:
        raise InputError(f"{what} {str(path)!r} is empty (0 bytes): make it again")
    return file


def csv_numbers(
    path: Path | str, what: str, needed: Sequence[str], optional: Sequence[str] = ()
) -> list[list[float]]:
    """Return columns of a CSV file by their names in its first line, a list for each line below it.

    Args:
        path: the file.
        what: what it should be, for the error text.
        needed: columns whose numbers are finite.
        optional: columns behind these; NaN where one is not there or a cell is empty.

    Raises:
        InputError: no such file, no text, a column or a number that is missing (its line is named), no lines.
    """
    file, name = existing_file(path, what), f"{what} {str(path)!r}"
    values = []
    try:
        with file.open(encoding="utf-8-sig", newline="") as handle:
            reader = csv.DictReader(handle)
            missing = [column for column in needed if column not in (reader.fieldnames or ())]
            if missing:
                raise InputError(f"{name} has no column {missing[0]!r}: needed are {', '.join(needed)}")
            for number, row in enumerate(reader, start=2):
                try:
                    known = [float(row[column]) for column in needed]
                    more = [float(row.get(column) or "nan") for column in optional]
                except (TypeError, ValueError) as error:
                    raise InputError(f"{name} line {number}: {error}") from error
                if not all(map(math.isfinite, known)):
                    raise InputError(f"{name} line {number} holds a value that is not finite")
                values.append(known + more)
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{name} is no CSV text: {error}") from error
    if not values:
        raise InputError(f"{name} has no rows below its header")
    return values


def require_writable(out: Path | None, folder: bool = False) -> None:
    """Refuse an --out that cannot be written, before the work and not after it. Writes nothing.

    Raises:
        InputError: a folder where a file is to be written (or the other way), or no place for it.
    """
    if out is None:
        return
    if folder and out.exists() and not out.is_dir():
        raise InputError(f"--out {str(out)!r} is a file: name a folder")
    if not folder and out.is_dir():
        raise InputError(f"--out {str(out)!r} is a folder: name a file in it")
    if not folder and out.exists() and not out.is_file():
        raise InputError(f"--out {str(out)!r} is a device or a pipe, and would be replaced: name a file")
    place = out if folder else out.parent
    while not place.exists() and place != place.parent:
        place = place.parent
    if not place.is_dir() or not os.access(place, os.W_OK | os.X_OK):
        raise InputError(f"cannot write {str(out)!r} in {str(place)!r}: choose another --out")


_FULL = (errno.ENOSPC, errno.EFBIG, getattr(errno, "EDQUOT", errno.ENOSPC))


@contextmanager
def atomic_path(target: Path | str) -> Iterator[Path]:
    """Yield a temporary path beside ``target``; rename it there on success, remove it on any error.

    Folders that are made for it go with it.

    Raises:
        InputError: no path, a folder, or one whose folder cannot be written to or whose disk is full.
    """
    if not isinstance(target, str | os.PathLike):
        raise InputError(f"file to write is given as {type(target).__name__}: give its name")
    final = Path(target)
    made = [place for place in final.parents if not place.exists()]
    try:
        if final.is_dir():
            raise InputError(f"cannot write {str(target)!r}: it is a folder; name a file in it")
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
    except OSError as error:
        if error.errno not in _FULL:
            raise
        raise InputError(
            f"cannot write {str(target)!r}: {error.strerror}; make room or choose another --out"
        ) from error
    finally:
        temporary.unlink(missing_ok=True)
        for place in () if final.exists() else made:
            with suppress(OSError):  # something else is in it
                place.rmdir()


def write_bytes(target: Path | str, content: bytes) -> None:
    """Write ``content`` to ``target``, wholly or not at all."""
    with atomic_path(target) as temporary:
        temporary.write_bytes(content)


def write_text(target: Path | str, content: str) -> None:
    """Write UTF-8 ``content`` to ``target``, wholly or not at all."""
    write_bytes(target, content.encode("utf-8"))


def require_room(target: Path | str, size: int) -> None:
    """Refuse to write where there is no room for it.

    Args:
        target: the file.
        size: of it, bytes.

    Raises:
        InputError: too little is free, or nothing can be written there.
    """
    with atomic_path(target) as temporary:
        free = shutil.disk_usage(temporary.parent).free
        if free < size:
            raise InputError(
                f"cannot write {str(target)!r}: it takes {size / 1e6:.1f} MB, and {free / 1e6:.1f} MB are "
                "free there; make room or choose another --out"
            )


@contextmanager
def one_at_a_time(folder: Path, name: str) -> Iterator[Path]:
    """A folder to work in, the same one each time, that one process has at a time; others wait for it.

    Args:
        folder: where it is made.
        name: of what is made there; another name is another folder.

    Raises:
        OSError: it cannot be made there.
    """
    try:
        import fcntl
    except ImportError:  # Windows: a new folder each time
        with tempfile.TemporaryDirectory(prefix=f".{name}-", dir=folder) as temporary:
            yield Path(temporary)
        return
    work = folder / f".{name}"
    work.mkdir(exist_ok=True)
    with (work / ".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield work


def cache_folder(name: str = "") -> Path:
    """Return (and make) the folder of this user for compiled and other things that can be made again.

    ``$FROGKICK_CACHE_DIR``, else ``$XDG_CACHE_HOME/frogkick``, else ``~/.cache/frogkick``; where the home
    folder cannot be written, a folder in the temporary folder that belongs to this user alone.

    Args:
        name: of a folder in it.

    Raises:
        InputError: it cannot be made.
    """
    given = os.environ.get("FROGKICK_CACHE_DIR")
    if given:
        folder = Path(given) / name
        problem = _problem_with(folder)
        if problem:
            raise InputError(
                f"FROGKICK_CACHE_DIR is {given!r} ({problem}): set it to a folder that can be written"
            )
        return folder.resolve()
    try:
        base = os.environ.get("XDG_CACHE_HOME")
        folder = (Path(base) if base else Path.home() / ".cache") / "frogkick" / name
        if not _problem_with(folder):
            return folder.resolve()
    except RuntimeError:  # nobody's home
        pass
    folder = _private_folder() / name
    folder.mkdir(exist_ok=True)
    return folder.resolve()


def writable_folder(folder: Path) -> bool:
    """Make a folder; whether files can be made in it."""
    return not _problem_with(folder)


def _problem_with(folder: Path) -> str:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        return error.strerror or str(error)
    return "" if os.access(folder, os.W_OK | os.X_OK) else "it cannot be written"


def _private_folder() -> Path:
    """A folder in the temporary folder, of this user alone: what lies there is loaded as code.

    Raises:
        InputError: there is one that others may write to.
    """
    user = os.getuid() if hasattr(os, "getuid") else 0
    folder = Path(tempfile.gettempdir()) / f"frogkick-{user}"
    with suppress(FileExistsError):
        folder.mkdir(mode=0o700)
    state = folder.lstat()
    shared = hasattr(os, "getuid") and (state.st_uid != user or state.st_mode & 0o22)
    if shared or not stat.S_ISDIR(state.st_mode):
        raise InputError(
            f"{str(folder)!r} is not a folder of this user alone: set FROGKICK_CACHE_DIR to one that is"
        )
    return folder
