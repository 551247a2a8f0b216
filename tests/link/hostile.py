"""A device that answers as it likes, with right checksums: the robot in C, whose frames are changed."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Collection
from typing import Any

from tests.core.log_rig import Log
from tests.link.live_robot import LiveRobot

from frogkick.link.frames import Frame, FrameCollector, pack_frame, pack_raw, unpack_frame
from frogkick.link.layout import ANSWER_BIT, Field, Value, link_layout
from frogkick.link.wire import Edge, RobotPort

FLOATS = (math.nan, math.inf, -math.inf, 1e30, -1e30, 0.0)
TEXTS = ("", "frog2022", "\x1b[2J\x1b]0;x\x07", "\r\n\0\x7f", "x" * 16)
COMMANDS_MAX = 12_000


class EndlessError(BaseException):
    """The host still asks. It is no FrogkickError, and not to be caught."""


class Simulated:
    """The robot in C with a log and a store for tables, in simulated time."""

    def __init__(self, built_in: bytes | None = None) -> None:
        self._now_s = 0.0
        more: dict[str, Any] = {} if built_in is None else {"built_in": built_in}
        self.robot, log = LiveRobot(clock=lambda: self._now_s, **more), Log()
        self.robot.core._log = log  # lives as long
        self.robot.core.core.fk_robot_use_log(self.robot.core.memory, log.memory)
        self._stream = b""
        self._collector = FrameCollector()

    def send(self, encoded: bytes, at_s: float) -> None:
        self._now_s = max(self._now_s, at_s)
        self._stream += self.robot.feed(encoded)

    def advance(self, until_s: float) -> None:
        self._now_s = until_s
        self._stream += self.robot.tick()

    def frames(self) -> list[tuple[float, Frame]]:
        stream, self._stream = self._stream, b""
        return [(self._now_s, frame) for frame in self._collector.feed(stream)]

    def edges(self) -> list[Edge]:
        return []


class Hostile:
    """A port whose frames are changed, as bytes. EndlessError: the host sends too many commands."""

    def __init__(self, port: RobotPort, change: Callable[[Frame], bytes]) -> None:
        self.port, self.change = port, change
        self.commands = 0
        self._collector = FrameCollector()

    def send(self, encoded: bytes, at_s: float) -> None:
        self.commands += unpack_frame(encoded[:-1]).name != "FIX"
        if self.commands > COMMANDS_MAX:
            raise EndlessError
        self.port.send(encoded, at_s)

    def advance(self, until_s: float) -> None:
        self.port.advance(until_s)

    def frames(self) -> list[tuple[float, Frame]]:
        return [
            (time_s, made)
            for time_s, frame in self.port.frames()
            for made in self._collector.feed(self.change(frame))
        ]

    def edges(self) -> list[Edge]:
        return self.port.edges()


def packed(frame: Frame, **changes: Value) -> bytes:
    return pack_frame(frame.name, frame.kind, frame.sequence, {**frame.values, **changes})


def short(frame: Frame, status: int) -> bytes:
    """An answer that is its status alone."""
    number = link_layout().messages[frame.name].id | ANSWER_BIT
    return pack_raw(number, frame.sequence, status.to_bytes(1, "little", signed=True))


def liar(rng: random.Random, rate: float, names: Collection[str]) -> Callable[[Frame], bytes]:
    """Changes a share of the frames of some names."""

    def change(frame: Frame) -> bytes:
        honest = packed(frame)
        if frame.name not in names or rng.random() >= rate:
            return honest
        how = rng.randrange(8)
        if how == 0 and frame.kind == "answer":
            return short(frame, rng.choice([-128, -79, -78, -76, -66, -65, -64, -1, 0, 1, 127]))
        if how == 1:
            return honest + honest
        if how == 2:
            return rng.randbytes(rng.randrange(600)) + b"\0" + honest
        if how == 3:
            return b""
        if how == 4:
            raw = rng.randbytes(rng.randrange(231))
            number = link_layout().messages[frame.name].id | (ANSWER_BIT if frame.kind == "answer" else 0)
            return pack_raw(number, frame.sequence, raw)
        message = link_layout().messages[frame.name]
        payload = message.answer if frame.kind == "answer" else message.event
        assert payload is not None
        fields = rng.sample(payload.fields, min(len(payload.fields), rng.randint(1, 3)))
        changes = {field.name: _value(field, rng) for field in fields}
        if payload.repeat and frame.kind == "answer":
            changes[payload.repeat[0].name] = rng.randbytes(rng.randrange(209)).decode("latin-1")
        return packed(frame, **changes)

    return change


def _value(field: Field, rng: random.Random) -> Value:
    if field.type == "f32":
        return rng.choice(FLOATS)
    if field.type == "char16":
        return rng.choice(TEXTS)
    bits = 8 * field.bytes
    if field.type == "i8":
        return rng.choice([-128, -98, -75, -1, 0, 1, 127])
    return rng.choice([0, 1, 2, 2 ** (bits - 1) - 1, 2 ** (bits - 1), 2**bits - 1, rng.randrange(2**bits)])
