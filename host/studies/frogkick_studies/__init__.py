"""Studies of the method, each a module with a ``run`` that returns a result with a figure (``frogkick
study``).

All functions raise InputError for what they are given and cannot use, ConvergenceError where the rods fail,
and ToolchainError where a compiler is missing; the text says what to do.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any


class Found(ABC):
    """The result of a study; if it has a figure, ``plot`` returns it.

    Attributes:
        passed: whether all requirements of the study are met.
    """

    @property
    def passed(self) -> bool:
        """Whether all requirements are met; true if there are none."""
        return True

    @abstractmethod
    def as_json(self) -> dict[str, Any]:
        """Return the keys of its command, without the figure."""

    def text(self, values: dict[str, Any]) -> str:
        """Return the result as text, from ``as_json``; "": these values, one a line."""
        del values
        return ""
