"""``frogkick study``: questions about the method, answered with figures."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from frogkick.cli.common import JsonOption, progress_bar, show
from frogkick.der import STEP_S
from frogkick.files import atomic_path
from frogkick.report.convergence_figure import convergence_figure
from frogkick.robot import load_robot
from frogkick.study.convergence import ERROR_LIMIT
from frogkick.study.convergence import convergence as measure

app = typer.Typer(help="Questions about the method, answered with figures.", no_args_is_help=True)


@app.callback()
def _group() -> None:
    """Questions about the method, answered with figures."""


@app.command()
def convergence(
    robot: Annotated[str, typer.Argument(help="TOML file or built-in name.")] = "frog2022",
    out: Annotated[Path | None, typer.Option(help="Picture to write (PNG).")] = None,
    json: JsonOption = False,
) -> None:
    """Error of the rod simulation against its time step. Exit 1 if the default step errs too much."""
    described = load_robot(robot)
    with progress_bar("convergence") as progress:
        curves = measure(described, progress)
    if out is not None:
        with atomic_path(out) as temporary:
            convergence_figure(curves, STEP_S).savefig(temporary, format="png", dpi=120)
    values = {
        "default_step_s": STEP_S,
        "limit": ERROR_LIMIT,
        "order": {curve.name: round(curve.order, 3) for curve in curves},
        "error_at_default": {curve.name: curve.at_default for curve in curves},
        "worst": {
            curve.name: dict(zip(curve.step_s.tolist(), curve.worst.tolist(), strict=True))
            for curve in curves
        },
        "rms": {
            curve.name: dict(zip(curve.step_s.tolist(), curve.error.tolist(), strict=True))
            for curve in curves
        },
    }
    show(values, json)
    if any(curve.at_default > ERROR_LIMIT for curve in curves):
        raise typer.Exit(1)
