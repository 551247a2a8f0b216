"""``frogkick doctor``: what is installed, what works, what to install for more."""

from __future__ import annotations

import os
import platform
import shutil
import sys
from dataclasses import asdict

import typer

from frogkick import __version__
from frogkick.cli.common import JsonOption, show
from frogkick.cli.readiness import Finding, bench_image, package, stages, tried
from frogkick.extras import EXTRAS, install_command


def _program(name: str, needed_for: str, package: str) -> Finding:
    found = shutil.which(name)
    return Finding(
        name, found is not None, "installed" if found else "missing", needed_for, "" if found else package
    )


def _hint(finding: Finding) -> str:
    """What to do, where the error itself does not say it."""
    return f" -> {finding.install}" if finding.install and finding.install not in finding.detail else ""


def _compile_here() -> str:
    from frogkick_codegen.native import NativeLibrary

    NativeLibrary()
    return "the C planner builds and loads"


def _load_chip() -> str:
    from frogkick.pool.chip.hook import load_hook

    load_hook()
    return "its emulator is there, its cycle counter builds and loads"


def _robot() -> str:
    from frogkick.robot import load_robot

    robot = load_robot("frog2022")
    return f"{len(robot.limbs)} limbs, {len(robot.actions)} actions, {len(robot.profiles)} measured profiles"


FIRMWARE_EXTRA = install_command("ziglang")


def doctor(json: JsonOption = False) -> None:
    """Look at this machine. Exit 1 if the ring without a robot cannot run here."""
    needed = [
        tried("robot frog2022", "everything", "pip install frogkick", _robot),
        bench_image(),
        tried("C for this computer", "run --robot pool, parity", FIRMWARE_EXTRA, _compile_here),
        tried("virtual chip", "run --robot virtual, demo", FIRMWARE_EXTRA, _load_chip),
    ]
    optional = [
        package("distributed", "--cluster"),
        package("mcap", "export --mcap", *EXTRAS["mcap"]),
        package("pupil_apriltags", "tags of the family tagStandard41h12"),
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
            lines.append(f"  {mark} {finding.name}: {finding.detail} ({finding.needed_for}){_hint(finding)}")
    lines.append("ready for:")
    for stage in stages(needed):
        lines.append(f"  {'ready    ' if stage.ready else 'NOT READY'} {stage.name}: {stage.begin}")
        lines += [
            f"            {finding.name}: {finding.detail}{_hint(finding)}"
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
