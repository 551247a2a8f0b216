"""``frogkick codegen``: tables to C that builds alone."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import frogkick as fk
from frogkick.cli.common import JsonOption, show
from frogkick.core.files import require_writable


def codegen(
    tables: Annotated[Path, typer.Argument(help="Table image (.fkt).")],
    out: Annotated[Path, typer.Option(help="Directory to write.")],
    measured: Annotated[
        bool,
        typer.Option("--measure/--no-measure", help="Sizes and times on the virtual chip into the README."),
    ] = True,
    json: JsonOption = False,
) -> None:
    """Emit a table and the planner as C99, with a README of what they cost on the chip."""
    require_writable(out, folder=True)
    files = fk.emit_c(tables, out, measure=measured, progress=True)
    show(
        {"out": str(out), "files": files}, json, "\n".join(f"{files[name]}  {name}" for name in sorted(files))
    )


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(codegen)
