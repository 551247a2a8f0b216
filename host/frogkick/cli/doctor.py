"""``frogkick doctor``: what is installed, what works, what to install for more."""

from __future__ import annotations

import os
import platform
import shutil
import sys
from collections.abc import Callable
from dataclasses import asdict

import typer

from frogkick import __version__
from frogkick.cli.common import JsonOption, show
from frogkick.cli.readiness import Finding, package, stages
from frogkick.errors import FrogkickError


def _program(name: str, needed_for: str, package: str) -> Finding:
    found = shutil.which(name)
    return Finding(
        name, found is not None, "installed" if found else "missing", needed_for, "" if found else package
    )


def _tried(name: str, needed_for: str, install: str, attempt: Callable[[], str]) -> Finding:
    try:
        return Finding(name, True, attempt(), needed_for)
    except FrogkickError as error:
        return Finding(name, False, str(error), needed_for, install)


def _compile_for_chip() -> str:
    from frogkick_codegen.toolchain import zig

    return zig("chip").version


def _compile_here() -> str:
    from frogkick_codegen.native import NativeLibrary

    NativeLibrary()
    return "the C planner builds and loads"


def _robot() -> str:
    from frogkick.robot import load_robot

    robot = load_robot("frog2022")
    return f"{len(robot.limbs)} limbs, {len(robot.actions)} actions, {len(robot.profiles)} measured profiles"


def doctor(json: JsonOption = False) -> None:
    """Look at this machine. Exit 1 if the ring without a robot cannot run here."""
    needed = [
        _tried("robot frog2022", "everything", "make venv", _robot),
        _tried("C compiler (zig wheel)", "firmware", "pip install 'frogkick[firmware]'", _compile_for_chip),
        _tried(
            "C compiler for this computer",
            "native core, parity",
            "pip install 'frogkick[firmware]'",
            _compile_here,
        ),
        package("unicorn", "virtual chip", "firmware"),
        package("capstone", "virtual chip", "firmware"),
        package("elftools", "firmware", "firmware"),
        package("intelhex", "firmware", "firmware"),
    ]
    optional = [
        package("distributed", "--cluster", "cluster"),
        package("mcap_protobuf", "export --mcap", "mcap"),
        package("pupil_apriltags", "tags of the family tagStandard41h12", "apriltag"),
        _program("arm-none-eabi-gcc", "extra checks", "apt install gcc-arm-none-eabi"),
        _program("qemu-system-arm", "extra checks", "apt install qemu-system-arm"),
        _program("cppcheck", "extra checks", "apt install cppcheck"),
    ]
    ready = all(finding.works for finding in needed)
    values = {
        "frogkick": __version__,
        "python": platform.python_version(),
        "cores": os.cpu_count(),
        "ready_without_robot": ready,
        "needed": [asdict(finding) for finding in needed],
        "optional": [asdict(finding) for finding in optional],
        "stages": [stage.as_json() for stage in stages(needed)],
    }
    lines = [f"frogkick {__version__}, Python {platform.python_version()}, {os.cpu_count()} cores"]
    for title, findings in (("needed", needed), ("for more", optional)):
        lines.append(f"{title}:")
        for finding in findings:
            mark = "ok     " if finding.works else "MISSING"
            hint = f" -> {finding.install}" if finding.install else ""
            lines.append(f"  {mark} {finding.name}: {finding.detail} ({finding.needed_for}){hint}")
    lines.append("ready for:")
    for stage in stages(needed):
        lines.append(f"  {'ready    ' if stage.ready else 'NOT READY'} {stage.name}: {stage.begin}")
        lines += [
            f"            {finding.name}: {finding.detail} -> {finding.install}"
            for finding in stage.findings
            if not finding.works
        ]
    show(values, json, "\n".join(lines))
    if not ready:
        print("frogkick: doctor found something missing", file=sys.stderr)
        raise typer.Exit(1)


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(doctor)
