"""The robot's Zephyr application as a robot to talk to: built for this computer, Zephyr played."""

from __future__ import annotations

import ctypes
import re
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from tests.runs import rig

from frogkick.link.frames import Frame, FrameCollector
from frogkick.link.wire import Edge
from frogkick.runs.session import Session
from frogkick_codegen.toolchain import zig

if TYPE_CHECKING:
    from kconfiglib import Kconfig

ROBOT = Path(__file__).parents[2] / "firmware" / "robot"
DECLARED = Path(__file__).parent / "zephyr"
LIBC = {"errno.h", "string.h", "stddef.h", "stdint.h"}
PINS = tuple(range(22, 30))
_ROOM = 65536


class _Edge(ctypes.Structure):
    _fields_ = [("at_us", ctypes.c_uint64), ("pin", ctypes.c_uint32), ("level", ctypes.c_uint32)]


def headers(text: str, folder: Path) -> None:
    """Let every header of Zephyr's that a source includes lead to the declarations."""
    for name in set(re.findall(r"#include <([^>]+)>", text)) - LIBC:
        header = folder / name
        header.parent.mkdir(parents=True, exist_ok=True)
        own = DECLARED / header.name  # where the order of includes matters
        header.write_text(own.read_text() if own.exists() else '#include "declared.h"\n')


def play(made: Path, folder: Path, options: list[str]) -> Path:
    """Build the application and its stage.

    Args:
        made: what ``frogkick firmware build`` left.
        folder: to build in.
        options: definitions of its configuration.
    """
    own = sorted((ROBOT / "src").glob("*.c"))
    for source in own:
        headers(source.read_text(), folder / "include")
    sources = [*own, *sorted((ROBOT.parent / "core").glob("*.c")), *sorted(DECLARED.glob("played*.c"))]
    sources += [file for file in sorted((made / "emitted").glob("*.c")) if "example" not in file.name]
    includes = [folder / "include", DECLARED, ROBOT / "src", ROBOT.parent / "core", made, made / "emitted"]
    # Without optimising zig would compile its own run-time library anew, which takes longer than all of this.
    flags = ["-std=gnu2x", "-O1", "-fPIC", "-shared", "-Wall", "-Werror", "-Dmain=fk_zephyr_main"]
    flags += [
        "-ffp-contract=off",
        "-fno-math-errno",
        "-fno-sanitize=all",
        *(f"-I{path}" for path in includes),
    ]
    zig("host").run([*flags, *options, *sources, "-o", "played.so", "-lpthread"], folder)
    return folder / "played.so"


class ZephyrRobot:
    """A ``RobotPort``: the application over a link that may fade, in simulated time, computing in no time.

    Attributes:
        stage: the functions of played.c.
        now_us: the simulated time.
    """

    def __init__(self, library: Path, folder: Path, reset_cause: int = 0) -> None:
        """Let it start, by power-on or another cause, nobody connected.

        A copy of the library, as its state is the process's.
        """
        number = len(list(folder.glob("life*.so")))
        self.stage = ctypes.CDLL(str(shutil.copy(library, folder / f"life{number}.so")))
        self.stage.play_watchdog_us.restype = ctypes.c_uint64
        self._room, self._edges = ctypes.create_string_buffer(_ROOM), (_Edge * 4096)()
        self._collector = FrameCollector()
        self.now_us = 0
        self.stage.play_reset_cause(reset_cause)
        self.stage.play_begin()

    def connect(self, mtu: int = 247, subscribed: bool = True) -> None:
        """A host connects."""
        self.stage.play_mtu(mtu)
        self.stage.play_connect(int(subscribed))

    def send(self, encoded: bytes, at_s: float) -> None:
        """Write to the service, at once."""
        self.stage.play_write(encoded, len(encoded))

    def advance(self, until_s: float) -> None:
        """Let it live."""
        self.now_us = max(self.now_us, round(until_s * 1e6))
        assert self.stage.play_until(ctypes.c_uint64(self.now_us)) == 0, "threads turn without end"

    def air(self) -> bytes:
        """What the host has got since the last call, as bytes."""
        count = self.stage.play_sent(self._room)
        return self._room.raw[:count]

    def frames(self) -> list[tuple[float, Frame]]:
        """Frames that have come since the last call, with the time of this one."""
        return [(self.now_us * 1e-6, frame) for frame in self._collector.feed(self.air())]

    def pair(self, right: bool) -> bool:
        """A new host pairs, with the right passkey or another; whether it is let try."""
        return bool(self.stage.play_pair(int(right)))

    @property
    def crystal_held(self) -> bool:
        """Whether somebody holds the crystal; never twice, never given back without having been asked for."""
        users = int(self.stage.play_crystal_users())
        assert users in (0, 1)
        return bool(users)

    @property
    def bad_frames(self) -> int:
        """What came and was no frame."""
        return self._collector.bad

    def edges(self) -> list[Edge]:
        """Edges of the gates since the last call."""
        count = self.stage.play_edges(self._edges)
        return [Edge(e.at_us * 1e-6, PINS.index(e.pin), bool(e.level)) for e in self._edges[:count]]

    @property
    def watchdog_s(self) -> float:
        """The longest time that the watchdog was not fed."""
        return float(self.stage.play_watchdog_us()) * 1e-6


VERSIONS = {"3, 7, 0": "0x3070000", "4, 3, 0": "0x4030000"}
"""Of Zephyr: as its C macro takes it, and as its version.cmake tells Kconfig (KERNELVERSION)."""


def configuration(monkeypatch: pytest.MonkeyPatch, *settings: Path, version: str = "3, 7, 0") -> Kconfig:
    from kconfiglib import Kconfig

    monkeypatch.setenv("srctree", str(DECLARED))
    monkeypatch.setenv("KERNELVERSION", VERSIONS[version])
    found = Kconfig(str(ROBOT / "Kconfig"), warn_to_stderr=False)
    found.warn_assign_override = (
        False  # as in Zephyr's kconfig.py: a later file takes back an earlier one's line
    )
    for number, file in enumerate(settings):
        found.load_config(str(file), replace=number == 0)
    return found


def defines(found: Kconfig) -> list[str]:
    reported = []
    for symbol in found.unique_defined_syms:
        if symbol.str_value not in ("n", ""):
            quoted = symbol.name == "BT_DEVICE_NAME"
            value = f'"{symbol.str_value}"' if quoted else symbol.str_value.replace("y", "1")
            reported.append(f"-DCONFIG_{symbol.name}={value}")
    # As CMakeLists.txt passes it to the core.
    return [*reported, f"-DFK_LOG_BYTES={found.syms['FROGKICK_LOG_BYTES'].str_value}u"]


RESTED_S = 5.1
"""Its RAM kept nothing: it lets its limbs rest first."""


class Life:
    """A robot and a host that talks to it."""

    def __init__(self, played: Path, mtu: int = 247) -> None:
        self.tables = rig.tables()
        self.robot = ZephyrRobot(played, played.parent)
        self.session = Session(self.robot)
        self.session.step(RESTED_S)
        self.robot.connect(mtu)
        self.session.handshake(self.tables)

    @property
    def firing(self) -> int:
        return next(i for i, row in enumerate(self.tables.actions) if row.first_mask and row.second_mask)

    def live(self, for_s: float) -> None:
        self.session.step(self.session.time_s + for_s)

    def state(self) -> int:
        return int(self.session.request("STATUS")["state"])
