"""Hardware events in virtual time, counted in cycles of 64 MHz."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

CYCLES_PER_US: Final = 64
NEVER: Final = 2**62


class Scheduler:
    """One place for each source of events: a source has at most one event ahead of it.

    Events at the same cycle come in the order in which their sources were added: the same every time.
    """

    def __init__(self) -> None:
        """Start without sources."""
        self._at: list[int] = []
        self._callbacks: list[Callable[[], None]] = []
        self.next_cycle = NEVER

    def add(self, callback: Callable[[], None]) -> int:
        """Add a source; the callback runs at its event. Returns the source's number."""
        self._at.append(NEVER)
        self._callbacks.append(callback)
        return len(self._at) - 1

    def clear(self) -> None:
        """Forget all sources, as a reset does that places new ones."""
        self._at, self._callbacks, self.next_cycle = [], [], NEVER

    def at(self, source: int, cycle: int) -> None:
        """Set or move the source's next event; ``NEVER`` takes it back."""
        self._at[source] = cycle
        self.next_cycle = min(self._at)

    def take(self) -> Callable[[], None]:
        """Remove the earliest event and return its callback."""
        source = self._at.index(self.next_cycle)
        self.at(source, NEVER)
        return self._callbacks[source]
