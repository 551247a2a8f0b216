"""The stages that a machine is ready for: no hardware, a development kit, a robot under a camera."""

from __future__ import annotations

import os
import platform
import shutil
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from frogkick.core.errors import EXTRAS, FrogkickError, install_command, installed, printable
from frogkick.core.version import VERSION
from frogkick.link.serial import ports


@dataclass(frozen=True)
class Finding:
    """One checked item: its purpose, whether it works, and what to do if not."""

    name: str
    works: bool
    detail: str
    needed_for: str
    install: str = ""


@dataclass(frozen=True)
class Stage:
    """One of the three stages, with the commands to begin with and the items that it needs."""

    name: str
    begin: str
    findings: tuple[Finding, ...]

    @property
    def ready(self) -> bool:
        """Whether nothing is missing."""
        return all(finding.works for finding in self.findings)

    def as_json(self) -> dict[str, object]:
        """One of ``stages`` of the command ``doctor``."""
        return {
            "name": self.name,
            "ready": self.ready,
            "begin": self.begin,
            "missing": [asdict(finding) for finding in self.findings if not finding.works],
        }


@dataclass(frozen=True)
class Readiness:
    """The tools of this machine, for simulated runs and for more, and what is plugged in."""

    needed: tuple[Finding, ...]
    optional: tuple[Finding, ...]
    hardware: tuple[Finding, ...]
    stages: tuple[Stage, ...]

    @property
    def ready(self) -> bool:
        """Whether a run can be simulated here."""
        return all(finding.works for finding in self.needed)

    def as_json(self) -> dict[str, Any]:
        """The keys of the command ``doctor``."""
        return {
            "frogkick": VERSION,
            "python": platform.python_version(),
            "cores": os.cpu_count(),
            "ready_without_robot": self.ready,
            **{
                name: [asdict(finding) for finding in getattr(self, name)]
                for name in ("needed", "optional", "hardware")
            },
            "stages": [stage.as_json() for stage in self.stages],
        }


def check_machine() -> Readiness:
    """Check this machine for everything that the commands need."""
    extra = install_command("ziglang")
    needed = (
        tried("robot frog2022", "everything", "pip install frogkick", _try_robot),
        bench_image(),
        tried("C for this computer", "run --robot pool, parity", extra, _try_compiler),
        tried("virtual chip", "run --robot virtual, demo", extra, _try_chip),
    )
    optional = (
        package("distributed", "--cluster"),
        package("mcap", "export --mcap", *EXTRAS["mcap"]),
        package("pupil_apriltags", "tags of the family tagStandard41h12"),
        _program("arm-none-eabi-gcc", "apt install gcc-arm-none-eabi"),
        _program("qemu-system-arm", "apt install qemu-system-arm"),
        _program("cppcheck", "apt install cppcheck"),
    )
    hardware = check_hardware()
    return Readiness(needed, optional, hardware, tuple(stages(needed, hardware)))


def _found(name: str, is_there: bool, needed_for: str, install: str) -> Finding:
    return Finding(
        name, is_there, "installed" if is_there else "missing", needed_for, "" if is_there else install
    )


def _program(name: str, install: str) -> Finding:
    return _found(name, shutil.which(name) is not None, "extra checks", install)


def package(name: str, needed_for: str, *others: str) -> Finding:
    """Check a Python package, and others that it needs, as the commands do."""
    return _found(name, all(map(installed, (name, *others))), needed_for, install_command(name))


def tried(name: str, needed_for: str, install: str, attempt: Callable[[], str]) -> Finding:
    """Try a step of a command and return its result or its error."""
    try:
        return Finding(name, True, attempt(), needed_for)
    except FrogkickError as error:
        return Finding(name, False, " ".join(str(error).split()), needed_for, install)


def bench_image() -> Finding:
    """Check everything that ``firmware build`` needs."""
    return tried("firmware for the chip", "firmware build", install_command("ziglang"), _try_bench_image)


def _try_robot() -> str:
    from frogkick.robot import load_robot

    robot = load_robot("frog2022")
    return f"{len(robot.limbs)} limbs, {len(robot.actions)} actions, {len(robot.profiles)} measured profiles"


def _try_compiler() -> str:
    from frogkick_codegen.native import NativeLibrary

    NativeLibrary()
    return "the C planner builds and loads"


def _try_chip() -> str:
    from frogkick.pool.chip.emulator import load_hook

    load_hook()
    return "its emulator is there, its cycle counter builds and loads"


def _try_bench_image() -> str:
    from frogkick_codegen.firmware import require_tools
    from frogkick_codegen.toolchain import zig

    require_tools("bench")
    return f"its C sources and {zig('chip').version}"


def check_hardware() -> tuple[Finding, Finding, Finding, Finding]:
    """Check serial ports, debug probes, Bluetooth adapters and cameras."""
    kit = "plug in the kit's USB cable; check that this user may open"
    return (
        _plugged_in("serial port", "talking with a kit", f"{kit} its port", serial_ports()),
        _plugged_in("debug probe", "flashing a kit", f"{kit} it", debug_probes()),
        _plugged_in("Bluetooth adapter", "talking with a robot", "plug one in and switch it on", adapters()),
        _plugged_in("camera", "position fixes", "plug one in; check that this user may open it", cameras()),
    )


def _plugged_in(name: str, needed_for: str, hint: str, found: list[str] | None) -> Finding:
    if found is None:
        return Finding(name, True, "not checked on this system", needed_for)
    return Finding(name, bool(found), ", ".join(found) or "none", needed_for, "" if found else hint)


def stages(
    without_robot: Sequence[Finding], hardware: tuple[Finding, Finding, Finding, Finding]
) -> list[Stage]:
    """Return the three stages of this machine."""
    port, probe, adapter, camera = hardware
    kit = (
        bench_image(),
        package("pyocd", "flashing a development kit"),
        package("serial", "talking with it"),
        port,
        probe,
    )
    robot = (
        package("bleak", "talking with a robot by Bluetooth"),
        package("cv2", "the camera"),
        adapter,
        camera,
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


def serial_ports() -> list[str]:
    """Return the serial ports that this user may open; none without the package that lists them."""
    found = ports() if installed("serial") else []
    return [port for port in found if sys.platform == "win32" or os.access(port, os.R_OK | os.W_OK)]


def debug_probes() -> list[str]:
    """Return the debug probes by number and name; none without the package that uses them."""
    if not installed("pyocd"):
        return []
    from frogkick_codegen.probe import probes

    try:
        return [printable(f"{probe.unique_id} ({probe.description})") for probe in probes()]
    except Exception:  # a driver of a probe may fail on this system
        return []


def adapters(folder: Path = Path("/sys/class/bluetooth")) -> list[str] | None:
    """Return the Bluetooth adapters that Linux lists; None on another system."""
    return _entries(folder, "hci")


def cameras(folder: Path = Path("/dev")) -> list[str] | None:
    """Return the video devices that this user may open; None on a system other than Linux."""
    found = _entries(folder, "video")
    return found and [name for name in found if os.access(folder / name, os.R_OK | os.W_OK)]


def _entries(folder: Path, prefix: str) -> list[str] | None:
    if sys.platform != "linux":
        return None
    return sorted(entry.name for entry in folder.glob(f"{prefix}*")) if folder.is_dir() else []
