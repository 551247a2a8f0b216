"""A log in C, a robot that keeps one, and what the suites of the log share."""

from __future__ import annotations

import random
from collections.abc import Sequence
from typing import Any

from tests.core.core import FFI, Robot, core

from frogkick.link.layout import link_layout
from frogkick.link.log import ChipLog, Record, Stretch, fetch_log, records_of

RING_BYTES = 24576
SNAPSHOT = link_layout().records["SNAPSHOT"].id


class Log:
    """A log in C, in RAM as found: random bytes."""

    def __init__(self, seed: int = 1) -> None:
        self.memory = FFI.new("fk_log_t *")
        self.words = FFI.cast("uint32_t *", self.memory)
        self.raw = FFI.buffer(self.memory)
        self.raw[:] = random.Random(seed).randbytes(len(self.raw))
        self.kept = core().fk_log_open(self.memory)

    def word(self, place: int) -> int:
        return int(self.words[place])

    def write(self, content: bytes, time_us: int = 0) -> int:
        return int(core().fk_log_write(self.memory, SNAPSHOT, time_us, content, len(content)))

    def read(self, offset: int = 0, capacity: int = 2**20) -> tuple[int, bytes]:
        buffer, at = FFI.new("uint8_t[]", max(1, min(capacity, RING_BYTES))), FFI.new("uint32_t *")
        count = core().fk_log_read(self.memory, offset, buffer, min(capacity, RING_BYTES), at)
        return int(at[0]), bytes(FFI.buffer(buffer, count))

    def records(self) -> list[Record]:
        offset, content = self.read()
        return records_of(Stretch(offset, content))


def content_of(number: int, length: int) -> bytes:
    """For a SNAPSHOT record, which takes any bytes behind its fields."""
    return number.to_bytes(7, "little") + random.Random(number).randbytes(length)


def robot_with_log(now_us: int = 1_000_000, made: Any = None, learned: Any = None) -> tuple[Robot, Log]:
    """learned: RAM that keeps what it learns of its limbs over a reset; None: it has none."""
    robot, log = Robot(now_us=now_us, made=made), Log()
    log.memory.magic = 0  # as found
    robot._log = log  # lives as long
    if learned is not None:
        robot.core.fk_robot_use_learned(robot.memory, learned)
    robot.core.fk_robot_use_log(robot.memory, log.memory)
    return robot, log


class Asking:
    """A robot as the log's fetcher asks it."""

    window = 1

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.asked = 0
        self.between = lambda: None

    def ask(self, name: str, values: object = None, rows: object = (), timeout_s: float = 1.0) -> dict:
        self.asked += 1
        answer = self.robot.ask(name, values)
        self.between()
        return answer

    def ask_all(self, name: str, many: Sequence[tuple[object, object]], timeout_s: float = 1.0) -> list[dict]:
        return [self.ask(name, values, rows, timeout_s) for values, rows in many]


def fetched(robot: Robot, known: ChipLog | None = None) -> ChipLog:
    return fetch_log(Asking(robot), known)


def names(log: ChipLog) -> list[str]:
    return [record.command or record.name for records in log.records() for record in records]
