"""Compiled functions in numba's cache on disk, and when they are compiled again.

numba compiles again if a function's own file or closure changes, but not if a file that the function calls
into changes. So a cached function that calls functions of other files encloses a hash of its package's
source.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from importlib import resources
from typing import Any

BARE: dict[str, Any] = {"error_model": "numpy", "_nrt": False}
"""Options of numba's njit for a function that allocates no arrays.

References to its array arguments are not counted; each count is an atomic operation."""

INNER: dict[str, Any] = {**BARE, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
"""The same, for a function that only compiled code calls: it gets no Python wrapper."""

ALLOCATING: dict[str, Any] = {**INNER, "_nrt": True}
"""As INNER, for a function that allocates arrays."""


def cached_njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Return numba's njit for a function that is cached on disk: ``@cached_njit(**BARE)``.

    A cache of another version of frogkick may name types by modules that no longer exist. numba fails on such
    a cache; this decorator compiles again.
    """

    def keep(function: Callable[..., Any]) -> Any:
        from numba import njit

        dispatcher = njit(cache=True, **options)(function)
        file = getattr(dispatcher._cache, "_cache_file", None)
        if file is not None:  # with NUMBA_DISABLE_JIT there is none
            load = file._load_index

            def load_index() -> Any:
                try:
                    return load()
                except (ImportError, AttributeError):
                    return {}

            file._load_index = load_index
        return dispatcher

    return keep


def stamp_of(package: str, also: str = "") -> int:
    """Return a hash of the Python files of a package and of a further text."""
    digest = hashlib.sha256(also.encode())
    for file in sorted(resources.files(package).iterdir(), key=lambda f: f.name):
        if file.name.endswith(".py"):
            digest.update(file.read_bytes())
    return int.from_bytes(digest.digest()[:4], "little")
