"""Results that are kept in a file, so that an interrupted study resumes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from frogkick.core.files import write_text


class Lines:
    """A file of JSON objects, one a line, below a head that identifies their conditions.

    Attributes:
        values: the objects that the file had under the same head, in order.
    """

    def __init__(self, file: Path, head: dict[str, str]) -> None:
        """Read the file, or begin it again if its head differs.

        Args:
            file: the file, which is made with its folder if it does not exist.
            head: all that every object depends on.
        """
        self._file = file
        first = json.dumps(head)
        lines = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
        kept = [line for line in lines[1:] if _read_line(line)] if lines[:1] == [first] else []
        if lines != [first, *kept]:  # of other code, or a stop cut a line, which the next would then follow
            file.parent.mkdir(parents=True, exist_ok=True)
            write_text(file, "".join(line + "\n" for line in (first, *kept)))
        self.values = [_read_line(line) for line in kept]

    def add(self, values: dict[str, Any]) -> None:
        """Append an object."""
        with self._file.open("a", encoding="utf-8") as file:
            file.write(json.dumps(values) + "\n")


def _read_line(line: str) -> dict[str, Any]:
    """Return an object; empty if an interruption cut its line."""
    try:
        values = json.loads(line)
    except json.JSONDecodeError:
        return {}
    return values if isinstance(values, dict) else {}
