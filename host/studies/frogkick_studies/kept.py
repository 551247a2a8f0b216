"""Results kept in a file from one start to the next."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from frogkick.core.files import write_text


class Lines:
    """A file of JSON objects, a line each, under a first line that says what all of them are of.

    Attributes:
        values: what the file held of the same head, in its order.
    """

    def __init__(self, file: Path, head: dict[str, str]) -> None:
        """Read what is there; a file of another head is begun anew.

        Args:
            file: is made, with its folder, where there is none.
            head: of all that every line depends on.
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
        """Write a line."""
        with self._file.open("a", encoding="utf-8") as file:
            file.write(json.dumps(values) + "\n")


def _read_line(line: str) -> dict[str, Any]:
    """A kept result; empty where a stop cut the line."""
    try:
        values = json.loads(line)
    except json.JSONDecodeError:
        return {}
    return values if isinstance(values, dict) else {}
