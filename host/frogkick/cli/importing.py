"""``frogkick import``: the paper's recorded runs into our logs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from frogkick.cli.common import JsonOption, progress_bar, require_writable, show
from frogkick.loop.recorded import import_recorded


def import_(
    data_dir: Annotated[Path, typer.Argument(help="Folder with line1.csv, linep1.csv and the like.")],
    out: Annotated[Path, typer.Option(help="Folder for the logs.")],
    json: JsonOption = False,
) -> None:
    """Read recorded runs, repair or mark what is wrong in them, write logs. Invents nothing."""
    require_writable(out, folder=True)
    with progress_bar("import") as progress:
        runs = import_recorded(data_dir, out, progress)
    columns = list(runs[0]) if runs else []
    lines = ["  ".join(columns)] + [
        "  ".join(f"{row[c]:.4g}" if isinstance(row[c], float) else str(row[c]) for c in columns)
        for row in runs
    ]
    show({"runs": runs, "out": str(out)}, json, "\n".join(lines))


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command(name="import")(import_)
