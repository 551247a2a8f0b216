"""``frogkick study``: runs a study by its configuration and shows its result.

Studies come with a clone of the project, beside the package, and not with the wheel.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable
from dataclasses import MISSING, fields
from inspect import Parameter, Signature
from pathlib import Path
from typing import Annotated, Any, get_origin, get_type_hints

import typer

from frogkick.cli.common import JsonOption, SeedOption, show, write_picture
from frogkick.cli.library import Sampling
from frogkick.cli.options import (
    DepthOption,
    ModelOption,
    NominalOption,
    PlannerOption,
    RobotFileOption,
    TablesOption,
)
from frogkick.core.errors import InputError
from frogkick.core.files import require_writable

SHARED: dict[tuple[str, str], Any] = {
    ("seed", "int"): SeedOption,
    ("depth", "int | None"): DepthOption,
    ("model", "str | None"): ModelOption,
    ("robot", "str | None"): NominalOption,
    ("robot", "str"): RobotFileOption,
    ("planner", "str"): PlannerOption,
    ("tables", "Path | None"): TablesOption,
    ("workers", "int"): Annotated[
        int, typer.Option(min=0, max=256, help="Number of processes; 0: one for each core.")
    ],
    ("swims", "str"): Annotated[
        Sampling, typer.Option(help="How the unseen states are drawn, as for 'library build'.")
    ],
}
"""The shared options, by the name and type of a configuration's field."""


def register(app: typer.Typer) -> None:
    """Add the commands.

    Raises:
        InputError: frogkick was installed without the studies.
    """
    folder = Path(__file__).parents[2] / "studies"
    if not (folder / "frogkick_studies").is_dir():
        raise InputError(
            "the studies are part of a clone of the project, not of the wheel: run them in a clone"
        )
    if str(folder) not in sys.path:
        sys.path.append(str(folder))
    for name, config in importlib.import_module("frogkick_studies.configs").STUDIES.items():
        app.command(name)(_command(name, config))


def _command(name: str, config: Any) -> Callable[..., None]:
    """Return a command whose options are the fields of a configuration."""
    hints = get_type_hints(config, include_extras=True)
    options = {
        field.name: hints[field.name]
        if get_origin(hints[field.name]) is Annotated
        else SHARED[field.name, str(field.type)]
        for field in fields(config)
    } | {"json": JsonOption}
    defaults = {
        field.name: Parameter.empty if field.default is MISSING else field.default for field in fields(config)
    }

    def command(**given: Any) -> None:
        as_json = given.pop("json")
        _run(name, config(**given), as_json)

    command.__doc__ = config.__doc__
    command.__annotations__ = options
    command.__signature__ = Signature(  # type: ignore[attr-defined]
        [
            Parameter(each, Parameter.KEYWORD_ONLY, default=defaults.get(each, False), annotation=option)
            for each, option in options.items()
        ]
    )
    return command


def _run(name: str, config: Any, as_json: bool) -> None:
    out: Path | None = getattr(config, "out", None)
    require_writable(out, folder=config.folder)
    found = importlib.import_module(f"frogkick_studies.{name}").run(config)
    values = found.as_json()
    if out is not None:
        figure = out / f"{name}.png" if config.folder else out
        write_picture(found.plot(), figure)
        values["figure"] = str(figure)
    show(values, as_json, found.text(values))
    if not found.passed:
        raise typer.Exit(1)
