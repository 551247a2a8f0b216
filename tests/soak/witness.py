"""The C core in its life, and a witness beside it that hears every frame, sees every pin and counts.

At the end of each life the onlooker judges what was seen.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter, deque
from pathlib import Path
from typing import Any

import numpy as np
from cobs import cobs
from tests.core.onlooker import (
    ARM,
    DISARM,
    ENDED,
    FIX,
    HIGH,
    LOW,
    RESET,
    SEEN,
    STARTED,
    STATE,
    STOP,
    Limits,
    broken,
    judge,
)

from frogkick.link.frames import Frame, FrameCollector
from frogkick.link.layout import ANSWER_BIT, link_layout
from frogkick.pool.native_robot import PAGE_BYTES, CoreCall, NativeRobot

_AGAIN_FRAMES = 100  # a frame that comes twice comes within so many
_NAMES = {message.id: name for name, message in link_layout().messages.items()}
_HEARD = {"ARM": ARM, "DISARM": DISARM, "STOP": STOP, "START": STARTED}
_RECORDS = 18  # in a page of the store's journal


class SeenRobot(NativeRobot):
    """A ``NativeRobot`` that nobody sees but through here.

    Attributes:
        faults: what must not be, one line each.
        counts: of the onlooker, all lives together.
        total: frames heard good, bad and again, by name the good ones; table commands that were done.
        lives: starts so far.
        wraps: times that the robot's clock passed 2**32 us, and 2**32 ms.
        rows: things seen in one life that there is room for: memory that is there, and touched, from the
            beginning.
    """

    rows = 200_000

    def __init__(self, library: Path, limbs: int, limits: Limits) -> None:
        self.faults: list[str] = []
        self.counts: Counter[str] = Counter()
        self.total: Counter[str] = Counter()
        self.wraps: Counter[str] = Counter()
        self.lives = 1
        self._limits = limits
        self._rows = np.full(self.rows, 1, SEEN)
        self._many = 0
        self._latest_us = 0
        self._lows: list[tuple[int, int]] = []
        self._hears = FrameCollector()
        self._now: Counter[str] = Counter()  # of this life
        self._recent: deque[tuple[int, int]] = deque(maxlen=_AGAIN_FRAMES)
        self._reason = "POWER"
        self._last_us = 0
        super().__init__(library, limbs)

    def turn(self, now_us: int, frame: bytes) -> CoreCall:
        call = super().turn(now_us, frame)
        if now_us or frame:
            self._notice(now_us, call)
        return call

    def cut_power(self, off_s: float, idle_s: float = 0.0) -> None:
        self._lows = [(min(at_us, self._now_us), limb) for at_us, limb in self._lows]
        self._life_ends("POWER")
        super().cut_power(off_s, idle_s)
        self._last_us = round(idle_s * 1e6)

    def hang(self) -> None:
        self._life_ends("WATCHDOG")
        super().hang()

    def _life_ends(self, reason: str) -> None:
        self._see_lows(2**62)
        self._see(max(self._now_us, self._latest_us), RESET, 0)
        self.judge()
        self.lives += 1
        self._reason = reason
        self._last_us = 0
        self._now.clear()
        self._recent.clear()

    def judge(self) -> None:
        """Let the onlooker judge what was seen since it was asked last, which must be a whole life."""
        found = judge(self._limits, self._rows[: self._many])
        self.faults += [f"life {self.lives}: {what}, {count} times" for what, count in broken(found).items()]
        self.counts.update(found)
        self._many = 0

    def _see(self, time_us: int, kind: int, value: int) -> None:
        self._rows[self._many] = (time_us, kind, value)
        self._many += 1
        self._latest_us = time_us

    def _see_lows(self, until_us: int) -> None:
        while self._lows and self._lows[0][0] <= until_us:
            time_us, limb = self._lows.pop(0)
            self._see(time_us, LOW, limb)

    def _notice(self, clock_us: int, call: CoreCall) -> None:
        for name, wrap_us in (("us", 2**32), ("ms", 2**32 * 1000)):
            self.wraps[name] += clock_us // wrap_us > self._last_us // wrap_us
        self._last_us = clock_us
        zero_us = self._now_us - clock_us
        self._see_lows(self._now_us)
        again = self._hear(call.frame) if call.frame else False
        for frame in self._hears.feed(call.stream):
            self._listen(frame, zero_us, again)
        limb_mask, all_off, pulse_us, _ = call.outputs
        if all_off:
            self._lows = [(self._now_us, limb) for _, limb in self._lows]
            self._see_lows(self._now_us)
        if limb_mask:
            self._now["pulses"] += 1
            for limb in range(8):
                if limb_mask >> limb & 1:
                    self._see(self._now_us, HIGH, limb)
                    self._lows.append((self._now_us + pulse_us, limb))

    def _hear(self, encoded: bytes) -> bool:
        """Count a frame that reaches the core; whether it is one that has come before."""
        try:
            raw = cobs.decode(encoded)
        except cobs.DecodeError:
            raw = b""
        if len(raw) < 6 or struct.unpack("<I", raw[-4:])[0] != zlib.crc32(raw[:-4]) or raw[0] & ANSWER_BIT:
            self._now["bad"] += 1
            self.total["bad"] += 1
            return False
        mark = (raw[1], struct.unpack("<I", raw[-4:])[0])
        again = mark in self._recent
        self._recent.append(mark)
        name = _NAMES.get(raw[0], "?")
        self._now[name] += 1
        self.total[name] += 1
        self.total["again"] += again
        return again

    def _listen(self, frame: Frame, zero_us: int, again: bool) -> None:
        name, values = frame.name, frame.values
        status = int(values.get("status", 0))
        if frame.kind == "event":
            if name == "ENDED":
                self._see(self._now_us, ENDED, 0)
        elif name == "FIX" and status == 0:
            self._now["used"] += 1
            self._see(int(values["capture_us"]) + zero_us, FIX, 0)
        elif name in _HEARD and status == 0 and not again:
            self._see(self._now_us, _HEARD[name], 0)
        elif name == "STATUS":
            self._see(self._now_us, STATE, int(values["state"]))
            self._compare(values, zero_us)
        elif name.startswith("TABLE") and not again:
            self._note_table(frame)

    def _note_table(self, frame: Frame) -> None:
        name, values, total = frame.name, frame.values, self.total
        if name == "TABLE_STATUS":
            told = int(values["erases_1"]) + int(values["erases_2"])
            if told != total["begun"]:
                self.faults.append(f"{told} erases of slots are told, {total['begun']} updates were begun")
            if (
                not -(-total["written"] // _RECORDS)
                <= int(values["erases_journal"])
                <= 2 + (total["records"] // _RECORDS)
            ):
                self.faults.append(
                    f"{values['erases_journal']} erases of the journal told for {total['records']} records"
                )
        elif values["status"] == 0:
            is_page = name == "TABLE_CHUNK" and int(values["next_offset"]) % PAGE_BYTES == 0
            total["begun"] += name == "TABLE_BEGIN"
            total["committed"] += name == "TABLE_COMMIT"
            total["records"] += is_page or name != "TABLE_CHUNK"
            total["written"] += is_page or name in ("TABLE_BEGIN", "TABLE_COMMIT")

    def _compare(self, values: dict[str, Any], zero_us: int) -> None:
        """What the core counts against what the witness counted."""
        now, layout = self._now, link_layout()
        wanted = {
            "now_us": self._now_us - zero_us,
            "fixes_used": now["used"],
            "frames_bad": now["bad"],
            "pulses": now["pulses"],
            "answers_dropped": 0,
            "reset": layout.reset[self._reason],
            "fault": 0,
        }
        wrong = {name: (values[name], count) for name, count in wanted.items() if values[name] != count}
        fixes = int(values["fixes_used"]) + int(values["fixes_refused"])
        if fixes != now["FIX"]:
            wrong["fixes"] = (fixes, now["FIX"])
        if wrong:
            self.faults.append(f"STATUS tells other counts than were seen (told, seen): {wrong}")
