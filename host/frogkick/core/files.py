"""Files that are written completely or not at all, input files that are checked, and the cache folder.

What cannot be read, written or made is an ``InputError``.
"""

from __future__ import annotations

import csv
import errno
import math
import os
import shutil
import stat
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from frogkick.core.errors import InputError

NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)
"""What a disk answers that has no locks, as some network disks."""


class UnwritableError(InputError):
    """A file cannot be written where it was asked for: no such folder, no permission, a full disk."""


def existing_file(path: Path | str, what: str) -> Path:
    """Return the path of a non-empty file; ``what`` it is, for the error text.

    Raises:
        InputError: there is no such file, or it is empty.
    """
    if not isinstance(path, str | os.PathLike):
        raise InputError(f"{what} is given as {type(path).__name__}: give a file's name")
    file = Path(path)
    try:
        there = file.exists()
    except OSError as error:
        raise InputError(f"{what} {str(path)!r} cannot be read: {error.strerror}; check the path") from None
    if not there:
        raise InputError(f"{what} {str(path)!r} does not exist: check the path")
    if not file.is_file():
        raise InputError(f"{what} {str(path)!r} is not a file: name the file itself")
    if file.stat().st_size == 0:
        raise InputError(f"{what} {str(path)!r} is empty (0 bytes): make it again")
    return file


def csv_numbers(
    path: Path | str, what: str, needed: Sequence[str], optional: Sequence[str] = ()
) -> list[list[float]]:
    """Return columns of a CSV file by the names in its first line, one list for each line below it.

    Args:
        needed: columns whose numbers must be finite.
        optional: further columns; NaN if the column or the cell is missing.

    Raises:
        InputError: the file lacks a needed column, or one of its numbers is missing or not finite.
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


def file_to_write(given: Path | str) -> Path:
    """Return the path of a file that will be written.

    Raises:
        InputError: its name ends in a slash, as only a folder's can; or it is none.
    """
    if not isinstance(given, str | os.PathLike):
        raise InputError(f"file to write is given as {type(given).__name__}: give its name")
    if str(given).endswith(("/", os.sep)):
        raise InputError(
            f"cannot write {str(given)!r}: a name that ends in a slash is a folder's; name a file in it"
        )
    return Path(given)


def require_writable(out: Path | str | None, folder: bool = False) -> None:
    """Check that --out can be written, before the work begins. Nothing is written.

    Raises:
        InputError: it cannot be written.
    """
    if out is None:
        return
    out = Path(out) if folder else file_to_write(out)
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


@contextmanager
def sole_writer(out: Path | None) -> Iterator[None]:
    """Lock a file to write as long as the context lives. On a disk without locks the last writer wins.

    Raises:
        InputError: another process holds the lock, or the file cannot be written.
    """
    try:
        import fcntl
    except ImportError:  # Windows
        yield
        return
    if out is None or not out.parent.is_dir():
        yield
        return
    if out.is_dir():
        raise InputError(f"cannot write {str(out)!r}: it is a folder; name a file in it")
    lock = out.with_name(f".{out.name}.lock")
    while True:
        try:
            file = lock.open("w")
        except OSError as error:
            raise InputError(f"cannot write {str(out)!r}: {error.strerror}; choose another --out") from None
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno in NO_LOCKS:
                break
            file.close()
            raise InputError(
                f"another process is about to write {str(out)!r}: wait for it, or give another --out"
            ) from None
        if lock.exists() and os.path.samestat(lock.stat(), os.fstat(file.fileno())):
            break
        file.close()  # the process before removed it meanwhile
    try:
        yield
    finally:
        with suppress(OSError):  # its folder is gone
            lock.unlink(missing_ok=True)
        file.close()


_FULL = (errno.ENOSPC, errno.EFBIG, getattr(errno, "EDQUOT", errno.ENOSPC))


@contextmanager
def atomic_path(target: Path | str) -> Iterator[Path]:
    """Yield a temporary path beside ``target``, which is renamed to it on success and removed on any error.

    Folders that were created for it are removed as well.

    Raises:
        UnwritableError: the file cannot be written, or the disk is full.
        InputError: its name is none, or a folder's.
    """
    final = file_to_write(target)
    made = [place for place in final.parents if not place.exists()]
    try:
        if final.is_dir():
            raise InputError(f"cannot write {str(target)!r}: it is a folder; name a file in it")
        final.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{final.name}.", suffix=final.suffix, dir=final.parent)
    except (FileExistsError, NotADirectoryError) as error:
        raise UnwritableError(
            f"cannot write {str(target)!r}: a folder in this path is a file; choose another --out"
        ) from error
    except OSError as error:
        raise UnwritableError(
            f"cannot write {str(target)!r}: {error.strerror}; choose another --out"
        ) from error
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
        raise UnwritableError(
            f"cannot write {str(target)!r}: {error.strerror}; make room or choose another --out"
        ) from error
    finally:
        temporary.unlink(missing_ok=True)
        for place in () if final.exists() else made:
            with suppress(OSError):  # something else is in it
                place.rmdir()


def write_bytes(target: Path | str, content: bytes) -> None:
    """Write ``content`` to ``target`` completely or not at all."""
    with atomic_path(target) as temporary:
        temporary.write_bytes(content)


def write_text(target: Path | str, content: str) -> None:
    """Write ``content`` as UTF-8 to ``target`` completely or not at all."""
    write_bytes(target, content.encode("utf-8"))


def save_result(write: Callable[[Path], object], target: Path | str) -> None:
    """Write a result that took long to compute; if its place cannot be written any more, write it elsewhere.

    Elsewhere is a new folder in the temporary folder, the working folder or the home folder.

    Args:
        write: writes the result to a file, completely or not at all.
        target: the file.

    Raises:
        UnwritableError: it is not at ``target``; the text says where it is instead.
    """
    final = Path(target)
    try:
        write(final)
        return
    except UnwritableError as error:
        failed = error
    except OSError as error:
        failed = UnwritableError(
            f"cannot write {str(target)!r}: {error.strerror or error}; choose another --out"
        )
    for find in (tempfile.gettempdir, Path.cwd, Path.home):
        try:
            folder = Path(tempfile.mkdtemp(prefix="frogkick-result-", dir=find()))
        except (OSError, RuntimeError):  # there is no such folder
            continue
        elsewhere = folder / final.name
        try:
            write(elsewhere)
        except (InputError, OSError):  # not there either
            shutil.rmtree(folder, ignore_errors=True)
            continue
        raise UnwritableError(f"{failed}; the result is in {str(elsewhere)!r}") from failed
    raise failed


def require_room(target: Path | str, size: int) -> None:
    """Check that the disk has room for a file of ``size`` bytes.

    Raises:
        UnwritableError: it has not.
    """
    free = shutil.disk_usage(next(place for place in Path(target).absolute().parents if place.exists())).free
    if free < size:
        raise UnwritableError(
            f"cannot write {str(target)!r}: it takes {size / 1e6:.1f} MB, and {free / 1e6:.1f} MB are "
            "free there; make room or choose another --out"
        )


@contextmanager
def one_at_a_time(folder: Path, name: str) -> Iterator[Path]:
    """Yield a working folder that one process uses at a time; others wait. The same name gives the same one.

    Raises:
        OSError: it cannot be made.
    """
    with ExitStack() as stack:
        work = folder / f".{name}"
        try:
            import fcntl

            work.mkdir(exist_ok=True)
            fcntl.flock(stack.enter_context((work / ".lock").open("w")), fcntl.LOCK_EX)
        except (ImportError, OSError) as error:  # Windows, or a disk without locks: a new folder each time
            if isinstance(error, OSError) and error.errno not in NO_LOCKS:
                raise
            temporary = tempfile.TemporaryDirectory(prefix=f".{name}-", dir=folder)
            work = Path(stack.enter_context(temporary))
        yield work


def cache_folder(name: str = "") -> Path:
    """Return the user's folder for compiled files and other results that can be made again, and make it.

    It is ``$FROGKICK_CACHE_DIR``, else ``$XDG_CACHE_HOME/frogkick``, else ``~/.cache/frogkick``. If the home
    folder cannot be written, it is a private folder in the temporary folder. ``name``: of a folder inside it.

    Raises:
        InputError: ``$FROGKICK_CACHE_DIR`` is set and cannot be written.
    """
    given = os.environ.get("FROGKICK_CACHE_DIR")
    if given:
        folder = Path(given) / name
        if problem := problem_with(folder):
            raise InputError(
                f"FROGKICK_CACHE_DIR is {given!r} ({problem}): set it to a folder that can be written"
            )
        return folder.resolve()
    try:
        base = os.environ.get("XDG_CACHE_HOME")
        folder = (Path(base) if base else Path.home() / ".cache") / "frogkick" / name
        if not problem_with(folder):
            return folder.resolve()
    except RuntimeError:  # the user has no home folder
        pass
    folder = _private_folder() / name
    folder.mkdir(exist_ok=True)
    return folder.resolve()


def problem_with(folder: Path) -> str:
    """Make a folder, and return why no files can be made in it, or ""."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        return error.strerror or str(error)
    return "" if os.access(folder, os.W_OK | os.X_OK) else "it cannot be written"


def _private_folder() -> Path:
    """Return a folder in the temporary folder that only this user can write: its files are loaded as code."""
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
