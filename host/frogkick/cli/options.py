"""Options that several commands share, of tables and planners."""

from __future__ import annotations

import enum
from pathlib import Path
from typing import Annotated

import typer


class PlannerName(enum.StrEnum):
    """Whose weights and depth."""

    robot = "robot"
    paper = "paper"


TablesOption = Annotated[
    Path | None,
    typer.Option(help="Table image (.fkt); default: one made from a small library, on first use."),
]
PlannerOption = Annotated[
    PlannerName,
    typer.Option(help="robot: its TOML's weights and depth; paper: 500, 50, 300, 0.3 and depth 1."),
]
DepthOption = Annotated[
    int | None, typer.Option(min=1, max=4, help="Levels to look ahead; default: the planner's own.")
]
KeyOption = Annotated[
    Path | None,
    typer.Option(help="Owner's key of a real robot that has one; default: the user's, see 'frogkick own'."),
]
RobotFileOption = Annotated[str, typer.Option("--robot", "--model", help="TOML file or built-in name.")]
ModelOption = Annotated[
    str | None, typer.Option("--model", "--robot", help="Robot TOML or name; default: the table's robot.")
]
NominalOption = Annotated[
    str | None,
    typer.Option("--robot", "--model", help="Robot TOML or name that is nominal; default: the runs' own."),
]
