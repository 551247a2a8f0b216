"""Compiled functions kept on disk, and when to drop them.

numba drops what it kept when the function's own file or closure changes, but not when a file that it calls
into does. So only outermost functions are kept, and each encloses a stamp of its package's text.
"""

from __future__ import annotations

import hashlib
from importlib import resources


def stamp_of(package: str) -> int:
    """Stands for the text of a package's Python files: other text, another number."""
    digest = hashlib.sha256()
    for file in sorted(resources.files(package).iterdir(), key=lambda f: f.name):
        if file.name.endswith(".py"):
            digest.update(file.read_bytes())
    return int.from_bytes(digest.digest()[:4], "little")
