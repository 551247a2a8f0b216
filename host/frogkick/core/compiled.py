"""Compiled functions kept on disk, and when to drop them.

numba drops what it kept when the function's own file or closure changes, but not when a file that it calls
into does. So only outermost functions are kept, and each encloses a stamp of its package's text.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from importlib import resources
from typing import Any

BARE: dict[str, Any] = {"error_model": "numpy", "_nrt": False}
"""Options of numba's njit for a function that makes no arrays: references to those that it is handed are not
counted, each of which is an atomic operation, and code to compile. numba refuses one that makes an array."""

INNER: dict[str, Any] = {**BARE, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
"""Likewise, for one that compiled code alone calls: no way in from Python is compiled."""

ALLOCATING: dict[str, Any] = {**INNER, "_nrt": True}
"""As INNER, for a function that makes arrays."""


def kept(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """numba's njit for a function that is kept on disk: ``@kept(**BARE)``.

    What was kept names the types of its arguments by their modules. Where an earlier frogkick had these
    elsewhere, numba ends with an error instead of compiling anew; here it compiles.
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
    """Stands for the text of a package's Python files and another text: where one differs, another number."""
    digest = hashlib.sha256(also.encode())
    for file in sorted(resources.files(package).iterdir(), key=lambda f: f.name):
        if file.name.endswith(".py"):
            digest.update(file.read_bytes())
    return int.from_bytes(digest.digest()[:4], "little")
