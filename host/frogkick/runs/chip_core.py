"""The robot's C core on this computer, which replays the records of a robot's log."""

from __future__ import annotations

from pathlib import Path

from frogkick.core.errors import FrogkickError
from frogkick.core.shared_library import load
from frogkick.link.frames import pack_raw
from frogkick.link.layout import link_layout
from frogkick.link.log import Record, Stretch, records_of

_CHUNK = 4096


class ChipCore:
    """The core, started from a snapshot. Each call but ``begin`` returns the records that the core wrote."""

    def __init__(self, library: Path, image: bytes) -> None:
        """Load a library made by ``firmware build --target native``.

        Args:
            library: made for the same robot.
            image: table image that the robot used.
        """
        self._ffi, self._core = load(library)
        self._image = self._ffi.new("uint64_t[]", (len(image) + 7) // 8)
        self._ffi.memmove(self._image, image, len(image))
        self._image_bytes = len(image)
        self._outputs = self._ffi.new("fk_outputs_t *")
        self._from = self._ffi.new("uint32_t *")
        self._buffer = self._ffi.new("uint8_t[]", _CHUNK)
        self._sequence = 0

    def begin(self, snapshot: bytes) -> None:
        """Restore a snapshot.

        Raises:
            FrogkickError: the core refuses the table, or the snapshot.
        """
        core, ffi = self._core, self._ffi
        self._memory = ffi.new("fk_robot_t *")
        self._log = ffi.new("fk_log_t *")
        self._offset = 0
        error = core.fk_robot_init(self._memory, ffi.cast("uint8_t *", self._image), self._image_bytes)
        if error:
            raise FrogkickError(f"the core refuses the table (fk_error_t {error}): give the robot's own")
        core.fk_robot_use_log(self._memory, self._log)
        if core.fk_robot_restore(self._memory, snapshot, len(snapshot)):
            raise FrogkickError(
                "the core refuses the snapshot: it is of another firmware; fetch and replay with the same one"
            )
        self._written()

    def command(self, record: Record) -> list[Record]:
        """Pass the command of a COMMAND record."""
        self._sequence = (self._sequence + 1) & 0xFF
        encoded = pack_raw(int(record.values["type"]), self._sequence, record.rest)[:-1]
        self._core.fk_robot_on_frame(self._memory, encoded, len(encoded), record.time_us)
        return self._written()

    def pulse_failed(self, detail: int) -> list[Record]:
        """Report that the port could not start a pulse."""
        self._core.fk_robot_note_pulse_failed(self._memory, detail)
        return self._written()

    def link_lost(self, now_us: int) -> list[Record]:
        """Report that the connection to the host was lost."""
        self._core.fk_robot_note_time(self._memory, now_us)
        self._core.fk_robot_note_link_lost(self._memory)
        return self._written()

    def supply_low(self, now_us: int) -> list[Record]:
        """Report a low supply."""
        self._core.fk_robot_note_time(self._memory, now_us)
        self._core.fk_robot_note_supply(self._memory, 1)
        return self._written()

    def note_time(self, now_us: int) -> list[Record]:
        """Pass a time, as a frame does that is not logged."""
        self._core.fk_robot_note_time(self._memory, now_us)
        return self._written()

    def tick(self, now_us: int) -> list[Record]:
        """Call the core's tick."""
        self._core.fk_robot_tick(self._memory, now_us, self._outputs)
        return self._written()

    def _written(self) -> list[Record]:
        while self._core.fk_robot_take_tx(self._memory, self._buffer, _CHUNK):
            pass
        content = b""
        while count := self._core.fk_log_read(
            self._log, (self._offset + len(content)) % 2**32, self._buffer, _CHUNK, self._from
        ):
            content += bytes(self._ffi.buffer(self._buffer, count))
        records = records_of(Stretch(self._offset, content))
        self._offset = (self._offset + len(content)) % 2**32
        return records


LATE, TOO_LATE = -16, 2
"""FK_PULSE_LATE, and FK_PULSE_TOO_LATE in a PULSE record: the port was too late to begin it."""


def pulse_fault(record: Record) -> bool:
    """Whether the port reported a FAULT, so that it can be repeated."""
    return record.values["fault"] == link_layout().fault["PULSE"]
