"""Compiled functions in numba's cache on disk, and when they are compiled again.

numba compiles again if a function's own file or closure changes, but not if another file changes from which
it takes a function or a constant. So a cached function that calls functions of other files encloses a hash of
its package's source, and ``cached_njit`` watches the constants.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from importlib import resources
from typing import Any

import numpy as np

BARE: dict[str, Any] = {"error_model": "numpy", "_nrt": False}
"""Options of numba's njit for a function that allocates no arrays.

References to its array arguments are not counted; each count is an atomic operation."""

INNER: dict[str, Any] = {**BARE, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
"""The same, for a function that only compiled code calls: it gets no Python wrapper."""

ALLOCATING: dict[str, Any] = {**INNER, "_nrt": True}
"""As INNER, for a function that allocates arrays."""


_CONSTANTS = (int, float, str, tuple, np.generic)  # types of constants that compiled code contains


def cached_njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Return numba's njit for a function that is cached on disk: ``@cached_njit(**BARE)``.

    It compiles again if a number, a text or a tuple has changed that the function knows by a global name. A
    cache of another version of frogkick may name types by modules that no longer exist. numba fails on such a
    cache; this decorator compiles again.
    """

    def keep(function: Callable[..., Any]) -> Any:
        from numba import njit

        dispatcher = njit(cache=True, **options)(function)
        file = getattr(dispatcher._cache, "_cache_file", None)
        if file is not None:  # with NUMBA_DISABLE_JIT there is none
            known = {name: function.__globals__.get(name) for name in function.__code__.co_names}
            constants = {name: value for name, value in known.items() if isinstance(value, _CONSTANTS)}
            file._source_stamp = (file._source_stamp, repr(constants))
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
