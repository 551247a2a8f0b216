"""``frogkick firmware``: build, measure, flash and test the robot's firmware."""

from __future__ import annotations

import enum
from pathlib import Path
from typing import Annotated

import typer

import frogkick as fk
from frogkick.cli.common import JsonOption, ModelOption, TablesOption, WholeLines, show
from frogkick.core.files import require_writable

app = typer.Typer(
    cls=WholeLines, help="Build, measure, flash and test the robot's firmware.", no_args_is_help=True
)


class Target(enum.StrEnum):
    """The machine that the firmware is built for."""

    bench = "bench"
    native = "native"


@app.command()
def build(
    tables: Annotated[Path, typer.Option(help="Table image (.fkt).")],
    target: Annotated[Target, typer.Option(help="bench: nRF52832; native: this computer.")] = Target.bench,
    robot: ModelOption = None,
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("firmware-build"),
    json: JsonOption = False,
) -> None:
    """Build the firmware around a table image. The value stack_bytes is the stack that the image reserves."""
    require_writable(out, folder=True)
    built = fk.build_firmware(fk.load_table(tables, robot), target.value, out)
    show(built.as_json(), json)


@app.command()
def size(
    tables: TablesOption = None,
    robot: ModelOption = None,
    json: JsonOption = False,
) -> None:
    """Measure flash, RAM and stack of the bench image.

    The stack is measured on the virtual chip; its proved bound stands beside it.
    """
    from frogkick.front.building import try_firmware

    show(try_firmware(tables, robot).sizes(), json)


@app.command()
def flash(
    image: Annotated[
        Path | None,
        typer.Option(help="Intel HEX file (bench.hex of 'firmware build'); default: built from --tables."),
    ] = None,
    tables: TablesOption = None,
    robot: ModelOption = None,
    probe: Annotated[
        str | None, typer.Option(help="Serial number of the debug probe, if several are plugged in.")
    ] = None,
    json: JsonOption = False,
) -> None:
    """Flash the bench image into a development kit through its debug probe."""
    from frogkick.front.building import flash_firmware

    done = flash_firmware(image, table=tables, robot=robot, probe=probe, progress=True)
    show({"probe": done.probe, "bytes": done.bytes}, json)


@app.command("test")
def try_out(
    tables: TablesOption = None,
    robot: ModelOption = None,
    json: JsonOption = False,
) -> None:
    """Boot the image on the virtual chip and test every command, stroke and limit."""
    from frogkick.front.building import try_firmware

    trial = try_firmware(tables, robot, progress=True)
    show(trial.as_json(), json)
    if not trial.passed:
        raise typer.Exit(1)
