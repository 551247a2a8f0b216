"""``frogkick study``: questions about the method, answered with figures."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from frogkick.cli.common import JsonOption, SeedOption, show, write_picture
from frogkick.cli.options import ModelOption, PlannerName, PlannerOption, TablesOption


def convergence(
    robot: Annotated[str, typer.Argument(help="TOML file or built-in name.")] = "frog2022",
    out: Annotated[Path | None, typer.Option(help="Picture to write (PNG).")] = None,
    every: Annotated[int, typer.Option(min=1, max=100, help="Take every so many-th gait.")] = 1,
    json: JsonOption = False,
) -> None:
    """Error of the rod simulation against its time step. Exit 1 if the default step errs too much."""
    from frogkick_studies.table_studies import study_convergence

    found = study_convergence(robot, every=every, progress=True)
    if out is not None:
        write_picture(found.plot(), out)
    show(found.as_json(), json)
    if not found.passed:
        raise typer.Exit(1)


def chip(
    tables: TablesOption = None,
    model: ModelOption = None,
    states: Annotated[int, typer.Option(min=12, max=1_000_000, help="Decisions at each depth.")] = 300,
    planner: PlannerOption = PlannerName.robot,
    workers: Annotated[int, typer.Option(min=0, max=256, help="Processes; 0: one for each core.")] = 1,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """How long the chip plans: cycles of the flashed image over many states. Exit 1 over a limit.

    Of very many states the dearest are run on the virtual chip, which a model of the planner's blocks finds
    among all of them: "run" is how many, "model_error" its largest error, "unrun_ms" its bound of the rest.
    "band_ms": the worst decision by the least and by the most that the manuals allow an instruction.
    """
    from frogkick_studies.table_studies import study_chip

    found = study_chip(
        tables,
        robot=model,
        states=states,
        planner=planner.value,
        workers=workers or None,
        seed=seed,
        progress=True,
    )
    show(found.as_json(), json)
    if not found.passed:
        raise typer.Exit(1)


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.command()(convergence)
    app.command()(chip)
