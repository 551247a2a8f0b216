"""The robot's own C core, built for this computer and lived through in simulated time."""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cffi

from frogkick.errors import FrogkickError
from frogkick.link.frames import Frame, FrameCollector
from frogkick.link.layout import link_layout
from frogkick.pool.port import BYTE_S, Edge

# FK_FRAME_ENCODED_MAX: head, CRC-32, COBS code byte and delimiter around the largest payload.
_ENCODED_MAX = link_layout().payload_bytes_max + 8
_DECLARATIONS = """
typedef struct { uint8_t bytes[%d]; uint32_t length; } fk_frame_collector_t;
uint32_t fk_frame_collect(fk_frame_collector_t *collector, uint8_t byte);
typedef struct { uint8_t limb_mask; uint8_t all_off; uint32_t pulse_us; uint64_t next_tick_us; } fk_outputs_t;
uint32_t fk_robot_bytes(void);
int32_t fk_robot_init(void *robot, const uint8_t *image, uint32_t image_bytes);
void fk_robot_on_frame(void *robot, const uint8_t *encoded, uint32_t length, uint64_t now_us);
void fk_robot_tick(void *robot, uint64_t now_us, fk_outputs_t *outputs);
uint32_t fk_robot_take_tx(void *robot, uint8_t *bytes, uint32_t capacity);
extern const uint8_t *fk_table_image;
extern uint32_t fk_table_image_bytes;
"""


@dataclass(frozen=True)
class CoreCall:
    """One turn of the core, and all that came of it: enough to let another build of it live through the same.

    Attributes:
        now_us: the robot's clock.
        frame: encoded frame that arrived, b"" without one; a tick follows.
        outputs: limb mask, all off, pulse us, next tick us.
        stream: bytes that the core then sent.
    """

    now_us: int
    frame: bytes
    outputs: tuple[int, int, int, int]
    stream: bytes


class NativeRobot:
    """A ``RobotPort`` over a shared library made by ``firmware build --target native``.

    Computing takes no simulated time here; the virtual chip is where it does.

    Attributes:
        calls: every turn of the core, where they are to be kept.
    """

    def __init__(self, library: Path, limbs: int, keep_calls: bool = False) -> None:
        """Load the library and start the core.

        Args:
            library: shared library with the core, the planner and a table.
            limbs: number of limbs of the robot.
            keep_calls: fill ``calls``.

        Raises:
            FrogkickError: the core refuses its own table.
        """
        self._ffi = cffi.FFI()
        self._ffi.cdef(_DECLARATIONS % _ENCODED_MAX)
        self._core: Any = self._ffi.dlopen(str(library))
        self._memory = self._ffi.new("uint64_t[]", (self._core.fk_robot_bytes() + 7) // 8)
        self._wire = self._ffi.new("fk_frame_collector_t *")
        self._outputs = self._ffi.new("fk_outputs_t *")
        self._buffer = self._ffi.new("uint8_t[]", 1024)
        error = self._core.fk_robot_init(
            self._memory, self._core.fk_table_image, self._core.fk_table_image_bytes
        )
        if error:
            raise FrogkickError(f"the core refuses its table (fk_error_t {error}): build it again")
        self._limbs = limbs
        self._now_us = 0
        self._next_tick_us = 0
        self._waiting: list[tuple[int, int, bytes]] = []
        self._sent = 0
        self._line_free_us = 0.0
        self._collector = FrameCollector()
        self._frames: list[tuple[float, Frame]] = []
        self._edges: list[Edge] = []
        self._keep_calls = keep_calls
        self.calls: list[CoreCall] = []

    def send(self, encoded: bytes, at_s: float) -> None:
        """Put bytes on the wire; the core's collector cuts them. A frame comes with its last byte."""
        begin_us = max(at_s * 1e6, self._line_free_us)
        for index, byte in enumerate(encoded):
            length = self._core.fk_frame_collect(self._wire, byte)
            if length:
                part = bytes(self._ffi.buffer(self._wire.bytes, length))
                self._sent += 1
                arrival_us = begin_us + (index + 1) * BYTE_S * 1e6
                heapq.heappush(self._waiting, (round(arrival_us), self._sent, part))
        self._line_free_us = begin_us + len(encoded) * BYTE_S * 1e6

    def advance(self, until_s: float) -> None:
        """Give the core its frames and ticks in order of time."""
        until_us = round(until_s * 1e6)
        while True:
            frame_us = self._waiting[0][0] if self._waiting else until_us + 1
            due_us = min(frame_us, max(self._next_tick_us, self._now_us))
            if due_us > until_us:
                break
            self._now_us = max(self._now_us, due_us)
            encoded = b""
            if frame_us <= due_us:
                encoded = heapq.heappop(self._waiting)[2]
            self._note(self.turn(self._now_us, encoded))
        self._now_us = max(self._now_us, until_us)

    def turn(self, now_us: int, frame: bytes) -> CoreCall:
        """Let the core take a frame (b"" for none), tick, and send what it has to."""
        if frame:
            self._core.fk_robot_on_frame(self._memory, frame, len(frame), now_us)
        outputs = self._outputs
        self._core.fk_robot_tick(self._memory, now_us, outputs)
        stream = b""
        while count := self._core.fk_robot_take_tx(self._memory, self._buffer, 1024):
            stream += bytes(self._ffi.buffer(self._buffer, count))
        told = (outputs.limb_mask, outputs.all_off, outputs.pulse_us, outputs.next_tick_us)
        return CoreCall(now_us, frame, told, stream)

    def _note(self, call: CoreCall) -> None:
        if self._keep_calls:
            self.calls.append(call)
        limb_mask, all_off, pulse_us, self._next_tick_us = call.outputs
        now_s = self._now_us * 1e-6
        if all_off:
            # A pulse that was on ends now; its planned end is taken back.
            still_on = {edge.limb for edge in self._edges if not edge.level and edge.time_s > now_s}
            self._edges = [edge for edge in self._edges if edge.level or edge.time_s <= now_s]
            self._edges += [Edge(now_s, limb, False) for limb in sorted(still_on)]
        for limb in range(self._limbs):
            if limb_mask >> limb & 1:
                self._edges.append(Edge(now_s, limb, True))
                self._edges.append(Edge(now_s + pulse_us * 1e-6, limb, False))
        self._frames += [(now_s, frame) for frame in self._collector.feed(call.stream)]

    def frames(self) -> list[tuple[float, Frame]]:
        """Frames from the core since the last call."""
        taken, self._frames = self._frames, []
        return taken

    def edges(self) -> list[Edge]:
        """Pin edges that have happened since the last call; the ends of pulses under way come later."""
        now_s = self._now_us * 1e-6
        taken = sorted((e for e in self._edges if e.time_s <= now_s), key=lambda edge: edge.time_s)
        self._edges = [edge for edge in self._edges if edge.time_s > now_s]
        return taken
