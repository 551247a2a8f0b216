"""The robot's C core, built for this computer, in simulated time."""

from __future__ import annotations

import heapq
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from frogkick.core.errors import FrogkickError, InputError
from frogkick.core.shared_library import load
from frogkick.link.frames import Frame, FrameCollector
from frogkick.link.layout import link_layout
from frogkick.link.wire import BYTE_S, Edge, RobotPort

_COLD = bytes(4 * 8)  # FK_LIMBS_MAX
COLD_LIMBS = _COLD + struct.pack("<I", zlib.crc32(_COLD) ^ 0x6472_6147)
"""RAM that survives resets (``fk_guard_persistent_t``) of a robot that knows that its limbs are cold."""
WATCHDOG_S = 0.98
"""Time from the last feeding to the reset; firmware/bench/watchdog.c."""
JOURNAL_BYTES, PAGE_BYTES, SLOT_BYTES_MIN, SLOTS = 2 * 4096, 4096, 65536, 2
"""The flash for tables: two pages of journal, then slots of full pages; fk_store.h."""
_BOOT_S, _BOOT_S_PER_BYTE = 1e-3, 0.4e-6  # the second is for the check of the table
_BESIDE = 64  # guard bytes before and after the core's memory
_BESIDE_BYTE = 0xC5
_CLEARED = 2  # number of the core's structures that the start-up clears; the others are in .noinit


def kept_wear(table_crc: int, lost: Sequence[int]) -> bytes:
    """RAM that survives resets (``fk_wear_persistent_t``) of a robot that estimates the wear of its limbs.

    ``lost``: the share of each limb, 0 to 32767, as in ``Decision``.
    """
    content = struct.pack("<10I", link_layout().learn["ON"], table_crc, *lost, *[0] * (8 - len(lost)))
    return content + struct.pack("<I", zlib.crc32(content))


@dataclass(frozen=True)
class CoreCall:
    """A turn of the core with its results, which another build of the core can repeat."""

    now_us: int  # the robot's clock
    frame: bytes  # encoded frame that arrived, or b""; a tick follows
    outputs: tuple[int, int, int, int]  # limb mask, all off, pulse us, next tick us
    stream: bytes  # bytes that the core sent


class SimulatedPort(RobotPort, Protocol):
    """A robot in simulated time whose flash outlives it."""

    _collector: FrameCollector

    def received(self) -> list[tuple[float, bytes]]:
        """Bytes that came from the robot since the last call, with their times."""

    def flash_content(self) -> bytes:
        """The content that survives a loss of power."""

    def frames(self) -> list[tuple[float, Frame]]:
        """The frames of ``received``, with the arrival times of their last bytes."""
        return [(at_s, frame) for at_s, data in self.received() for frame in self._collector.feed(data)]


class NativeRobot(SimulatedPort):
    """A port over a shared library made by ``firmware build --target native``.

    Computing takes no simulated time, unlike on the virtual chip. The port's clock continues through resets;
    the robot's clock restarts with each. Flash survives all resets. Of the RAM, only the part that the
    start-up does not clear survives a reset by the watchdog.
    """

    def __init__(
        self,
        library: Path,
        limbs: int,
        keep_calls: bool = False,
        heat_known: bool = True,
        flash: bytes | None = None,
        learned: bytes = b"",
    ) -> None:
        """Load the library, with the core, the planner and a table, and start the core.

        Args:
            library: for a robot with as many ``limbs``.
            keep_calls: fill ``calls``.
            heat_known: the robot kept its RAM and knows that its limbs are cold; False: it lost its RAM, and
                lets them rest first.
            flash: ``flash_content()`` of such a robot; None: erased.
            learned: its persistent wear estimate (``kept_wear``); b"": none.

        Raises:
            InputError: ``flash`` is of another robot.
            FrogkickError: the library is not of this project, or its core refuses its table.
            OSError: the library cannot be loaded.
        """
        self._ffi, self._core = load(library)
        self._blocks: list[tuple[Any, int]] = []
        self._memory = self._ram("fk_robot_t")
        self._store = self._ram("fk_store_t")
        self._log = self._ram("fk_log_t")
        self._wire = self._ffi.new("fk_frame_collector_t *")
        self._outputs = self._ffi.new("fk_outputs_t *")
        self._buffer = self._ffi.new("uint8_t[]", 1024)
        self._kept = self._ram("fk_guard_persistent_t")
        self._learned = self._ram("fk_wear_persistent_t")
        self._built_in = (self._core.fk_table_image, int(self._core.fk_table_image_bytes))
        slot_bytes = max(SLOT_BYTES_MIN, -(-self._built_in[1] // PAGE_BYTES) * PAGE_BYTES)
        self._words = self._ffi.new("uint32_t[]", (JOURNAL_BYTES + SLOTS * slot_bytes) // 4)
        self.flash = self._ffi.buffer(self._words)  # for tables, writable
        if flash is not None and len(flash) != len(self.flash):
            raise InputError(
                f"this robot's flash has {len(self.flash)} bytes, not {len(flash)}: give its own content"
            )
        self.flash[:] = b"\xff" * len(self.flash) if flash is None else flash
        base = self._ffi.cast("uint8_t *", self._words)
        self._flash = self._ffi.new("fk_flash_t *", [base, slot_bytes, SLOTS, self._words])
        self._waiting: list[tuple[int, int, bytes]] = []
        self._now_us = 0
        self._next_tick_us = 0
        self._zero_us = 0  # port time at which the robot's clock was 0
        self._up_us = 0  # port time from which the firmware runs
        self._lose_ram()
        if heat_known:
            self._ffi.memmove(self._kept, COLD_LIMBS, len(COLD_LIMBS))
        self._ffi.memmove(self._learned, learned, len(learned))
        self._boot("POWER")
        self._limbs = limbs
        self._sent = 0
        self._line_free_us = 0.0
        self._collector = FrameCollector()
        self._sent_back: list[tuple[float, bytes]] = []
        self._edges: list[Edge] = []
        self._keep_calls = keep_calls
        self.calls: list[CoreCall] = []  # the turns of the core, if they are kept

    def send(self, encoded: bytes, at_s: float) -> None:
        """Put bytes on the wire; the core's collector splits them. A frame arrives with its last byte."""
        begin_us = max(at_s * 1e6, self._line_free_us)
        for index, byte in enumerate(encoded):
            length = self._core.fk_frame_collect(self._wire, byte)
            if length:
                part = bytes(self._ffi.buffer(self._wire.bytes, length))
                self._sent += 1
                arrival_us = begin_us + (index + 1) * BYTE_S * 1e6
                self._wait(round(arrival_us), self._sent, part)
        self._line_free_us = begin_us + len(encoded) * BYTE_S * 1e6

    def _wait(self, arrival_us: int, order: int, part: bytes) -> None:
        """Queue a frame without the bytes that arrive before the firmware runs; the rest is a bad frame."""
        count = (arrival_us - self._up_us) / (BYTE_S * 1e6)  # bytes, up to rounding to us
        heard = min(len(part), int(count + 0.05) - 1)  # without the delimiter
        if heard > 0:
            heapq.heappush(self._waiting, (arrival_us, order, part[len(part) - heard :]))

    def advance(self, until_s: float) -> None:
        """Give the core its frames and ticks in order of time."""
        until_us = round(until_s * 1e6)
        while True:
            frame_us = self._waiting[0][0] if self._waiting else until_us + 1
            due_us = min(frame_us, max(self._next_tick_us, self._now_us, self._up_us))
            if due_us > until_us:
                break
            self._now_us = max(self._now_us, due_us)
            encoded = heapq.heappop(self._waiting)[2] if frame_us <= due_us else b""
            self._note(self.turn(self._now_us - self._zero_us, encoded))
        self._now_us = max(self._now_us, until_us)

    def turn(self, now_us: int, frame: bytes) -> CoreCall:
        """Give the core a frame (b"": none) and a tick, and take what it sends."""
        if frame:
            self._core.fk_robot_on_frame(self._memory, frame, len(frame), now_us)
        outputs = self._outputs
        self._core.fk_robot_tick(self._memory, now_us, outputs)
        stream = b""
        while count := self._core.fk_robot_take_tx(self._memory, self._buffer, 1024):
            stream += bytes(self._ffi.buffer(self._buffer, count))
        values = (outputs.limb_mask, outputs.all_off, outputs.pulse_us, outputs.next_tick_us)
        return CoreCall(now_us, frame, values, stream)

    def _note(self, call: CoreCall) -> None:
        if self._keep_calls:
            self.calls.append(call)
        limb_mask, all_off, pulse_us, next_tick_us = call.outputs
        self._next_tick_us = next_tick_us + self._zero_us
        now_s = self._now_us * 1e-6
        if all_off:
            self._pins_low(now_s)
        for limb in range(self._limbs):
            if limb_mask >> limb & 1:
                self._edges.append(Edge(now_s, limb, True))
                self._edges.append(Edge(now_s + pulse_us * 1e-6, limb, False))
        if call.stream:
            self._sent_back.append((now_s, call.stream))

    def _pins_low(self, now_s: float) -> None:
        """End the current pulses now, instead of at their planned ends."""
        still_on = {edge.limb for edge in self._edges if not edge.level and edge.time_s > now_s}
        self._edges = [edge for edge in self._edges if edge.level or edge.time_s <= now_s]
        self._edges += [Edge(now_s, limb, False) for limb in sorted(still_on)]

    def received(self) -> list[tuple[float, bytes]]:
        taken, self._sent_back = self._sent_back, []
        return taken

    def flash_content(self) -> bytes:
        return bytes(self.flash)

    def edges(self) -> list[Edge]:
        """Past pin edges since the last call; the ends of current pulses come later."""
        now_s = self._now_us * 1e-6
        taken = sorted((e for e in self._edges if e.time_s <= now_s), key=lambda edge: edge.time_s)
        self._edges = [edge for edge in self._edges if edge.time_s > now_s]
        return taken

    @property
    def up_s(self) -> float:
        """Port time from which the firmware runs."""
        return self._up_us * 1e-6

    @property
    def time_s(self) -> float:
        """The port's time, which continues through resets."""
        return self._now_us * 1e-6

    def cut_power(self, off_s: float, idle_s: float = 0.0) -> None:
        """Switch the supply off now, and on again after ``off_s``.

        ``idle_s`` is the robot's clock afterwards, as if it had been idle so long, without the port's time.
        Its limbs count as cold then, so ``off_s`` must be longer than their duty's window. With 0 the robot
        lets them rest first.
        """
        self._pins_low(self._now_us * 1e-6)
        self._lose_ram()
        self._up_us = self._now_us + round((off_s + self._boot_s) * 1e6)
        self._boot("POWER", round(idle_s * 1e6))

    def hang(self) -> None:
        """Hang the firmware until its watchdog resets it. Pulses end by their timer."""
        self._up_us = self._now_us + round((WATCHDOG_S + self._boot_s) * 1e6)
        self._boot("WATCHDOG")

    @property
    def _boot_s(self) -> float:
        return _BOOT_S + _BOOT_S_PER_BYTE * self._built_in[1]

    def _ram(self, kind: str) -> Any:
        """Aligned memory for a structure of the core, with guard bytes on both sides."""
        size = self._ffi.sizeof(kind)
        words = self._ffi.new("uint64_t[]", (size + 7) // 8 + 2 * _BESIDE // 8)
        self._ffi.memmove(words, bytes([_BESIDE_BYTE]) * self._ffi.sizeof(words), self._ffi.sizeof(words))
        self._blocks.append((words, size))
        return self._ffi.cast(f"{kind} *", words + _BESIDE // 8)

    def ram_bytes(self) -> int:
        """RAM of the core's structures, bytes; FrogkickError: the core has written beside one."""
        for words, size in self._blocks:
            content = np.frombuffer(self._ffi.buffer(words), dtype=np.uint8)
            beside = np.concatenate([content[:_BESIDE], content[_BESIDE + size :]])
            if (beside != _BESIDE_BYTE).any():
                raise FrogkickError(
                    f"the core wrote outside of a structure of {size} bytes: a fault of the core, report it"
                )
        return sum(size for _, size in self._blocks)

    def _lose_ram(self) -> None:
        """Fill the RAM that no start-up clears, as a time without supply does."""
        for words, size in self._blocks[_CLEARED:]:
            self._ffi.memmove(words + _BESIDE // 8, b"\xa5" * size, size)

    def _boot(self, reset: str, idle_us: int = 0) -> None:
        """Start as firmware/bench/main.c does before its loop."""
        core, (image, image_bytes) = self._core, self._built_in
        for words, size in self._blocks[:_CLEARED]:
            self._ffi.memmove(words + _BESIDE // 8, bytes(size), size)
        self._wire.length = 0
        waiting, self._waiting = self._waiting, []
        for arrival_us, order, part in waiting:
            self._wait(arrival_us, order, part)
        core.fk_store_boot(self._store, self._flash, image, image_bytes)
        error = core.fk_robot_init(self._memory, self._store.image, self._store.image_bytes)
        core.fk_robot_use_store(self._memory, self._store)
        if error:
            raise FrogkickError(f"the core refuses its table (fk_error_t {error}): build it again")
        core.fk_robot_note_reset(self._memory, link_layout().reset[reset], self._kept)
        core.fk_robot_use_learned(self._memory, self._learned)
        core.fk_robot_use_log(self._memory, self._log)
        if idle_us:
            self.turn(0, b"")
        self._zero_us = self._up_us - idle_us
        self._next_tick_us = self._up_us
