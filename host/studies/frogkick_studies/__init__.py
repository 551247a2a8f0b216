"""Studies of the method, each a module with a ``run`` that returns a result with a figure (``frogkick
study``).

All functions raise an InputError for arguments that they cannot use, a ConvergenceError if the simulation of
the rods fails, and a ToolchainError if a compiler is missing. The text says what to do.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any


class StudyResult(ABC):
    """The result of a study; if it has a figure, ``plot`` returns it."""

    @property
    def passed(self) -> bool:
        """Whether all requirements of the study are met; true if it has none."""
        return True

    @abstractmethod
    def as_json(self) -> dict[str, Any]:
        """Return the keys of its command, without the figure."""

    def text(self, values: dict[str, Any]) -> str:
        """Return the result as text, from the values of ``as_json``; "" prints these values, one a line."""
        del values
        return ""
