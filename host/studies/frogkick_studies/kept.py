"""Results kept in a file from one start to the next; and what runs in the simulated pool gave."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from frogkick.core.files import write_text


@dataclass(frozen=True)
class Case:
    """One run: names of its world, path and planner, and the seed of the camera's noise."""

    world: str
    path: str
    planner: str
    seed: int


@dataclass(frozen=True)
class Outcome:
    """What a run gave; see ``frogkick.runs.record.Tracking``."""

    mean_distance_m: float
    progress_mps: float
    completed: bool
    ended: str
    decisions: int


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


class Kept:
    """Outcomes of runs in a file, each with the conditions it was made under.

    Attributes:
        outcomes: what the file holds of these conditions, by case.
    """

    def __init__(self, file: Path, stamp: str, conditions_of: Callable[[Case], str | None]) -> None:
        """Read what is there.

        Args:
            file: see ``Lines``.
            stamp: of all that every result depends on.
            conditions_of: hash of what else a case depends on; None where that is unknown here.
        """
        self.outcomes: dict[Case, Outcome] = {}
        self._conditions_of = conditions_of
        self._lines = Lines(file, {"stamp": stamp})
        for values in self._lines.values:
            case = Case(**values["case"])
            if conditions_of(case) == values["conditions_sha256"]:
                self.outcomes[case] = Outcome(**values["outcome"])

    def add(self, case: Case, outcome: Outcome) -> None:
        """Keep a result."""
        self.outcomes[case] = outcome
        self._lines.add(
            {
                "case": dataclasses.asdict(case),
                "conditions_sha256": self._conditions_of(case),
                "outcome": dataclasses.asdict(outcome),
            }
        )


def _read_line(line: str) -> dict[str, Any]:
    """A kept result; empty where a stop cut the line."""
    try:
        values = json.loads(line)
    except json.JSONDecodeError:
        return {}
    return values if isinstance(values, dict) else {}
