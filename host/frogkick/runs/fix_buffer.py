"""Poses from a thread that reads a tracker, handed out as position fixes in session time."""

from __future__ import annotations

import threading
from collections.abc import Callable

from frogkick.core.interrupts import Bell
from frogkick.core.poses import Fix

POLL_S = 0.002
KEEP_S = 2.0


class FixBuffer:
    """A ``FixSource`` without its reader: a subclass fills ``_poses`` and ``_error`` under ``_lock``."""

    def __init__(self, name: str, clock: Callable[[], float]) -> None:
        """Start empty. ``name`` is for people, ``clock`` in s."""
        self._name, self._clock = name, clock
        self._lock = threading.Lock()
        self._bell = Bell()
        self._poses: list[tuple[float, tuple[float, float, float]]] = []  # capture time and pose
        self._error: Exception | None = None
        self._sequence = 0
        self._polled_s = 0.0

    @property
    def next_event_s(self) -> float:
        """Time of the next poll: when the next pose arrives is not known."""
        return self._polled_s + POLL_S

    def advance(self, until_s: float) -> list[Fix]:
        """Return the fixes that arrived since the last call and are at most 2 s old.

        Raises:
            InputError: the reader failed.
        """
        self._polled_s = until_s
        with self._lock:
            if self._error is not None:
                raise self._error
            taken, self._poses = self._poses, []
        now_s = self._clock()
        fixes = []
        for captured_s, pose in taken:
            if now_s - captured_s <= KEEP_S:
                capture_s = until_s - (now_s - captured_s)
                fixes.append(Fix(capture_s, until_s - capture_s, *pose, sequence=self._sequence))
                self._sequence = (self._sequence + 1) & 0xFFFF
        return fixes

    def actuate(self, limb: int, start_s: float) -> None:
        """No effect: a real limb is seen by the tracker."""
