"""What a machine is ready for: no hardware, a development kit on a cable, a robot under a camera."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from frogkick.link.serial import ports


@dataclass(frozen=True)
class Finding:
    """One thing looked at: what it is for, whether it works, what to do if not."""

    name: str
    works: bool
    detail: str
    needed_for: str
    install: str = ""


@dataclass(frozen=True)
class Stage:
    """One of the three ways to begin.

    Attributes:
        name: of the stage.
        begin: the command to begin with.
        findings: what it needs.
    """

    name: str
    begin: str
    findings: tuple[Finding, ...]

    @property
    def ready(self) -> bool:
        """Nothing is missing."""
        return all(finding.works for finding in self.findings)

    def as_json(self) -> dict[str, object]:
        """One of ``stages``."""
        return {
            "name": self.name,
            "ready": self.ready,
            "begin": self.begin,
            "missing": [asdict(finding) for finding in self.findings if not finding.works],
        }


def package(name: str, needed_for: str, extra: str) -> Finding:
    """A package of Python's."""
    found = importlib.util.find_spec(name) is not None
    hint = "" if found else f"pip install 'frogkick[{extra}]'" if extra else "make venv"
    return Finding(name, found, "installed" if found else "missing", needed_for, hint)


def stages(without_robot: Sequence[Finding]) -> list[Stage]:
    """The three, as this machine is now."""
    kit = (
        package("pyocd", "flashing a development kit", "flash"),
        package("serial", "talking with it", "link"),
        _hardware("serial port", "talking with it", "plug the kit's USB cable in", serial_ports),
    )
    robot = (
        package("bleak", "talking with a robot by Bluetooth", "link"),
        package("cv2", "the camera", ""),
        _hardware("Bluetooth adapter", "talking with a robot", "plug one in, switch it on", adapters),
        _hardware("camera", "position fixes", "plug one in, and may this user read it?", cameras),
    )
    return [
        Stage("no hardware", "frogkick demo", tuple(without_robot)),
        Stage(
            "a development kit",
            "frogkick firmware build --target bench, firmware flash, run --robot serial:PORT --fixes pool",
            kit,
        ),
        Stage(
            "a robot in a pool", "frogkick camera calibrate, run --robot ble:NAME --fixes camera.toml", robot
        ),
    ]


def _hardware(name: str, needed_for: str, hint: str, look: Callable[[], list[str] | None]) -> Finding:
    found = look()
    if found is None:
        return Finding(name, True, "not looked for on this system", needed_for)
    return Finding(name, bool(found), ", ".join(found) or "none", needed_for, "" if found else hint)


def serial_ports() -> list[str]:
    """Names of serial ports with something plugged in; none without the package that lists them."""
    return ports() if importlib.util.find_spec("serial") is not None else []


def adapters(folder: Path = Path("/sys/class/bluetooth")) -> list[str] | None:
    """Bluetooth adapters that Linux knows; None on another system."""
    return _entries(folder, "hci")


def cameras(folder: Path = Path("/dev")) -> list[str] | None:
    """Video devices that Linux knows; None on another system."""
    return _entries(folder, "video")


def _entries(folder: Path, prefix: str) -> list[str] | None:
    if sys.platform != "linux":
        return None
    return sorted(entry.name for entry in folder.glob(f"{prefix}*")) if folder.is_dir() else []
