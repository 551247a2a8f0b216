"""``frogkick study heldout``: each run predicted by what the others show."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from frogkick.cli.common import JsonOption, say_left_out, show, write_picture
from frogkick.cli.options import NominalOption
from frogkick.core.files import require_writable


def heldout(
    runs: Annotated[list[Path], typer.Argument(help="Three runs or more: logs, or recorded runs (.csv).")],
    robot: NominalOption = None,
    effects: Annotated[
        Path | None, typer.Option(help="Python file with effects of your own, tried as well.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Picture to write (PNG).")] = None,
    workers: Annotated[int, typer.Option(min=0, max=256, help="Processes; 0: one for each core.")] = 0,
    json: JsonOption = False,
) -> None:
    """Keep each run back in turn, learn from all others what the model lacks, and predict it with that.

    How far identification may be trusted on this robot: every period is predicted once, by effects that were
    found without it. Fits of many effects start from nominal values, never from a built-in robot that was
    measured before. Exit 1 where what was found predicts worse than the nominal model.
    """
    from frogkick_studies.identification_studies import study_held_out

    require_writable(out)
    found = study_held_out(
        runs, robot=robot, effects=effects, workers=workers or None, left_out=say_left_out, progress=True
    )
    values = found.as_json()
    if out is not None:
        write_picture(found.plot(), out)
        values["figure"] = str(out)
    show(values, json, _text(values))
    if found.worse:
        raise typer.Exit(1)


def _text(values: dict[str, Any]) -> str:
    from frogkick.core.poses import PredictionError

    lines = []
    for name, of in [*((Path(row["run"]).name, row) for row in values["runs"]), ("all", values)]:
        titles = (("nominal", "before"), ("after", "after"), ("noise floor", "noise_floor"))
        errors = ", ".join(f"{title} {PredictionError(**of[key])}" for title, key in titles)
        found = f"; {of['verdict']}: {', '.join(of['effects']) or 'no effect'}" if "verdict" in of else ""
        lines.append(f"{name}: {errors} over {of['periods']} periods{found}")
    return "\n".join(lines)


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(heldout)
