"""``frogkick parity``: the same bits from Python, native C and the chip."""

from __future__ import annotations

from typing import Annotated

import typer

from frogkick.cli.common import JsonOption, SeedOption, progress_bar, show
from frogkick.cli.places import (
    PlannerName,
    TablesOption,
    plan_config,
    robot_of_table,
    simulated_robot,
    table_image,
)
from frogkick.loop.plan_place import plan_over_link
from frogkick.paths import shape
from frogkick.planner.image import read_image
from frogkick_codegen.native import NativeLibrary
from frogkick_codegen.parity import KINDS, compare, make_cases, native_place, python_place

CHIP_STATES = 2000


def parity(
    states: Annotated[
        int, typer.Option(min=10, max=10_000_000, help="States for Python and native C.")
    ] = 100_000,
    chip_states: Annotated[
        int, typer.Option(min=0, max=1_000_000, help="States of them for the virtual chip.")
    ] = CHIP_STATES,
    tables: TablesOption = None,
    model: Annotated[str | None, typer.Option(help="Robot TOML or name; default: the table's robot.")] = None,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Plan from many states in every place and count differing bits. Exit 1 if there are any."""
    image = table_image(tables, model)
    described = robot_of_table(image, model)
    opened, path, config = read_image(image), shape("sine"), plan_config(described, PlannerName.paper, 1)
    cases = make_cases(opened, path, states, seed)
    python = python_place(opened, path, config)
    native = native_place(NativeLibrary(), opened, path, config)
    reports = compare(cases, {"python": python, "native": native})
    on_chip = min(chip_states, states)
    if on_chip:
        with simulated_robot("virtual", image, described) as port, progress_bar("virtual chip") as progress:
            chip = plan_over_link(port, opened, path, config, progress)
            reports += [
                report
                for report in compare(cases.head(on_chip), {"python": python, "native": native, "chip": chip})
                if report.second == "chip"
            ]
    mismatches = {f"{report.first}-{report.second}": report.mismatches for report in reports}
    result = {
        "states": states,
        "chip_states": on_chip,
        "mismatches": mismatches,
        "fields": {f"{r.first}-{r.second}": dict(r.fields) for r in reports},
        "kinds": list(KINDS),
        "seed": seed,
        "failures": [report.first_failure for report in reports if report.first_failure],
    }
    show(result, json)
    if any(mismatches.values()):
        raise typer.Exit(1)


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(parity)
