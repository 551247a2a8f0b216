"""``frogkick codegen``: a table image as C code that builds on its own."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import frogkick as fk
from frogkick.cli.common import JsonOption, show
from frogkick.core.files import require_writable


def codegen(
    tables: Annotated[Path, typer.Argument(help="Table image (.fkt).")],
    out: Annotated[Path, typer.Option(help="Folder to write.")],
    measured: Annotated[
        bool,
        typer.Option(
            "--measure/--no-measure",
            help="Measure sizes and times on the virtual chip and write them into the README.",
        ),
    ] = True,
    json: JsonOption = False,
) -> None:
    """Generate C99 from a table and the planner, with a README of their sizes and times on the chip."""
    require_writable(out, folder=True)
    files = fk.emit_c(tables, out, measure=measured, progress=True)
    show(
        {"out": str(out), "files": files}, json, "\n".join(f"{files[name]}  {name}" for name in sorted(files))
    )
