"""Shared libraries of this project, which contain the declarations of their own C interface."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import cffi

from frogkick.core.errors import FrogkickError

_CARRIED = """
typedef struct { const char *text; uint32_t bytes; } fk_declared_t;
extern const fk_declared_t fk_declared[];
"""


@cache
def ffi_of(texts: tuple[str, ...]) -> cffi.FFI:
    """Return the cffi interface for declarations; the same texts give the same object."""
    ffi = cffi.FFI()
    ffi.cdef("\n".join(texts))
    return ffi


def load(library: Path) -> tuple[cffi.FFI, Any]:
    """Load a shared library that this project built: the interface of its declarations, and the library.

    OSError where it cannot be loaded, FrogkickError where it contains no declarations or a type has another
    size than its compiler reported.
    """
    first = cffi.FFI()
    first.cdef(_CARRIED)
    opened = first.dlopen(str(library))
    try:
        rows = opened.fk_declared
    except KeyError:
        raise FrogkickError(f"{library.name!r} contains no declarations: build it again") from None
    texts: dict[str, int] = {}
    while rows.text != first.NULL:
        texts[first.string(rows.text).decode()] = rows.bytes
        rows = rows + 1
    ffi = ffi_of(tuple(texts))
    for text, size in texts.items():
        if size and ffi.sizeof(_type_of(text)) != size:
            raise FrogkickError(
                f"{_type_of(text)} has {size} bytes in {library.name!r}, but not by its declaration: {text}"
            )
    return ffi, ffi.dlopen(str(library))


def _type_of(text: str) -> str:
    return text.rsplit("}", 1)[1].strip(" ;") or " ".join(text.split()[:2])
