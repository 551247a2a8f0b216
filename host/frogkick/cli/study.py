"""``frogkick study``: runs a study with its configuration and shows its result.

Studies are part of a clone of the project, next to the package, and not of the wheel.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable
from dataclasses import MISSING, fields
from inspect import Parameter, Signature
from pathlib import Path
from typing import Annotated, Any, get_origin, get_type_hints

from frogkick.cli import options as opt
from frogkick.cli.common import save, show
from frogkick.core.errors import InputError
from frogkick.core.files import require_writable
from frogkick.report.style import write_picture

SHARED: dict[tuple[str, str], Any] = {
    ("seed", "int"): opt.Seed,
    ("depth", "int | None"): opt.Depth,
    ("model", "str | None"): opt.Model,
    ("robot", "str | None"): opt.Nominal,
    ("robot", "str"): opt.RobotFile,
    ("planner", "str"): opt.Planner,
    ("tables", "Path | None"): opt.Tables,
    ("workers", "int"): opt.Workers,
    ("swims", "str"): opt.Unseen,
}
"""The shared options, by the name and type of a configuration's field."""


def command(name: str) -> Callable[..., None]:
    """Return the command of a study; its options are the fields of the study's configuration.

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
    config = importlib.import_module("frogkick_studies.configs").STUDIES[name]
    hints = get_type_hints(config, include_extras=True)
    options = {
        field.name: hints[field.name]
        if get_origin(hints[field.name]) is Annotated
        else SHARED[field.name, str(field.type)]
        for field in fields(config)
    } | {"json": opt.Json}
    defaults = {
        field.name: Parameter.empty if field.default is MISSING else field.default for field in fields(config)
    }

    def run(**given: Any) -> None:
        as_json = given.pop("json")
        _run(name, config(**given), as_json)

    run.__doc__ = config.__doc__
    run.__signature__ = Signature(  # type: ignore[attr-defined]
        [
            Parameter(each, Parameter.KEYWORD_ONLY, default=defaults.get(each, False), annotation=option)
            for each, option in options.items()
        ]
    )
    return run


def _run(name: str, config: Any, as_json: bool) -> None:
    out: Path | None = getattr(config, "out", None)
    require_writable(out, folder=config.folder)
    for field in fields(config):
        given = getattr(config, field.name)
        for file in given if isinstance(given, list | tuple) else [given]:
            if field.name != "out" and isinstance(file, Path) and not file.exists():
                raise InputError(
                    f"{field.name.replace('_', ' ')} {str(file)!r} does not exist: check the path"
                )
    found = importlib.import_module(f"frogkick_studies.{name}").run(config)
    values = found.as_json()
    if out is not None:
        figure = out / f"{name}.png" if config.folder else out
        save(lambda file: write_picture(found.plot(), file, ".png"), figure)
        values["figure"] = str(figure)
    show(values, as_json, found.text(values), passed=found.passed)
