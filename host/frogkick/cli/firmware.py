"""``frogkick firmware``: build, measure, flash and test the robot's image."""

from __future__ import annotations

import enum
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any

import typer

import frogkick as fk
from frogkick.cli.common import JsonOption, show
from frogkick.cli.options import TablesOption
from frogkick.errors import InputError
from frogkick.extras import require
from frogkick.files import existing_file, require_writable
from frogkick.progress import progress_bar

app = typer.Typer(help="Build, measure, flash and test the robot's image.", no_args_is_help=True)


class Target(enum.StrEnum):
    """What the firmware is built for."""

    bench = "bench"
    native = "native"


RobotOption = Annotated[str | None, typer.Option(help="TOML or name; by default the table's own robot.")]


@app.command()
def build(
    tables: Annotated[Path, typer.Option(help="Table image (.fkt).")],
    target: Annotated[Target, typer.Option(help="bench: nRF52832; native: this computer.")] = Target.bench,
    robot: RobotOption = None,
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("firmware-build"),
    json: JsonOption = False,
) -> None:
    """Build the firmware around a table image; stack_bytes is what the image reserves."""
    require_writable(out, folder=True)
    built = fk.build_firmware(fk.load_table(tables, robot), target.value, out)
    show(built.as_json(), json)


@app.command()
def size(
    tables: TablesOption = None,
    robot: RobotOption = None,
    json: JsonOption = False,
) -> None:
    """Flash, RAM and stack of the bench image; the stack as seen on the virtual chip, and its bound."""
    from frogkick.front.places import built_firmware, robot_of_table, table_image
    from frogkick.loop.chip_check import check_on_chip
    from frogkick.planner.image import read_image
    from frogkick_codegen.firmware import FLASH_BYTES, RAM_BYTES, require_tools

    require_tools("bench")
    image = table_image(tables, robot)
    described = robot_of_table(image, robot)
    with built_firmware("bench", image, described) as built:
        report = check_on_chip(built.image, read_image(image), described)
    values: dict[str, Any] = {
        "flash_bytes": built.flash_bytes,
        "flash_of_chip": round(built.flash_bytes / FLASH_BYTES, 4),
        "ram_bytes": built.ram_bytes,
        "ram_of_chip": round(built.ram_bytes / RAM_BYTES, 4),
        "stack_bytes": report.stack_bytes,
        "stack_bound_bytes": report.stack_bound_bytes,
        "stack_bound_chain": list(report.stack_chain),
        "stack_reserved_bytes": built.stack_bytes,
    }
    show(values, json)


@app.command()
def flash(
    image: Annotated[
        Path | None,
        typer.Option(help="Intel HEX (bench.hex of firmware build); default: built from --tables."),
    ] = None,
    tables: TablesOption = None,
    robot: RobotOption = None,
    probe: Annotated[
        str | None, typer.Option(help="Number of the debug probe, where there are several.")
    ] = None,
    json: JsonOption = False,
) -> None:
    """Write the bench image into a development kit, through its debug probe."""
    from frogkick.front.places import built_firmware, robot_of_table, table_image
    from frogkick_codegen.firmware import require_tools
    from frogkick_codegen.probe import check_image
    from frogkick_codegen.probe import flash as flash_image

    if image is not None and tables is not None:
        raise InputError("give --image or --tables: an image has its table in it")
    require("flashing", "pyocd")
    if image is None:
        require_tools("bench")
    with ExitStack() as stack:
        if image is None:
            table = table_image(tables, robot)
            built = stack.enter_context(built_firmware("bench", table, robot_of_table(table, robot)))
            image = built.files["hex"]
        length = check_image(existing_file(image, "image"))
        progress = stack.enter_context(progress_bar("flash"))
        name = flash_image(image, probe, progress)
    show({"probe": name, "bytes": length}, json)


@app.command("test")
def try_out(
    tables: TablesOption = None,
    robot: RobotOption = None,
    json: JsonOption = False,
) -> None:
    """Boot the image on the virtual chip and go through every command, stroke and limit."""
    from frogkick.front.places import built_firmware, robot_of_table, table_image
    from frogkick.loop.chip_check import check_on_chip
    from frogkick.planner.image import read_image
    from frogkick_codegen.firmware import require_tools

    require_tools("bench")
    image = table_image(tables, robot)
    described = robot_of_table(image, robot)
    with built_firmware("bench", image, described) as built, progress_bar("virtual chip") as progress:
        report = check_on_chip(built.image, read_image(image), described, progress)
    show(
        {
            "passed": report.passed,
            "checks": {name: "ok" if ok else "FAILED" for name, ok in report.checks.items()},
            "plan_ms": report.plan_ms,
            "plan_cycles": report.plan_cycles,
            "flash_bytes": built.flash_bytes,
            "ram_bytes": built.ram_bytes,
            "stack_bytes": report.stack_bytes,
            "stack_bound_bytes": report.stack_bound_bytes,
        },
        json,
    )
    if not report.passed:
        raise typer.Exit(1)
