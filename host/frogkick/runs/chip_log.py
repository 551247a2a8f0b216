"""A robot's fetched log: its file (HDF5, the bytes of each contiguous part), and its replay.

The C core on this computer and the Python twin replay it, and are compared with it bit by bit. A segment of
the replay starts at a snapshot and ends before the next event that cannot be repeated: a start of the robot,
a table update, a gap in the log (which the next snapshot reports), an internal error that is not the port's,
a damaged record, or the end of the log.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from frogkick.core.errors import FrogkickError, InputError
from frogkick.core.files import existing_file
from frogkick.core.hdf5 import hdf5_to_read, hdf5_to_write
from frogkick.core.shared_library import load
from frogkick.link.frames import pack_raw
from frogkick.link.layout import link_layout, supervisor
from frogkick.link.log import DAMAGED, UNFINISHED, ChipLog, Record, Stretch, records_of
from frogkick.robot import in_a_row
from frogkick.runs.chip_twin import ChipTwin
from frogkick.runs.decision import Decision
from frogkick.tables.image import Tables

FORMAT = "frogkick chip log"
FORMAT_VERSION = 1
LATE, TOO_LATE = -16, 2
"""FK_PULSE_LATE, and FK_PULSE_TOO_LATE in a PULSE record: the port was too late to begin it."""
_CHUNK = 4096
_TICKS = 3  # at one time: a stroke begins, a decision, another stroke
_TABLE_COMMANDS = ("TABLE_BEGIN", "TABLE_COMMIT", "TABLE_ROLLBACK")


@dataclass(frozen=True)
class FetchedLog:
    """A log and its robot."""

    robot_id: str  # from HELLO
    table_crc: int  # of the table in use when the log was fetched
    log: ChipLog

    def summary(self) -> dict[str, Any]:
        """Records, bytes, gaps, duration (s), starts and faults by name, number of records of each kind."""
        records = [record for stretch in self.log.records() for record in stretch]

        def names(record_name: str, field: str, numbers: dict[str, int]) -> list[str]:
            by_number = {number: name for name, number in numbers.items()}
            found = [int(record.values[field]) for record in records if record.name == record_name]
            return [by_number.get(number, str(number)) for number in found]

        return {
            "robot_id": self.robot_id,
            "records": len(records),
            "lost": self.log.lost,
            "bytes": sum(len(stretch.content) for stretch in self.log.stretches),
            "gaps": max(0, len(self.log.stretches) - 1),
            "seconds": (records[-1].time_us - records[0].time_us) * 1e-6 if records else 0.0,
            "starts": names("BOOT", "reset", link_layout().reset),
            "faults": names("FAULT", "fault", link_layout().fault),
            "kinds": dict(sorted(Counter(record.command or record.name for record in records).items())),
        }


def write_log(target: Path | str, fetched: FetchedLog) -> None:
    """Write a log, completely or not at all; the same log gives the same bytes.

    Raises:
        InputError: the folder cannot be written to.
    """
    with hdf5_to_write(target) as file:
        file.attrs["format"] = FORMAT
        file.attrs["format_version"] = FORMAT_VERSION
        file.attrs["robot_id"] = fetched.robot_id
        file.attrs["table_crc"] = np.uint32(fetched.table_crc)
        file.attrs["lost"] = np.uint32(fetched.log.lost)
        for number, stretch in enumerate(fetched.log.stretches):
            content = np.frombuffer(stretch.content, dtype=np.uint8)
            file.create_dataset(f"stretch_{number:04d}", data=content).attrs["offset"] = np.uint32(
                stretch.offset
            )


def read_log(source: Path | str) -> FetchedLog:
    """Read a log. InputError: missing, foreign or damaged file."""
    path = existing_file(source, "chip log")
    try:
        with hdf5_to_read(path) as file:
            found, version = file.attrs.get("format"), int(file.attrs.get("format_version", 0))
            if (found, version) != (FORMAT, FORMAT_VERSION):
                raise InputError(
                    f"{path.name!r} holds {found!r} version {version}, expected {FORMAT!r} version "
                    f"{FORMAT_VERSION}: give a file that 'frogkick log fetch' wrote"
                )
            stretches = tuple(Stretch(int(file[name].attrs["offset"]), bytes(file[name][:])) for name in file)
            return FetchedLog(
                str(file.attrs["robot_id"]),
                int(file.attrs["table_crc"]),
                ChipLog(stretches, int(file.attrs["lost"])),
            )
    except (OSError, KeyError, RuntimeError, ValueError, TypeError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(
            f"{path.name!r} is not a chip log or is damaged ({reason}): fetch it again"
        ) from error


@dataclass(frozen=True)
class Mismatch:
    """A record that the replay does not reproduce."""

    # offset, time_us: of the record
    offset: int
    time_us: int
    place: str  # "core", "twin", or "log" where the record itself is damaged
    what: str


@dataclass
class LogReplay:
    """Result of a replay."""

    # records, replayed: number of the log's records, and of those that were replayed
    records: int = 0
    replayed: int = 0
    segments: int = 0  # number of snapshots at which the replay started
    decisions: list[Decision] = field(default_factory=list)  # of the twin
    actions: list[str] = field(default_factory=list)  # their names; "-" without a plan
    mismatches: list[Mismatch] = field(default_factory=list)  # in order of time

    def as_json(self) -> dict[str, Any]:
        """The keys of the command ``log replay``."""
        values: dict[str, Any] = {
            "records": self.records,
            "replayed": self.replayed,
            "segments": self.segments,
            "decisions": len(self.decisions),
            "actions": in_a_row(self.actions),
            "mismatches": len(self.mismatches),
        }
        if self.mismatches:
            first = self.mismatches[0]
            time_s = first.time_us * 1e-6
            values["first_mismatch"] = {"time_s": time_s, "place": first.place, "what": first.what}
        return values


@dataclass(frozen=True)
class _Snapshot:
    """Records [begin, end) are its parts."""

    begin: int
    end: int
    content: bytes
    table_crc: int


def replay_log(
    log: ChipLog,
    library: Path,
    tables: Sequence[Tables],
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> LogReplay:
    """Replay a log.

    Args:
        log: the robot's.
        library: the core for this computer, made by ``firmware build --target native`` for the same robot.
        tables: tables that the robot used; segments with another table are left out.
        progress: called with the number of records done and of all records.

    Raises:
        FrogkickError: the core refuses a table.
    """
    found = LogReplay()
    by_crc = {table.crc32: table for table in tables}
    cores = {crc: ChipCore(library, table.image) for crc, table in by_crc.items()}
    stretches = log.records()
    total = sum(map(len, stretches))
    for records in stretches:
        found.mismatches += _damage(records)
        _replay_stretch(records, by_crc, cores, found)
        found.records += len(records)
        progress(found.records, total)
    found.mismatches.sort(key=lambda mismatch: mismatch.time_us)
    return found


def _damage(records: list[Record]) -> list[Mismatch]:
    """Records that a correct robot never writes.

    These are records with a wrong check, commands after an unfinished one, and decisions or fixes after a
    start or a table update without a snapshot in between.
    """
    found, unfinished, without = [], False, ""
    for record in records:
        what = ""
        if record.name == DAMAGED:
            what = "the record's check is wrong"
        elif record.name == "COMMAND" and unfinished:
            what = "the command before it is unfinished"
        elif without and (record.name == "DECISION" or record.command == "FIX"):
            what = f"no snapshot since {without}"
        if what:
            found.append(Mismatch(record.offset, record.time_us, "log", what))
        if record.name in ("COMMAND", "BOOT"):
            unfinished = record.name == "COMMAND" and record.values["status"] == UNFINISHED
        if record.name == "BOOT" or record.command in _TABLE_COMMANDS:
            without = record.command or record.name
        elif what or record.name == "SNAPSHOT":
            without = ""
    return found


def _replay_stretch(
    records: list[Record], tables: Mapping[int, Tables], cores: Mapping[int, ChipCore], found: LogReplay
) -> None:
    at = 0
    for snapshot in _snapshots(records):
        if snapshot.table_crc not in tables or snapshot.begin < at:
            continue
        end = _end_of(records, snapshot)
        run = _Segment(records[snapshot.end : end], cores[snapshot.table_crc], found)
        at = snapshot.end + run.go(snapshot, tables[snapshot.table_crc])


def _snapshots(records: list[Record]) -> list[_Snapshot]:
    """The complete snapshots."""
    snapshots, begin, content = [], 0, b""
    for index, record in enumerate(records):
        if record.name != "SNAPSHOT":
            begin, content = -len(records), b""  # no part number fits until the next first part
            continue
        if record.values["part"] == 0:
            begin, content = index, b""
        if int(record.values["part"]) != index - begin:
            continue
        content += record.rest
        if record.values["last"]:
            snapshots.append(_Snapshot(begin, index + 1, content, int(record.values["table_crc"])))
    return snapshots


def _end_of(records: list[Record], snapshot: _Snapshot) -> int:
    """Index of the first record after a snapshot that cannot be replayed from it."""
    for index, record in enumerate(records[snapshot.end :], start=snapshot.end):
        if (
            record.name in (DAMAGED, "BOOT")
            or (record.name == "SNAPSHOT" and record.values["anew"])
            or (record.name == "FAULT" and record.values["fault"] != link_layout().fault["PULSE"])
            or (record.name == "COMMAND" and record.values["status"] == UNFINISHED)
            or record.command in _TABLE_COMMANDS
        ):
            return index
    return len(records)


class _Segment:
    def __init__(self, records: list[Record], core: ChipCore, found: LogReplay) -> None:
        self.records = records
        self.core = core
        self.found = found
        self.made: list[Record] = []

    def go(self, snapshot: _Snapshot, tables: Tables) -> int:
        """Replay the records; return how many the core could follow."""
        try:
            self.core.begin(snapshot.content)
            twin = ChipTwin(snapshot.content, tables)
        except FrogkickError as error:
            self._report(self.records[0] if self.records else None, "core", str(error))
            return 0
        self.found.segments += 1
        self.found.replayed += snapshot.end - snapshot.begin
        for index, record in enumerate(self.records):
            if not self.made and all(later.name == "SNAPSHOT" for later in self.records[index:]):
                return index  # the log ends before the command that the snapshot precedes
            if not self.made:
                self.made = self._cause(index)
            if not self.made:
                self._report(record, "core", f"{record.name} does not happen")
                return index
            made = self.made.pop(0)
            if (made.name, made.time_us) != (record.name, record.time_us):
                self._report(record, "core", f"{made.name} at {made.time_us} us instead of {record.name}")
                self.made = []
                return index
            if made.content != record.content:
                self._report(record, "core", f"{record.name} differs in {_fields(made, record)}")
                # One accepts the command and the other refuses it, so what follows differs.
                if record.name == "COMMAND":
                    self.made = []
                    return index
            for what in twin.replay(record):
                self._report(record, "twin", what)
            self.found.replayed += 1
        names = [row.name for row in tables.actions] + ["-"]
        self.found.decisions += twin.decisions
        self.found.actions += [names[decision.action] for decision in twin.decisions]
        return len(self.records)

    def _cause(self, index: int) -> list[Record]:
        """Make the core write the record; a snapshot is written by the command after it."""
        record = self.records[index]
        if record.name == "SNAPSHOT":
            record = next(r for r in self.records[index:] if r.name != "SNAPSHOT")
        if record.name == "COMMAND":
            return self.core.command(record)
        if record.name == "FAULT":
            return self.core.call(("fk_robot_note_pulse_failed", int(record.values["detail"])))
        if record.name == "PULSE" and record.values["allowed"] == TOO_LATE:
            return self.core.call(("fk_robot_note_pulse_failed", LATE))
        now = ("fk_robot_note_time", record.time_us)
        if record.name == "STATE" and record.values["event"] == supervisor().number("LINK_LOST"):
            return self.core.call(now, ("fk_robot_note_link_lost",))
        if record.name == "STATE" and record.values["event"] == supervisor().number("SUPPLY_LOW"):
            return self.core.call(now, ("fk_robot_note_supply", 1))  # 1: low
        made = self.core.call(now)
        for _ in range(_TICKS):
            if not made:
                made = self.core.call(("fk_robot_tick", record.time_us, self.core.outputs))
        return made

    def _report(self, record: Record | None, place: str, what: str) -> None:
        offset, time_us = (record.offset, record.time_us) if record is not None else (0, 0)
        self.found.mismatches.append(Mismatch(offset, time_us, place, what))


def _fields(made: Record, record: Record) -> str:
    names = [name for name, value in record.values.items() if made.values[name] != value]
    return ", ".join(names) or "its bytes"


class ChipCore:
    """The robot's C core on this computer. Each call but ``begin`` returns the records that it wrote.

    Attributes:
        outputs: for the core's tick.
    """

    def __init__(self, library: Path, image: bytes) -> None:
        """Load a library made by ``firmware build --target native``; ``image`` is the robot's table image."""
        self._ffi, self._core = load(library)
        self._image = self._ffi.new("uint64_t[]", (len(image) + 7) // 8)
        self._ffi.memmove(self._image, image, len(image))
        self._image_bytes = len(image)
        self.outputs = self._ffi.new("fk_outputs_t *")
        self._from = self._ffi.new("uint32_t *")
        self._buffer = self._ffi.new("uint8_t[]", _CHUNK)
        self._sequence = 0

    def begin(self, snapshot: bytes) -> None:
        """Restore a snapshot. FrogkickError: the core refuses the table, or the snapshot."""
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

    def call(self, *calls: tuple[Any, ...]) -> list[Record]:
        """Call functions of the core on the robot, each by its name and its further arguments."""
        for name, *given in calls:
            getattr(self._core, name)(self._memory, *given)
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
