"""A robot's fetched log as HDF5: the bytes of each stretch, and the robot they come from."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from frogkick.core.errors import InputError
from frogkick.core.files import existing_file
from frogkick.link.layout import link_layout
from frogkick.link.log import ChipLog, Stretch
from frogkick.runs.runlog_file import hdf5_to_write

FORMAT = "frogkick chip log"
FORMAT_VERSION = 1


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
    """Read a log.

    Raises:
        InputError: missing, foreign or damaged file.
    """
    path = existing_file(source, "chip log")
    try:
        with h5py.File(path, "r") as file:
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
