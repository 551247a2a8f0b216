"""Options of tables and planners that several commands share."""

from __future__ import annotations

import enum
from pathlib import Path
from typing import Annotated

import typer


class PlannerName(enum.StrEnum):
    """The planner whose weights and depth are used."""

    robot = "robot"
    paper = "paper"


TablesOption = Annotated[
    Path | None,
    typer.Option(help="Table image (.fkt); default: one that is made from a small library on first use."),
]
PlannerOption = Annotated[
    PlannerName,
    typer.Option(
        help="Weights and depth of the planner. robot: those of its TOML file; paper: 500, 50, 300, 0.3 and "
        "depth 1."
    ),
]
DepthOption = Annotated[
    int | None, typer.Option(min=1, max=4, help="Search depth in strokes; default: the planner's own.")
]
KeyOption = Annotated[
    Path | None,
    typer.Option(
        help="Key file of a real robot that has an owner; default: the user's own, see 'frogkick own'."
    ),
]
RobotFileOption = Annotated[str, typer.Option("--robot", "--model", help="TOML file or built-in name.")]
ModelOption = Annotated[
    str | None,
    typer.Option("--model", "--robot", help="Robot TOML file or built-in name; default: the table's robot."),
]
NominalOption = Annotated[
    str | None,
    typer.Option(
        "--robot",
        "--model",
        help="Nominal robot, as TOML file or built-in name; default: the robot of the runs.",
    ),
]
