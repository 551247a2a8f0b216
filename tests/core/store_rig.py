"""The core's table store on a NOR flash in memory, whose power fails at any operation."""

from __future__ import annotations

import struct
import zlib
from functools import cache
from typing import Any

from tests.core.core import FFI, Robot, core, library
from tests.planner import synthetic

from frogkick.link.layout import link_layout

PAGE = 4096
RECORD = 108
STEP = 2 * RECORD + 4
"""Two copies of a record, and the mark."""
PLACES = (PAGE - 4) // STEP
JOURNAL = 2 * PAGE
HOWS = ("not done", "done in part", "garbage", "marginal")

AT_REST_US = 600_000


@cache
def table(seed: int) -> bytes:
    """A small table for frog2022: one whole page and a part of another."""
    return synthetic.affine_image(20, 9, seed)


def crc_of(image: bytes) -> int:
    return zlib.crc32(image[16:])


class Flash:
    """The region and the store that booted on it last.

    Attributes:
        memory: its bytes; they outlive a power cut.
        built_in: the firmware's own table.
    """

    def __init__(
        self, lib: Any = None, slots: int = 2, slot_bytes: int = 2 * PAGE, built_in: bytes = b""
    ) -> None:
        self.lib = core() if lib is None else lib
        self.built_in = built_in or table(1)
        self._built_in = FFI.from_buffer(self.built_in)
        size = JOURNAL + slots * slot_bytes
        self._bytes = FFI.new("uint8_t[]", b"\xff" * size)
        self.memory = FFI.buffer(self._bytes, size)
        self._weak = FFI.new("uint8_t[]", size)
        self.sim = FFI.new(
            "fk_flash_sim_t *", {"bytes": self._bytes, "weak": self._weak, "size": size, "random": 1}
        )
        self.flash = FFI.new("fk_flash_t *", {"slot_bytes": slot_bytes, "slots": slots})
        self.store = FFI.new("fk_store_t *")
        self.error = FFI.new("int8_t *")
        lib = self.lib
        lib.fk_test_store_setup(self.sim, self.flash)
        assert self.boot() == 0

    def boot(self, cut: tuple[int, int] | None = None) -> int:
        """Power on: what is in flash, and nothing else. The boot after it agrees, and writes nothing.

        ``cut``: lose the power in that operation of the boot, in that way.
        """
        found, sim = self._boot(cut), self.sim
        self.boot_operations = sim.operations
        if sim.operations and not sim.dead:
            state = self.state
            assert self._boot(None) == found and self.state == state, "the next boot does not agree"
            # Marginal bits that read as if nothing was written there may lie below the first copy.
            assert sim.operations == 0 or any(self._weak[0:JOURNAL]), "the next boot writes"
        sim.operations = 0
        self.lib.fk_test_store_keep(sim, self.store)
        return found

    def _boot(self, cut: tuple[int, int] | None) -> int:
        sim = self.sim
        sim.dead = sim.cut_at = sim.fail_at = sim.fail_until = sim.operations = sim.keep_from = (
            sim.keep_to
        ) = 0
        if cut is not None:
            sim.cut_at, sim.cut_how = cut
        self.lib.fk_test_store_power_on(sim)
        FFI.memmove(self.store, b"\xa5" * FFI.sizeof("fk_store_t"), FFI.sizeof("fk_store_t"))
        return int(self.lib.fk_store_boot(self.store, self.flash, self._built_in, len(self.built_in)))

    @property
    def key(self) -> bytes:
        """The owner's; 32 zeros: none."""
        return struct.pack("<8I", *self.store.record.owner_key)

    @property
    def state(self) -> tuple[int, int, int, bytes]:
        """What a boot finds."""
        return self.store.running, self.store.lost, self.lib.fk_store_is_owned(self.store), self.key

    def own(self, key: bytes) -> str:
        return self._status(self.lib.fk_store_own(self.store, list(struct.unpack("<8I", key))))

    def restore(self, memory: bytes) -> None:
        """Put back what stood in flash, every bit of it firm, and boot."""
        self.memory[:] = memory
        FFI.buffer(self._weak)[:] = bytes(len(memory))
        assert self.boot() == 0

    def cut(self, at: int, how: int, seed: int) -> None:
        """Let the power fail in an operation from now on, the first is 1."""
        self.sim.operations, self.sim.cut_at, self.sim.cut_how, self.sim.random = 0, at, how, seed * 2 + 1

    def fail(self, at: int, many: int = 1) -> None:
        """Let so many operations do nothing from one on, the next one is 1; the power stays."""
        self.sim.operations, self.sim.fail_at, self.sim.fail_until = 0, at, at + many - 1

    @property
    def image(self) -> bytes:
        """The table in use, as the flash has it."""
        return bytes(FFI.buffer(self.store.image, self.store.image_bytes))

    def _status(self, value: int) -> str:
        return link_layout().status_name(value)

    def upload(self, image: bytes, stop_at: int = 1 << 30) -> str:
        """A whole update by the store's own functions; without COMMIT where it stops earlier."""
        status = self.lib.fk_test_store_upload(self.store, image, len(image), stop_at, self.error)
        return self._status(status)

    def begin(self, image: bytes, length: int | None = None) -> str:
        digest = FFI.new("uint8_t[32]")
        self.lib.fk_test_sha256(image, len(image), digest)
        raw = bytes(FFI.buffer(digest))
        words = [int.from_bytes(raw[i : i + 4], "big") for i in range(0, 32, 4)]
        size = len(image) if length is None else length
        return self._status(self.lib.fk_store_begin(self.store, size, words))

    def chunk(self, offset: int, data: bytes) -> str:
        return self._status(self.lib.fk_store_chunk(self.store, offset, data, len(data)))

    def chunks(self, image: bytes) -> list[str]:
        """All chunks that are left."""
        reported = []
        while self.store.next_offset < len(image):
            at = self.store.next_offset
            reported.append(self.chunk(at, image[at : at + 128]))
        return reported

    def commit(self) -> str:
        return self._status(self.lib.fk_store_commit(self.store, self.error))

    def rollback(self, image: bytes) -> str:
        return self._status(self.lib.fk_store_rollback(self.store, crc_of(image), self.error))

    def fill_journal(self, left: int) -> None:
        """Begin to write uploads until a journal page has so many places left."""
        while PLACES - self.store.place != left:
            assert self.begin(table(9)) == "OK" and self.chunk(0, table(9)[:128]) == "OK"


OLD, NEW, NEXT, LATER = table(2), table(3), table(4), table(5)


def forged(changes: dict[int, bytes], image: bytes = NEW) -> bytes:
    """An image with bytes changed and its CRC-32 made right again."""
    data = bytearray(image)
    for at, content in changes.items():
        data[at : at + len(content)] = content
    data[12:16] = struct.pack("<I", zlib.crc32(bytes(data[16:])))
    return bytes(data)


def wrong_images() -> dict[str, tuple[bytes, int]]:
    """Images that no robot of this firmware may use, and the fk_error_t that says why."""
    splits_at = struct.unpack("<I", NEW[120:124])[0]
    states_at = struct.unpack("<I", NEW[80:84])[0]
    columns_at = struct.unpack("<I", NEW[116:120])[0]
    return {
        "magic": (forged({0: b"XKTB"}), -21),
        "newer format": (forged({4: b"\x04\0"}), -22),
        "kind": (forged({6: b"\x07\0"}), -23),
        "length": (forged({8: struct.pack("<I", len(NEW) - 4)}), -24),
        "crc": (NEW[:12] + bytes([NEW[12] ^ 1]) + NEW[13:], -25),
        "states": (forged({72: b"\xff\xff"}), -27),
        "offset of the states": (forged({80: struct.pack("<I", states_at + 4)}), -27),
        "robot": (forged({16: b"another\0\0"}), -9),
        "pulse above the guard's limit": (forged({68: struct.pack("<I", 100_001)}), -29),
        "stroke longer than the period": (forged({112: struct.pack("<I", 1_400_000)}), -29),
        "a limb that is not there": (forged({178: b"\xff"}), -31),
        "a split beyond its codes": (forged({splits_at: b"\xff\x7f"}), -33),
        "a state beyond its codes": (forged({states_at: b"\xff\x7f"}), -33),
        "a derivative beyond its range": (forged({columns_at: b"\xff\x7f"}), -33),
        "a tree axis that is none": (forged({172: b"\x03"}), -34),
    }


def robot_with_store(
    flash: Flash | None = None, files: dict[str, bytes] | None = None, at_us: int = AT_REST_US
) -> tuple[Robot, Flash]:
    """A robot that was switched on so long ago; ``files``: of a core that a test changed."""
    flash = Flash(built_in=OLD) if flash is None else flash
    robot = Robot(OLD, 0, None if files is None else library(files))
    robot.use_store(flash)
    robot.tick(0)
    robot.tick(at_us)
    return robot, flash


def refusals(lib: Any = None) -> None:
    """A wrong image, sent whole and with its right hash, stays unused; so does what differs from its hash."""
    for what, (image, error) in wrong_images().items():
        flash = Flash(lib)
        assert flash.upload(OLD) == "OK"
        assert flash.upload(image) == "TABLE", what
        assert flash.error[0] == error, what
        assert_unchanged(flash)
    flash = Flash(lib)
    assert flash.upload(OLD) == "OK"
    assert flash.begin(NEW) == "OK"
    wrong = bytearray(NEW)
    wrong[200] ^= 4
    assert set(flash.chunks(bytes(wrong))) == {"OK"}
    assert flash.commit() == "HASH"
    assert_unchanged(flash)


def assert_unchanged(flash: Flash) -> None:
    assert flash.image == OLD
    assert flash.store.open == 0
    assert flash.boot() == 0
    assert flash.image == OLD
    assert flash.store.record.pending == 0  # nothing to go on with
    assert flash.upload(NEW) == "OK"
    assert flash.image == NEW
