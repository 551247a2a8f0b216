"""The C core that ships, as a library that pytest drives; and a robot to talk to, tick by tick."""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from tests.conftest import REPOSITORY, count
from tests.planner import synthetic

from frogkick.core.shared_library import ffi_of, load
from frogkick.link.auth import CommandCodes
from frogkick.link.frames import Frame, FrameCollector, hello, pack_frame
from frogkick.link.layout import Value, link_layout
from frogkick.robot import load_robot
from frogkick_codegen import declared
from frogkick_codegen.firmware import robot_config
from frogkick_codegen.native import build_shared, planner_files
from frogkick_codegen.toolchain import FLAGS, Compiler, other

COVERAGE_DIR = os.environ.get("FK_CORE_COVERAGE_DIR")
"""Set by test_core_coverage for its own run of this folder: build with gcov's counters, into that folder."""

CORE = REPOSITORY / "firmware" / "core"
STATUS = link_layout().status
STATE = link_layout().state
NEVER_US = 2**64 - 1
Picked = TypeVar("Picked")


def cases(normal: int, full: int, quick: int | None = None) -> int:
    """``count``, a fifth in make test; a hundredth where gcov counts: there every line once is enough."""
    if quick is None:
        quick = normal // 5 if normal >= 1000 else normal
    return max(1, normal // 100) if COVERAGE_DIR else count(normal, full, quick)


def pick(rng: np.random.Generator, values: Sequence[Picked]) -> Picked:
    """The very one that ``rng.choice`` takes, several times sooner: that makes an array of them first."""
    return values[int(rng.integers(len(values)))]


def source_files() -> dict[str, bytes]:
    """Every file of the core's library by name: planner, core, limits, the shim, what plays and fuzzes."""
    files = planner_files() | {path.name: path.read_bytes() for path in sorted(CORE.glob("*.[ch]"))}
    files["fk_robot_config.h"] = robot_config(load_robot("frog2022")).encode()
    for name in ("shim.c", "play.c", "play.h", "flash_sim.c", "fuzz.c"):
        files[name] = (Path(__file__).parent / name).read_bytes()
    return files


FFI = ffi_of(tuple(declared.declarations(source_files())))


def library(files: Mapping[str, bytes] | None = None) -> Any:
    """Build and load the core; ``files`` where a test changed some of them."""
    if COVERAGE_DIR and files is None:
        return FFI.dlopen(str(_coverage_library(Path(COVERAGE_DIR), other("gcc"))))
    built = build_shared("fk_core", source_files() if files is None else files)
    own, made = load(built)
    if own is FFI:
        return made
    # A limit in a header was changed, and a type with it. Memory is made by FFI, so it must be enough.
    for name in own.list_types()[0]:
        try:
            assert own.sizeof(name) <= FFI.sizeof(name), f"{name} is larger: change it to something less"
        except FFI.error:  # opaque
            continue
    return FFI.dlopen(str(built))


def _coverage_library(folder: Path, gcc: Compiler | None) -> Path:
    assert gcc is not None, "test_core_coverage looks for gcc before it sets FK_CORE_COVERAGE_DIR"
    files = source_files()
    files[declared.SOURCE] = declared.source(files)
    for name, content in files.items():
        (folder / name).write_bytes(content)
    flags = [flag for flag in FLAGS if flag != "-O2"] + ["-O0", "--coverage", "-fPIC", "-shared"]
    sources = sorted(name for name in files if name.endswith(".c"))
    gcc.run([*flags, "-o", "core.so", *sources], folder=folder)
    return folder / "core.so"


@cache
def core() -> Any:
    """The library of the sources as they are."""
    return library()


def mutated(name: str, old: str, new: str) -> dict[str, bytes]:
    """The sources with one text replaced, which must stand there exactly once."""
    files = source_files()
    text = files[name].decode()
    assert text.count(old) == 1, f"{name} holds {old!r} {text.count(old)} times: correct the mutation"
    files[name] = text.replace(old, new).encode()
    return files


def strings(parts: Sequence[bytes]) -> tuple[bytes, Any]:
    """Byte strings as the shim takes many: joined, and their lengths."""
    return b"".join(parts), FFI.new("uint32_t[]", [len(part) for part in parts])


def encode(kind: int, sequence: int, payload: bytes, capacity: int = 256) -> bytes:
    """``fk_frame_encode``, delimiter included; empty where it does not fit."""
    to = FFI.new("uint8_t[]", 512)
    size = core().fk_frame_encode(kind, sequence, payload, len(payload), to, capacity)
    return bytes(FFI.buffer(to, size))


def decode(encoded: bytes) -> tuple[int, int, bytes] | None:
    """``fk_frame_decode``: type, sequence, payload; None where it refuses."""
    head, payload, length = FFI.new("uint8_t[2]"), FFI.new("uint8_t[256]"), FFI.new("uint32_t *")
    # Exactly as many bytes as the frame has: what reads beyond them reads somebody else's.
    if core().fk_test_decode(FFI.from_buffer(encoded), len(encoded), head, payload, length) != 0:
        return None
    return head[0], head[1], bytes(FFI.buffer(payload, length[0]))


def collect(stream: bytes) -> list[bytes]:
    """What ``fk_frame_collect`` cuts from a stream."""
    frames, lengths = FFI.new("uint8_t[]", len(stream) + 1), FFI.new("uint32_t[]", len(stream) + 1)
    many = core().fk_test_collect(stream, len(stream), frames, lengths)
    found, at = [], 0
    for index in range(many):
        found.append(bytes(FFI.buffer(frames + at, lengths[index])))
        at += lengths[index]
    return found


ACTION_ROWS = [
    ("A", 0b0011, 0),
    ("B", 0b0011, 0b1100),
    ("C", 0b0010, 0b1100),
    ("D", 0b0001, 0b0100),
    ("R", 0b1100, 0),
    ("S", 0, 0b0001),
    ("I", 0, 0),
]
ACTION = {name: index for index, (name, _, _) in enumerate(ACTION_ROWS)}
RESTING = ACTION["I"]
PULSE_US = 80_000
DELAY_US = 80_000
PERIOD_US = 1_425_000
GAP_US = 1_000  # FK_STROKE_GAP_US
SILENT_US = 5_000_000  # FK_LINK_SILENT_US
LATE_US = 200  # FK_PORT_LATE_US: what a port may take from the time it tells to the pins


def kept_of(on_us: Sequence[int] = ()) -> Any:
    """RAM that outlived a reset: these times, with the CRC that says that they are whole."""
    kept = FFI.new("fk_guard_persistent_t *")
    kept.on_us = [*on_us, *[0] * (8 - len(on_us))]
    kept.crc = zlib.crc32(bytes(FFI.buffer(kept))[:32]) ^ 0x64726147
    return kept


def image(**changes: object) -> bytes:
    """A made-up table with these actions and wear curves; ``changes`` replace arguments of pack_nearest."""
    return _packed(changes) if changes else _plain_image()


@cache
def _plain_image() -> bytes:
    """Made once: each robot of these tests carries it."""
    return _packed({})


def _packed(changes: Mapping[str, object]) -> bytes:
    rows = changes.get("action_rows", ACTION_ROWS)
    assert isinstance(rows, list)
    given = {"action_rows": rows, "limb_wear": synthetic.bent_curves()}
    return synthetic.pack(*synthetic.transitions(60, len(rows), 5), **(given | dict(changes)))


@dataclass(frozen=True)
class Outputs:
    """What one tick asked for."""

    limb_mask: int
    all_off: int
    pulse_us: int
    next_tick_us: int


class Robot:
    """One robot in C. Time is what the test says it is. Of its limbs it knows that they are cold."""

    def __init__(
        self, table: bytes | None = None, now_us: int = 1_000_000, made: Any = None, heat_known: bool = True
    ) -> None:
        self.core = core() if made is None else made
        self.image = image() if table is None else table
        self.now_us = now_us
        self.memory = FFI.new("fk_robot_t *")
        self._image = FFI.new("uint64_t[]", (len(self.image) + 7) // 8)
        FFI.memmove(self._image, self.image, len(self.image))
        self._outputs = FFI.new("fk_outputs_t *")
        self._collector = FrameCollector()
        self._sequence = 0
        self._fixes = 0
        self._kept: list[Frame] = []
        self.auth: CommandCodes | None = None
        self.keep = False
        image_at = FFI.cast("uint8_t *", self._image)
        self.error = self.core.fk_robot_init(self.memory, image_at, len(self.image))
        self.kept = kept_of()
        if heat_known:
            self.core.fk_robot_note_reset(self.memory, link_layout().reset["UNKNOWN"], self.kept)

    def use_store(self, flash: Any) -> None:
        """Tables and the key are kept there (store_rig.Flash). C holds its address, so it must live on."""
        self._flash = flash
        self.core.fk_robot_use_store(self.memory, flash.store)

    def raw(self, encoded: bytes) -> None:
        """One frame without its delimiter."""
        self.core.fk_robot_on_frame(self.memory, encoded, len(encoded), self.now_us)

    def post(
        self, name: str, values: dict[str, Value] | None = None, rows: Sequence[Sequence[Value]] = ()
    ) -> int:
        self._sequence = (self._sequence + 1) & 0xFF
        values = hello() if name == "HELLO" and values is None else values
        self.raw(pack_frame(name, "command", self._sequence, values, rows, self.auth)[:-1])
        return self._sequence

    def ask(
        self, name: str, values: dict[str, Value] | None = None, rows: Sequence[Sequence[Value]] = ()
    ) -> dict[str, Value]:
        """A command and the values of its answer; events that stand before it are dropped."""
        sequence = self.post(name, values, rows)
        frame = self.take()[-1]
        assert (frame.name, frame.kind, frame.sequence) == (name, "answer", sequence)
        return frame.values

    def status(
        self, name: str, values: dict[str, Value] | None = None, rows: Sequence[Sequence[Value]] = ()
    ) -> str:
        """The name of the answer's status."""
        return link_layout().status_name(int(self.ask(name, values, rows)["status"]))

    def tick(self, now_us: int | None = None) -> Outputs:
        self.now_us = self.now_us if now_us is None else now_us
        self.core.fk_robot_tick(self.memory, self.now_us, self._outputs)
        out = self._outputs
        if self.keep:
            self._kept += self.take()
        return Outputs(out.limb_mask, out.all_off, out.pulse_us, out.next_tick_us)

    def run_until(self, until_us: int) -> list[tuple[int, int]]:
        """Tick whenever the core asks for it; the pulses: (time, limbs)."""
        pulses = []
        due_us = self.now_us
        for _ in range(100_000):
            out = self.tick(due_us)
            if out.limb_mask:
                pulses.append((self.now_us, out.limb_mask))
            if out.next_tick_us > until_us:
                self.now_us = until_us
                return pulses
            due_us = max(self.now_us, out.next_tick_us)
        raise AssertionError("the core asks for ticks without end")

    def take(self, capacity: int = 1024) -> list[Frame]:
        """The frames that wait to be sent; none of them may be damaged."""
        frames = self._collector.feed(self.take_bytes(capacity))
        assert self._collector.bad == 0
        return frames

    def take_all(self) -> list[Frame]:
        """All that was sent since the last call, though it went through the buffer in parts."""
        kept, self._kept = self._kept, []
        return kept + self.take()

    def take_bytes(self, capacity: int = 1024) -> bytes:
        buffer = FFI.new("uint8_t[]", max(1, capacity))
        return bytes(FFI.buffer(buffer, self.core.fk_robot_take_tx(self.memory, buffer, capacity)))

    def fix(self, x_m: float = 0.1, y_m: float = 0.0, heading_rad: float = 0.0, **changes: Value) -> str:
        """A position fix; its status."""
        self._fixes += 1
        values: dict[str, Value] = {
            "fix_sequence": self._fixes, "quality": 1, "capture_age_us": 0,
            "x_m": x_m, "y_m": y_m, "heading_rad": heading_rad,
        }  # fmt: skip
        return self.status("FIX", values | changes)

    def path(self, points: int = 20) -> None:
        """A straight path of one metre along x."""
        rows = [(index / (points - 1), 0.0, 0.0) for index in range(points)]
        for first in range(0, points, 18):
            part = rows[first : first + 18]
            assert self.status("PATH", {"first": first, "total": points, "count": len(part)}, part) == "OK"

    def state(self) -> str:
        value = self.ask("STATUS")["state"]
        return next(name for name, number in STATE.items() if number == value)

    def start(self, delay_us: int = 0) -> str:
        return self.status("START", {"delay_us": delay_us})

    def stroke(self, name: str) -> str:
        return self.status("STROKE", {"action": ACTION[name]})

    def begin(self, state: str) -> Robot:
        """Bring a fresh robot into a state; RUNNING has its first decision a second later."""
        self.tick()
        if state == "FAULT":
            self.path()
            self.core.fk_robot_note_pulse_failed(self.memory, -1)
            assert self.tick().all_off
        elif state != "DISARMED":
            assert self.status("ARM") == "OK"
        if state == "RUNNING":
            self.path()
            assert self.fix(capture_age_us=1000) == "OK"
            assert self.start(1_000_000) == "OK"
        return self


def bits(value: float) -> int:
    """The bits of a float32."""
    return int(struct.unpack("<I", struct.pack("<f", value))[0])
