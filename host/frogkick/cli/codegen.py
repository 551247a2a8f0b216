"""``frogkick codegen``: tables to C that builds alone."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from frogkick.cli.common import JsonOption, progress_bar, require_writable, show
from frogkick.planner.image import read_image
from frogkick.study.emitted import measure
from frogkick_codegen.emit import emit


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
    read_image(tables)
    require_writable(out, folder=True)
    figures = None
    if measured:
        with progress_bar("measuring") as progress:
            figures = measure(tables, progress=progress)
    files = emit(tables, out, f"frogkick codegen {tables.name} --out {out.name}", figures=figures)
    show(
        {"out": str(out), "files": files}, json, "\n".join(f"{files[name]}  {name}" for name in sorted(files))
    )


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(codegen)
