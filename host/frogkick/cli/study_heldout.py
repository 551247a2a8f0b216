"""``frogkick study heldout``: each run predicted by what the others show."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from frogkick.cli.common import JsonOption, say_left_out, show, write_picture
from frogkick.files import require_writable
from frogkick.progress import progress_bar

if TYPE_CHECKING:
    from frogkick.study.heldout import HeldOut


def heldout(
    runs: Annotated[list[Path], typer.Argument(help="Three runs or more: logs, or recorded runs (.csv).")],
    robot: Annotated[
        str | None, typer.Option(help="Robot TOML or name that is nominal; default: the runs' own.")
    ] = None,
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
    from frogkick.identification.outcome import robot_of_runs
    from frogkick.identification.swim import read_swim, reliable
    from frogkick.report.heldout_figure import heldout_figure
    from frogkick.robot import load_robot
    from frogkick.study.heldout import held_out, pooled

    require_writable(out)
    swims = [read_swim(run) for run in runs]
    _, left_out = reliable(swims)
    say_left_out(left_out)
    runs = [run for run, swim in zip(runs, swims, strict=True) if not swim.problem]
    described = load_robot(robot or robot_of_runs(swims))
    with progress_bar("runs kept back") as progress:
        rows = held_out(described, runs, effects, workers or os.cpu_count() or 1, progress)
    periods = [row.before.count for row in rows]
    values: dict[str, Any] = {
        name: pooled([getattr(row, field) for row in rows], periods).as_json()
        for name, field in (("before", "before"), ("after", "after"), ("noise_floor", "floor"))
    }
    values |= {"periods": sum(periods), "runs": [_row(row) for row in rows], "left_out": left_out}
    if out is not None:
        write_picture(heldout_figure(rows), out)
        values["figure"] = str(out)
    show(values, json, _text(rows, values))
    if values["after"]["position_rmse_m"] > values["before"]["position_rmse_m"]:
        raise typer.Exit(1)


def _row(row: HeldOut) -> dict[str, Any]:
    return {
        "run": str(row.run),
        "verdict": row.verdict,
        "effects": list(row.effects),
        "before": row.before.as_json(),
        "after": row.after.as_json(),
        "noise_floor": row.floor.as_json(),
        "periods": row.before.count,
    }


def _text(rows: Sequence[HeldOut], values: dict[str, Any]) -> str:
    every = [(row.run.name, _row(row)) for row in rows] + [("all", values)]
    lines = []
    for name, of in every:
        titles = (("nominal", "before"), ("after", "after"), ("noise floor", "noise_floor"))
        errors = ", ".join(f"{title} {_words(of[key])}" for title, key in titles)
        found = f"; {of['verdict']}: {', '.join(of['effects']) or 'no effect'}" if "verdict" in of else ""
        lines.append(f"{name}: {errors} over {of['periods']} periods{found}")
    return "\n".join(lines)


def _words(error: dict[str, float]) -> str:
    return f"{1e3 * error['position_rmse_m']:.2f} mm {math.degrees(error['heading_rmse_rad']):.2f} deg"


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(heldout)
