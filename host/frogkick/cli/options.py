"""Options that commands share, and how a command's arguments become options; written ``opt.Seed``."""

from __future__ import annotations

import enum
import functools
import inspect
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import nullcontext, redirect_stdout, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args

import typer

from frogkick.cli.common import Result, show, tells_undone
from frogkick.core.errors import InputError
from frogkick.core.files import file_to_write, require_writable

PlanWhere = enum.StrEnum("PlanWhere", ["onboard", "host", "both"])
PlannerName = enum.StrEnum("PlannerName", ["robot", "paper"])
Sampling = enum.StrEnum("Sampling", ["box", "visited", "planned"])


@dataclass(frozen=True)
class With:
    """What an option has beside its help.

    Attributes:
        min: the least number.
        max: the largest number.
        names: other names of the option.
        metavar: name of its value.
        show_default: whether the help has the default.
        folder: whether what is written is a folder; None: the command checks it.
    """

    min: float | None = None
    max: float | None = None
    names: tuple[str, ...] = ()
    metavar: str | None = None
    show_default: bool = True
    folder: bool | None = False


FILE = ("--robot", "--model")
"""The names of an option whose value is a robot's file."""

# A type, a text and perhaps a ``With`` are the option "--name" with that help, see ``with_options``.
JSON = inspect.Parameter(
    "json",
    inspect.Parameter.KEYWORD_ONLY,
    default=False,
    annotation=Annotated[bool, "Print one JSON object and nothing else."],
)
Seed = Annotated[int, "Seed of all random numbers; the same seed gives the same result.", With(0)]
Cluster = Annotated[
    str | None,
    "Compute on this Dask scheduler, such as tcp://host:8786, instead of on this computer.",
    With(metavar="ADDRESS"),
]
Tables = Annotated[
    Path | None, "Table image (.fkt); default: one that is made from a small library on first use."
]
Planner = Annotated[
    PlannerName,
    "Weights and depth of the planner. robot: those of its TOML file; paper: the paper's weights "
    "(distance 500, angle 50, progress 300, level 0.3) and depth 1.",
]
Depth = Annotated[
    int | None,
    "Number of strokes that the planner looks ahead. With the route cost, which --planner robot has for most "
    "robots, 3 and 4 are a beam search that looks 7 and 8 strokes ahead. Default: that of the planner.",
    With(1, 4),
]
Key = Annotated[
    Path | None, "Key file of a real robot that has an owner; default: the user's own, see 'frogkick own'."
]
Target = Annotated[str, "ble:NAME, ble:ADDRESS or serial:PORT[:BAUD].", With(metavar="TARGET")]
Workers = Annotated[int, "Number of processes; 0: one for each core.", With(0, 256)]
RobotArgument = Annotated[str, typer.Argument(help="TOML file or built-in name.")]
RobotFile = Annotated[str, "TOML file or built-in name.", With(names=FILE)]
Model = Annotated[
    str | None, "Robot TOML file or built-in name; default: the table's robot.", With(names=FILE)
]
Swimmer = Annotated[
    str | None,
    "Robot TOML file or built-in name; default: the table's robot. The planner believes what its table was "
    "made with, effects included; in a simulated pool the robot swims without the effects of its file, with "
    "those of --world.",
]
Laws = Annotated[
    bool,
    "If residuals above the noise remain with the catalogue, search formulas as well: springs, sloshing, "
    "limbs that break, strokes that depend on the heading. With --no-laws the search ends with the "
    "catalogue.",
]
Nominal = Annotated[
    str | None,
    "Nominal robot, as TOML file or built-in name; default: the robot in the logs.",
    With(names=FILE),
]

Unseen = Annotated[
    Sampling,
    "Unseen states that the error is measured on, drawn as by 'library build'. planned: where the planner "
    "leads the robot; visited: where random strokes lead it; box: any velocity, also those that no swim has.",
]
World = Annotated[Path | None, "TOML file of effects that act in the pool but are in no model."]


Found = TypeVar("Found")


def call(function: Callable[..., Found], options: Mapping[str, Any], **others: Any) -> Found:
    """Call a function of the front door with a command's options.

    Args:
        function: an option is given to its parameter of the same name.
        options: the ``locals()`` of the command.
        others: parameters that are not simply the value of an option.
    """
    known = inspect.signature(function).parameters.keys() & options.keys()
    given = {name: options[name] for name in known}
    plain = {name: value.value if isinstance(value, enum.Enum) else value for name, value in given.items()}
    return function(**{**plain, **others})


WRITTEN = ("out", "predictions", "report", "animation", "picture")
"""Options of all commands that name what is written."""


def require_apart(options: Mapping[str, Any]) -> None:
    """Raise InputError if a file would be written that the command also reads, or written twice."""
    written = {name: Path(options[name]) for name in WRITTEN if options.get(name) is not None}
    read = [value for name, value in options.items() if name not in WRITTEN for value in _files(value)]
    for index, (name, file) in enumerate(written.items()):
        for other in list(written)[:index]:
            if written[other].absolute() == file.absolute():
                raise InputError(f"--{name} {str(file)!r} is --{other} too: give each a file of its own")
        if file.is_file() and any(os.path.samefile(file, each) for each in read):
            raise InputError(
                f"--{name} {str(file)!r} is read by this command, and would be replaced: name another file"
            )


def _files(value: Any) -> Iterator[Path]:
    """Yield the files that the value of an option names."""
    for each in value if isinstance(value, list | tuple) else [value]:
        with suppress(OSError):  # no text that is longer than a file's name names one
            if isinstance(each, str | Path) and Path(each).is_file():
                yield Path(each)


def with_options(command: Callable[..., Result | Iterator[Result]]) -> Callable[..., None]:
    """Return a command whose arguments ``Annotated[type, "help", With(...)]`` are options with that help.

    A switch that is off by default has no ``--no-name``. What is written must not be what is read, and where
    it is written must allow that, which is checked first. Every command has ``--json`` and prints its result,
    or the one that it yields before it goes on. With ``--json`` stdout gets nothing else: what a user's own
    file prints, such as an effect, goes to stderr.
    """
    signature = inspect.signature(command, eval_str=True)
    known = signature.parameters

    @functools.wraps(command)
    def checked(json: bool, **options: Any) -> None:
        require_apart(options)
        for name in WRITTEN:
            if folders.get(name) is not None:
                require_writable(options[name], folders[name])
        stdout = sys.stdout
        with tells_undone(), redirect_stdout(sys.stderr) if json else nullcontext():
            given = command(**options, **({"json": json} if "json" in known else {}))
            for result in [given] if isinstance(given, Result) else given:
                show(result, json, stdout)

    parameters, folders = [], {}
    for parameter in (known | {"json": JSON}).values():
        annotation = parameter.annotation
        kind, *notes = get_args(annotation) or (annotation,)
        if notes and isinstance(notes[0], str):
            more = asdict(notes[1] if len(notes) > 1 else With())
            folders[parameter.name] = more.pop("folder")
            if parameter.name in WRITTEN and folders[parameter.name] is False:
                more |= {"parser": file_to_write, "metavar": "<path>"}  # a Path forgets a slash at its end
            own = (f"--{parameter.name.replace('_', '-')}",) if parameter.default is False else ()
            annotation = Annotated[kind, typer.Option(*(more.pop("names") or own), help=notes[0], **more)]
        parameters.append(parameter.replace(annotation=annotation))
    checked.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    return checked
