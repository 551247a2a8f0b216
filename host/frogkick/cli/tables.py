"""``frogkick tables``: make of a library the image that the robot carries."""

from __future__ import annotations

import enum
from pathlib import Path
from typing import Annotated, Any

import typer

from frogkick.cli.common import JsonOption, SeedOption, progress_bar, require_writable, show
from frogkick.cli.library import Sampling
from frogkick.cli.places import robot_of_table
from frogkick.errors import InputError
from frogkick.files import write_bytes
from frogkick.library import fit_table, quantise, read_library, table_error
from frogkick.planner.image import Tables, open_image, read_image
from frogkick.robot import Robot

app = typer.Typer(help="Make of a library the robot's table image.", no_args_is_help=True)

_KIB = 1024


class Kind(enum.StrEnum):
    """Kinds of table."""

    nearest = "nearest"
    affine = "affine"


def _facts(tables: Tables) -> dict[str, Any]:
    return {
        "bytes": len(tables.image),
        "states": len(tables.states),
        "actions": len(tables.actions),
        "kind": tables.kind,
        "robot": tables.robot_id,
        "period_s": tables.period_us * 1e-6,
        "pulse_s": tables.pulse_us * 1e-6,
        "crc32": f"{tables.crc32:08x}",
        "provenance": tables.provenance.hex(),
        "limb_use": {"decay": tables.use_decay / 2**15, "gain": tables.use_gain / 2**15},
    }


@app.command()
def build(
    library: Annotated[Path, typer.Argument(help="HDF5 file of 'library build'.")],
    kind: Annotated[
        Kind | None,
        typer.Option(
            help="nearest: the paper's table; affine: fewer states, local linear correction, limb history. "
            "Default: nearest with all states; with --budget-kib the one that errs less.",
            show_default=False,
        ),
    ] = None,
    budget_kib: Annotated[
        float | None,
        typer.Option(
            min=0.5,
            max=16384,
            help="Most KiB of the image; states are chosen where the error is. Default: affine 64, nearest "
            "as many as it takes.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[Path, typer.Option(help="Table image to write (.fkt).")] = Path("tables.fkt"),
    test_states: Annotated[
        int, typer.Option(min=4, max=10000, help="Unseen states to measure the error on.")
    ] = 64,
    seed: SeedOption = 1,
    json: JsonOption = False,
) -> None:
    """Make a table image, and measure its error on states that are not in it."""
    content = read_library(library)
    require_writable(out)
    if budget_kib is None and kind in (None, Kind.nearest):
        image = quantise(content)
    else:
        budget = None if budget_kib is None else int(budget_kib * _KIB)
        with progress_bar("tables tried") as progress:
            image = fit_table(content, kind.value if kind else None, budget, progress).image
    tables = open_image(image)
    with progress_bar("unseen states") as progress:
        error = table_error(tables, content.robot(), test_states, seed, content.sampling, progress)
    write_bytes(out, image)
    show({**_facts(tables), "error": error, "sampling": content.sampling, "out": str(out)}, json)


@app.command()
def info(
    tables: Annotated[Path, typer.Argument(help="Table image (.fkt).")],
    robot: Annotated[str | None, typer.Option(help="Refuse a table that is not for this robot.")] = None,
    test_states: Annotated[
        int, typer.Option(min=0, max=10000, help="Unseen states to measure the error on; 0: do not.")
    ] = 64,
    sampling: Annotated[
        Sampling, typer.Option(help="How the unseen states are drawn, as for 'library build'.")
    ] = Sampling.box,
    seed: SeedOption = 1,
    json: JsonOption = False,
) -> None:
    """Say what a table image holds, after checking all of it, and how far it errs on unseen states."""
    opened = read_image(tables)
    described = _robot(opened, tables, robot)
    error = None
    if test_states and described is not None:
        with progress_bar("unseen states") as progress:
            error = table_error(opened, described, test_states, seed, sampling.value, progress)
    show({**_facts(opened), "error": error, "sampling": sampling.value}, json)


def _robot(opened: Tables, tables: Path, robot: str | None) -> Robot | None:
    """The table's robot; None where none is named and no built-in one fits."""
    if robot is not None:
        return robot_of_table(tables, robot)
    try:
        return robot_of_table(tables, None)
    except InputError:
        return None
