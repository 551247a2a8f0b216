"""Options and printing that the commands share."""

from __future__ import annotations

import enum
import inspect
import json
import math
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple, get_args

import typer
from rich.console import Console
from typer.core import TyperGroup

from frogkick.core.chunks import check_cluster
from frogkick.core.errors import InputError

PlanWhere = enum.StrEnum("PlanWhere", ["onboard", "host", "both"])
PlannerName = enum.StrEnum("PlannerName", ["robot", "paper"])
Sampling = enum.StrEnum("Sampling", ["box", "visited", "planned"])


class Within(NamedTuple):
    """The range of an option's numbers."""

    min: float
    max: float | None = None


# A type, a text and perhaps a range are the option "--name" with that help, see ``with_options``.
JsonOption = Annotated[bool, "Print one JSON object and nothing else."]
SeedOption = Annotated[int, "Seed of all random numbers; the same seed gives the same result.", Within(0)]
ClusterOption = Annotated[
    str | None,
    typer.Option(
        "--cluster",
        metavar="ADDRESS",
        help="Compute on this Dask scheduler, such as tcp://host:8786, instead of on this computer.",
    ),
]

TablesOption = Annotated[
    Path | None, "Table image (.fkt); default: one that is made from a small library on first use."
]
PlannerOption = Annotated[
    PlannerName,
    "Weights and depth of the planner. robot: those of its TOML file; paper: 500, 50, 300, 0.3 and depth 1.",
]
DepthOption = Annotated[int | None, "Search depth in strokes; default: the planner's own.", Within(1, 4)]
KeyOption = Annotated[
    Path | None, "Key file of a real robot that has an owner; default: the user's own, see 'frogkick own'."
]
TargetOption = Annotated[
    str, typer.Option("--robot", metavar="TARGET", help="ble:NAME, ble:ADDRESS or serial:PORT[:BAUD].")
]
WorkersOption = Annotated[int, "Number of processes; 0: one for each core.", Within(0, 256)]
RobotArgument = Annotated[str, typer.Argument(help="TOML file or built-in name.")]
RobotFileOption = Annotated[str, typer.Option("--robot", "--model", help="TOML file or built-in name.")]
ModelOption = Annotated[
    str | None,
    typer.Option("--robot", "--model", help="Robot TOML file or built-in name; default: the table's robot."),
]
LawsOption = Annotated[
    bool,
    "If the catalogue leaves more than noise, search formulas as well: springs, sloshing, limbs that break "
    "or depend on the heading. With --no-laws the search ends with the catalogue.",
]
NominalOption = Annotated[
    str | None,
    typer.Option(
        "--robot",
        "--model",
        help="Nominal robot, as TOML file or built-in name; default: the robot of the runs.",
    ),
]

UnseenOption = Annotated[Sampling, "How the unseen states are drawn, as for 'library build'."]
WorldOption = Annotated[Path | None, "TOML file of effects that act in the pool but are in no model."]

stderr = Console(stderr=True)


class WholeLines(TyperGroup):
    """A group whose help shows the whole first sentence of each command."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write names and sentences."""
        with formatter.section("Commands"):
            formatter.write_dl(
                [(name, each.get_short_help_str(limit=200)) for name, each in self.commands.items()]
            )


def with_options(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command whose arguments ``Annotated[type, "help", Within(...)]`` are options with that help.

    A switch that is off by default has no ``--no-name``.
    """
    signature = inspect.signature(command, eval_str=True)
    parameters = []
    for parameter in signature.parameters.values():
        annotation = parameter.annotation
        kind, *notes = get_args(annotation) or (annotation,)
        if notes and isinstance(notes[0], str):
            named = [f"--{parameter.name.replace('_', '-')}"] if parameter.default is False else []
            limits = notes[1]._asdict() if len(notes) > 1 else {}
            annotation = Annotated[kind, typer.Option(*named, help=notes[0], **limits)]
        parameters.append(parameter.replace(annotation=annotation))
    command.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    return command


def group(text: str, commands: Mapping[str, Callable[..., None]]) -> typer.Typer:
    """Return a group of commands by their names; ``text`` is its help."""
    made = typer.Typer(cls=WholeLines, help=text, no_args_is_help=True)
    for name, command in commands.items():
        made.command(name)(with_options(command))
    return made


def _plain(value: Any) -> Any:
    """Return the value as JSON can hold it: NaN and infinity become null."""
    if hasattr(value, "tolist"):  # of numpy
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def json_text(values: Mapping[str, Any]) -> str:
    """One JSON object as text."""
    return json.dumps(_plain(values), allow_nan=False)


def short(value: Any) -> str:
    """Return a value as text for people: four digits, yes or no, and "-" for an unknown value."""
    value = _plain(value)
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list):
        return ", ".join(map(short, value)) or "-"
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {short(each)}" for key, each in value.items()) or "-"
    return str(value)


def text_lines(values: Mapping[str, Any], indent: str = "") -> list[str]:
    """Return values as lines for people: a table below its name, a row of a list on one line."""
    lines = []
    for key, value in values.items():
        rows = isinstance(value, list | tuple) and any(isinstance(each, Mapping) for each in value)
        if isinstance(value, Mapping) and value:
            lines += [f"{indent}{key}:", *text_lines(value, f"{indent}  ")]
        elif rows:
            lines += [f"{indent}{key}:", *(f"{indent}  {short(each)}" for each in value)]
        else:
            lines.append(f"{indent}{key}: {short(value)}")
    return lines


def say(text: str) -> None:
    """Print one line to stderr, so that stdout can be piped."""
    stderr.print(f"frogkick: {text}", markup=False, highlight=False, soft_wrap=True)


def say_left_out(rows: Sequence[Mapping[str, str]]) -> None:
    """Report each run that is not used, on one line."""
    for row in rows:
        say(f"run {row['run']!r} is LEFT OUT: {row['reason']}")


def show(values: Mapping[str, Any], as_json: bool, text: str = "") -> None:
    """Print a result: as one JSON object, or as text (by default the values, one a line)."""
    if as_json:
        print(json_text(values))
        return
    print(text or "\n".join(text_lines(values)))


def local_processes(workers: int, cluster: str | None) -> int:
    """Return how many processes to start here, from --workers (0: one for each core) and --cluster.

    Raises:
        InputError: both are given, or the cluster's address is not valid.
    """
    if cluster is not None:
        if workers:
            raise InputError(
                f"--workers {workers} counts processes on this computer, but --cluster has its own workers: "
                "give only one of the two"
            )
        check_cluster(cluster)
        return 1
    return workers or os.cpu_count() or 1
