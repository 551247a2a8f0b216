"""Questions about the method, answered with figures (``frogkick study``): each a module with a ``run``."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Found(ABC):
    """What a study found.

    Attributes:
        passed: all that was asked is so.
    """

    @property
    def passed(self) -> bool:
        """Whether all that was asked is so; true where nothing is asked."""
        return True

    def plot(self) -> Figure:
        """A matplotlib figure."""
        raise NotImplementedError(f"{type(self).__name__} has no picture")

    @abstractmethod
    def as_json(self) -> dict[str, Any]:
        """The keys of its command, without the picture."""

    def text(self, values: dict[str, Any]) -> str:
        """The same for people, from ``as_json``; "": these values, one a line."""
        del values
        return ""
