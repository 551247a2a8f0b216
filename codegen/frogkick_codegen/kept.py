"""What a compiler made of the same files before, kept in the user's cache folder."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path

from frogkick.core.errors import InputError
from frogkick.core.files import cache_folder, write_bytes
from frogkick_codegen.toolchain import Compiler

KEPT_MAX = 64
"""Builds kept, some 350 KB each; the one that was not wanted for longest goes first."""

_DIGEST_BYTES = 32


def built_once(
    compiler: Compiler,
    flags: Sequence[str],
    places: Sequence[str | Path],
    files: Iterable[Path],
    output: Path,
) -> bytes:
    """Compile, or return what this compiler made of the same flags and files before.

    Several processes may do so at once: a whole file is renamed into place. One that was damaged since is
    not believed, and a folder that cannot be written to keeps nothing.

    Args:
        compiler: called as ``flags places -o output`` in the folder of ``output``.
        flags: those that name no place.
        places: sources, folders of headers and such; where they are must not change a byte of the output.
        files: all that is read there, in the same order each time.
        output: what is made, where it must be.

    Raises:
        ToolchainError: a refused source, or no cache folder.
    """
    digest = hashlib.sha256()
    for text in (compiler.name, compiler.version, *compiler.target_flags, *flags):
        digest.update(text.encode() + b"\0")
    for file in files:
        content = file.read_bytes()
        digest.update(file.name.encode() + b"\0" + len(content).to_bytes(8, "little") + content)
    kept = cache_folder("firmware") / digest.hexdigest()[:_DIGEST_BYTES]
    with suppress(OSError):
        stored = kept.read_bytes()
        if hashlib.sha256(stored[_DIGEST_BYTES:]).digest() == stored[:_DIGEST_BYTES]:
            os.utime(kept)
            return stored[_DIGEST_BYTES:]
    compiler.run([*flags, *places, "-o", output], folder=output.parent)
    made = output.read_bytes()
    with suppress(OSError, InputError):
        write_bytes(kept, hashlib.sha256(made).digest() + made)
        newest = sorted(kept.parent.iterdir(), key=lambda file: file.stat().st_mtime_ns, reverse=True)
        for file in newest[KEPT_MAX:]:
            file.unlink()
    return made
