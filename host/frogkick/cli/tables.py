"""``frogkick tables``: makes the table image that the robot carries from a library."""

from __future__ import annotations

import enum
from pathlib import Path
from typing import Annotated

import typer

import frogkick as fk
from frogkick.cli.common import JsonOption, SeedOption, WholeLines, show
from frogkick.cli.library import Sampling
from frogkick.core.files import require_writable

app = typer.Typer(cls=WholeLines, help="Make the robot's table image from a library.", no_args_is_help=True)


class Kind(enum.StrEnum):
    """Kinds of table."""

    nearest = "nearest"
    affine = "affine"


@app.command()
def build(
    library: Annotated[Path, typer.Argument(help="HDF5 file that 'library build' wrote.")],
    kind: Annotated[
        Kind | None,
        typer.Option(
            help="nearest: the paper's table; affine: fewer states, with local linear corrections and limb "
            "history. Default: the kind with the smaller error: affine, unless the library has too few "
            "states.",
            show_default=False,
        ),
    ] = None,
    budget_kib: Annotated[
        float | None,
        typer.Option(
            min=0.5,
            max=16384,
            help="Largest size of the image, KiB; states are placed where the error is largest. Default: "
            "64 for affine, no limit for nearest.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[Path, typer.Option(help="Table image to write (.fkt).")] = Path("tables.fkt"),
    test_states: Annotated[
        int, typer.Option(min=4, max=10000, help="Number of unseen states to measure the error on.")
    ] = 64,
    seed: SeedOption = 1,
    json: JsonOption = False,
) -> None:
    """Make a table image, and measure its error on states that are not in it."""
    content = fk.load_library(library)
    require_writable(out)
    table = fk.fit_table(content, kind.value if kind else None, budget_kib, progress=True)
    error = table.error(test_states, seed, content.sampling, progress=True)
    table.save(out)
    show({**table.facts(), "error": error, "sampling": content.sampling, "out": str(out)}, json)


@app.command()
def info(
    tables: Annotated[Path, typer.Argument(help="Table image (.fkt).")],
    robot: Annotated[
        str | None,
        typer.Option("--robot", "--model", help="Refuse a table that was not made for this robot."),
    ] = None,
    test_states: Annotated[
        int,
        typer.Option(
            min=0, max=10000, help="Number of unseen states to measure the error on; 0: do not measure it."
        ),
    ] = 64,
    sampling: Annotated[
        Sampling, typer.Option(help="How the unseen states are drawn, as for 'library build'.")
    ] = Sampling.box,
    seed: SeedOption = 1,
    json: JsonOption = False,
) -> None:
    """Check a table image, show what it holds, and measure its error on unseen states."""
    from frogkick.front.tables import read_facts

    facts = read_facts(tables)
    error = None
    try:
        table = fk.load_table(tables, robot)
    except fk.InputError:
        if robot is not None:
            raise  # otherwise no built-in robot fits, and only the image's own facts are shown
    else:
        if test_states:
            error = table.error(test_states, seed, sampling.value, progress=True)
    show({**facts, "error": error, "sampling": sampling.value}, json)
