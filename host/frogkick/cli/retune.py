"""``frogkick retune``: tables that know what has changed in a robot, from its last runs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from frogkick.cli.common import JsonOption, SeedOption, say, say_left_out, show
from frogkick.cli.identify import horizon_line
from frogkick.cli.options import KeyOption
from frogkick.cli.push import text_of
from frogkick.core.errors import InputError

if TYPE_CHECKING:
    from frogkick.front.retuning import Retuning

STATES = 800
"""That of frogkick.front.retuning: a command's help loads nothing of it."""
STATES_LEAST = 46
"""WHOLE_MIN of frogkick.library.fitting, likewise."""


def command(
    runs: Annotated[
        list[Path],
        typer.Argument(help="The robot's last runs: logs, or recorded runs (.csv). Last: to judge."),
    ],
    robot: Annotated[
        str, typer.Option("--robot", "--model", help="Robot TOML or name that its tables were made from.")
    ],
    out: Annotated[Path, typer.Option(help="New folder for robot, library, tables and firmware.")],
    tables: Annotated[
        Path | None,
        typer.Option(help="Table image that it carries (.fkt), to compare with; default: made from --robot."),
    ] = None,
    states: Annotated[
        int, typer.Option(min=STATES_LEAST, max=65535, help="States of the libraries that are simulated.")
    ] = STATES,
    workers: Annotated[int, typer.Option(min=0, max=256, help="Processes; 0 = one for each core.")] = 0,
    push: Annotated[
        str | None,
        typer.Option(
            metavar="TARGET", help="Send better tables to ble:NAME, serial:PORT or virtual; it keeps the old."
        ),
    ] = None,
    key: KeyOption = None,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Make a worn robot new tables. Exit 1 where they are no better on held-out periods or runs too short."""
    from frogkick.front.retuning import TABLES, retune

    made = retune(
        runs,
        robot=robot,
        out=out,
        table=tables,
        states=states,
        workers=workers,
        push=push,
        key=key,
        seed=seed,
        left_out=say_left_out,
        progress=True,
    )
    show(made.as_json(), json, printed(made, push))
    if made.not_pushed is not None:
        raise InputError(
            f"the new tables are made, and not sent: {made.not_pushed}; then send them by 'frogkick push "
            f"{out / TABLES} --robot {push}'"
        ) from made.not_pushed
    if made.reason and not made.done:
        say(made.reason)
    if not made.done:
        raise typer.Exit(1)


def printed(made: Retuning, push: str | None = None) -> str:
    """For people; ``push`` is where better tables were sent."""
    result, out = made.found, made.out
    lines = [f"verdict: {result.outcome.verdict}", f"held out: {result.held_out}"]
    for term, row in zip(result.outcome.terms, result.outcome.parameters, strict=True):
        values = ", ".join(f"{p.name} {p.value:.4g} [{p.low:.4g}, {p.high:.4g}] {p.unit}" for p in row)
        lines.append(f"effect {term.title}: {values}")
    for name, error in (("old", result.before), ("new", result.after)):
        if error.count:
            lines.append(f"{name} tables: {error} RMS a period ahead ({error.count} periods)")
    if result.loop is not None:
        for name, tracked in zip(("old", "new"), result.loop, strict=True):
            lines.append(
                f"{name} tables in closed loop, in a simulated pool with what was found: "
                f"{1e3 * tracked.mean_distance_m:.1f} mm from the path, "
                f"{1e3 * tracked.progress_mps:.1f} mm/s along it, "
                f"{tracked.completed} of {tracked.runs} runs completed"
            )
    lines += [f"tables, {horizon_line(each)}" for each in result.horizons if each.periods > 1]
    if result.done and result.reason:
        lines.append(result.reason)
    if result.better and result.tables is not None:
        lines.append(f"new tables: {result.tables['file']}, firmware: {out / 'firmware'}")
        lines.append(f"old tables, to go back to: {out / 'before.fkt'}")
    if push is not None and made.pushed is not None:
        lines.append(text_of(made.pushed, push))
    return "\n".join(lines)


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command(name="retune")(command)
