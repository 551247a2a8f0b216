"""Runs in the simulated pool, what came of them, and a file that keeps it from one start to the next."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from frogkick.files import write_text


@dataclass(frozen=True)
class Case:
    """One run: names of its world, path and planner, and the seed of the camera's noise."""

    world: str
    path: str
    planner: str
    seed: int


@dataclass(frozen=True)
class Outcome:
    """What a run gave; see ``frogkick.loop.record.Tracking``."""

    mean_distance_m: float
    progress_mps: float
    completed: bool
    ended: str
    decisions: int


class Kept:
    """Results in a file, a line each; the first line says what they are of, each line of which conditions.

    Attributes:
        outcomes: what the file holds of these conditions, by case.
    """

    def __init__(self, file: Path, stamp: str, conditions_of: Callable[[Case], str | None]) -> None:
        """Read what is there; a file of another stamp is begun anew.

        Args:
            file: one JSON object a line.
            stamp: of all that every result depends on.
            conditions_of: hash of what else a case depends on; None where that is unknown here.
        """
        self.outcomes: dict[Case, Outcome] = {}
        self._file = file
        self._conditions_of = conditions_of
        head = json.dumps({"stamp": stamp})
        lines = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
        kept = [line for line in lines[1:] if _read_line(line)] if lines[:1] == [head] else []
        if lines != [head, *kept]:  # of other code, or a stop cut a line, which the next would then follow
            file.parent.mkdir(parents=True, exist_ok=True)
            write_text(file, "".join(line + "\n" for line in (head, *kept)))
        for line in kept:
            values = _read_line(line)
            case = Case(**values["case"])
            if conditions_of(case) == values["conditions_sha256"]:
                self.outcomes[case] = Outcome(**values["outcome"])

    def add(self, case: Case, outcome: Outcome) -> None:
        """Keep a result."""
        self.outcomes[case] = outcome
        values = {
            "case": dataclasses.asdict(case),
            "conditions_sha256": self._conditions_of(case),
            "outcome": dataclasses.asdict(outcome),
        }
        with self._file.open("a", encoding="utf-8") as file:
            file.write(json.dumps(values) + "\n")


def _read_line(line: str) -> dict[str, Any]:
    """A kept result; empty where a stop cut the line."""
    try:
        values = json.loads(line)
    except json.JSONDecodeError:
        return {}
    return values if isinstance(values, dict) else {}
