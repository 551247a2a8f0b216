"""``frogkick import``: the paper's recorded runs as logs of frogkick."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from frogkick.cli.common import JsonOption, say, short, show


def import_(
    data_dir: Annotated[
        Path,
        typer.Argument(help="Folder of recorded runs and their paths, such as line1.csv and linep1.csv."),
    ],
    out: Annotated[Path, typer.Option(help="Folder for the logs.")],
    json: JsonOption = False,
) -> None:
    """Read recorded runs, repair or mark their faults, and write logs. No data is invented."""
    from frogkick.front.running import import_runs

    runs = import_runs(data_dir, out, progress=True)
    columns = list(dict.fromkeys(c for row in runs for c in row if c not in ("clock_notes", "skipped")))
    lines = ["  ".join(columns)] + ["  ".join(short(row.get(c)) for c in columns) for row in runs]
    lines += [f"{row['run']}: skipped, {row['skipped']}" for row in runs if "skipped" in row]
    for row in runs:
        for note in row.get("clock_notes", ()):
            say(f"{row['run']}: {note}")
    show({"runs": runs, "out": str(out)}, json, "\n".join(lines))


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command(name="import")(import_)
