"""``frogkick tables``: make of a library the image that the robot carries."""

from __future__ import annotations

import enum
from pathlib import Path
from typing import Annotated

import typer

import frogkick as fk
from frogkick.cli.common import JsonOption, SeedOption, WholeLines, show
from frogkick.cli.library import Sampling
from frogkick.core.files import require_writable

app = typer.Typer(cls=WholeLines, help="Make of a library the robot's table image.", no_args_is_help=True)


class Kind(enum.StrEnum):
    """Kinds of table."""

    nearest = "nearest"
    affine = "affine"


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
        str | None, typer.Option("--robot", "--model", help="Refuse a table that is not for this robot.")
    ] = None,
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
    from frogkick.front.tables import read_facts

    facts = read_facts(tables)
    error = None
    try:
        table = fk.load_table(tables, robot)
    except fk.InputError:
        if robot is not None:
            raise  # else no built-in robot fits, and the image alone tells what it can
    else:
        if test_states:
            error = table.error(test_states, seed, sampling.value, progress=True)
    show({**facts, "error": error, "sampling": sampling.value}, json)
