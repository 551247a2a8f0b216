"""Position fixes as lines of text, from any tracker."""

from __future__ import annotations

import math
import os
import threading
import time
from collections.abc import Callable

from frogkick.core.errors import InputError
from frogkick.core.progress import tell_line
from frogkick.runs.fix_buffer import FixBuffer

AGE_MAX_S = 10.0
FIELD_M = 1000.0
_LINE_MAX = 200


class LineFixes(FixBuffer):
    """A ``FixSource`` that reads lines ``x_m y_m heading_rad [age_s]`` in a thread.

    Poses are in the world frame; the age is from the picture to the line's arrival, 0 by default. Empty lines
    and lines that begin with # are skipped. After the end of the file no more fixes arrive.
    """

    def __init__(
        self,
        file: int,
        name: str,
        clock: Callable[[], float] = time.monotonic,
        tell: Callable[[str], None] = tell_line,
    ) -> None:
        """Start to read.

        Args:
            file: descriptor to read from.
            name: of the file, for people.
            clock: in s.
            tell: gets a line at the end of the file, in the reading thread.
        """
        super().__init__(name, clock)
        self._file, self._tell = file, tell
        self._seen = 0
        self._ended = False
        threading.Thread(target=self._read, name=name, daemon=True).start()

    def wait_first(self, timeout_s: float) -> None:
        """Wait for the first fix.

        Raises:
            InputError: none came in time, or a line is not a fix.
        """
        self._bell.wait_for(lambda: self._seen > 0 or self._error is not None or self._ended, timeout_s)
        with self._lock:
            if self._error is not None:
                raise self._error
            if not self._seen:
                how = "and it has ended" if self._ended else f"within {timeout_s:g} s"
                raise InputError(
                    f"no position fix came from {self._name} {how}: start the tracker, "
                    "whose lines are 'x_m y_m heading_rad [age_s]'"
                )

    def _read(self) -> None:
        rest, number = b"", 0
        while data := self._more():
            now_s = self._clock()
            *lines, rest = (rest + data).split(b"\n")
            for line in [*lines, *([rest] if len(rest) > _LINE_MAX else [])]:
                number += 1
                text = line.decode("utf-8", "replace").strip()
                if not text or text.startswith("#"):
                    continue
                with self._lock:
                    try:
                        age_s, pose = parse_line(text)
                    except InputError as error:
                        self._error = InputError(f"{self._name} line {number}: {error}")
                    else:
                        self._poses.append((now_s - age_s, pose))
                        self._seen += 1
                    self._bell.ring()
                    if self._error is not None:
                        return
        with self._lock:
            self._ended = True
            self._bell.ring()
        if self._seen:
            self._tell(f"{self._name} has ended after {self._seen} position fixes: no more will come from it")

    def _more(self) -> bytes:
        # Unbuffered: a waiting thread would hold a buffered stream's lock, and the program could not end.
        try:
            return os.read(self._file, 4096)
        except OSError:
            return b""


def parse_line(text: str) -> tuple[float, tuple[float, float, float]]:
    """Age in s and pose (x_m, y_m, heading_rad) of a line.

    Raises:
        InputError: the line is not three or four numbers, or one is outside its limits.
    """
    words = text.replace(",", " ").split()
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        numbers = []
    if len(numbers) not in (3, 4):
        raise InputError(f"{text[:60]!r} is not a position fix: give 'x_m y_m heading_rad [age_s]'")
    x_m, y_m, heading_rad = numbers[:3]
    age_s = numbers[3] if len(numbers) == 4 else 0.0
    limits = {"x_m": FIELD_M, "y_m": FIELD_M, "heading_rad": 1000.0}
    for (name, limit), value in zip(limits.items(), numbers[:3], strict=True):
        if not abs(value) <= limit:  # a NaN as well
            raise InputError(
                f"{name} is {value}, allowed is -{limit:g} to {limit:g}: check the tracker's units"
            )
    if not 0.0 <= age_s <= AGE_MAX_S:
        raise InputError(f"age is {age_s} s, allowed is 0 to {AGE_MAX_S:g}: give it in seconds")
    return age_s, (x_m, y_m, math.remainder(heading_rad, math.tau))
