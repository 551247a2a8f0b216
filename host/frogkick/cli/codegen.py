"""``frogkick codegen``: tables to C that builds alone."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from frogkick.cli.common import JsonOption, show
from frogkick.planner.image import read_image
from frogkick_codegen.emit import emit


def codegen(
    tables: Annotated[Path, typer.Argument(help="Table image (.fkt).")],
    out: Annotated[Path, typer.Option(help="Directory to write.")],
    json: JsonOption = False,
) -> None:
    """Emit a table and the planner as C99."""
    read_image(tables)
    files = emit(tables, out, f"frogkick codegen {tables.name} --out {out.name}")
    show(
        {"out": str(out), "files": files}, json, "\n".join(f"{files[name]}  {name}" for name in sorted(files))
    )


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(codegen)
