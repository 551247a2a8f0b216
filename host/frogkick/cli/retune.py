"""``frogkick retune``: new tables for a robot that has changed, made from its last runs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from frogkick.cli.common import (
    JsonOption,
    KeyOption,
    LawsOption,
    SeedOption,
    WorkersOption,
    say,
    say_left_out,
    show,
)
from frogkick.cli.identify import horizon_line
from frogkick.cli.push import text_of
from frogkick.core.errors import InputError

if TYPE_CHECKING:
    from frogkick.front.retuning import Retuning

STATES = 800
"""The value of frogkick.front.retuning, repeated so that a command's help does not load that module."""
STATES_LEAST = 46
"""The value of WHOLE_MIN of frogkick.library.fitting, repeated for the same reason."""


def command(
    runs: Annotated[
        list[Path],
        typer.Argument(
            help="The robot's last runs: logs, or recorded runs (.csv). The last one judges the result."
        ),
    ],
    robot: Annotated[
        str,
        typer.Option(
            "--robot",
            "--model",
            help="Robot TOML file or built-in name that the robot's tables were made from.",
        ),
    ],
    out: Annotated[
        Path, typer.Option(help="New folder for the robot's TOML file, library, tables and firmware.")
    ],
    tables: Annotated[
        Path | None,
        typer.Option(
            help="Table image that the robot carries (.fkt), to compare with; default: made from --robot."
        ),
    ] = None,
    states: Annotated[
        int, typer.Option(min=STATES_LEAST, max=65535, help="Number of states of the simulated libraries.")
    ] = STATES,
    workers: WorkersOption = 0,
    push: Annotated[
        str | None,
        typer.Option(
            metavar="TARGET",
            help="Send the new tables, if they are better, to ble:NAME, serial:PORT or virtual. The robot "
            "keeps the old ones.",
        ),
    ] = None,
    key: KeyOption = None,
    laws: LawsOption = True,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Make new tables for a worn robot.

    The exit code is 1 if they are no better on held-out periods, or if the runs are too short.
    """
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
        laws=laws,
        left_out=say_left_out,
        progress=True,
    )
    show(made.as_json(), json, printed(made, push))
    if made.not_pushed is not None:
        raise InputError(
            f"the new tables are made but were not sent: {made.not_pushed}; then send them by 'frogkick push "
            f"{out / TABLES} --robot {push}'"
        ) from made.not_pushed
    if made.reason and not made.done:
        say(made.reason)
    if not made.done:
        raise typer.Exit(1)


def printed(made: Retuning, push: str | None = None) -> str:
    """Return the result as text for people; ``push`` is the robot that the tables were sent to."""
    lines = [f"verdict: {made.outcome.verdict}", f"held out: {made.held_out}"]
    for term, row in zip(made.outcome.terms, made.outcome.parameters, strict=True):
        values = ", ".join(f"{p.name} {p.value:.4g} [{p.low:.4g}, {p.high:.4g}] {p.unit}" for p in row)
        lines.append(f"effect {term.title}: {values}")
    for name, error in (("old", made.before), ("new", made.after)):
        if error.count:
            lines.append(f"{name} tables: {error} RMS one period ahead ({error.count} periods)")
    if made.loop is not None:
        for name, tracked in zip(("old", "new"), made.loop, strict=True):
            lines.append(
                f"{name} tables in closed loop, in a simulated pool with the identified effects: "
                f"{1e3 * tracked.mean_distance_m:.1f} mm from the path, "
                f"{1e3 * tracked.progress_mps:.1f} mm/s along it, "
                f"{tracked.completed} of {tracked.runs} runs completed"
            )
    if made.lost is not None:
        lines.append(f"no table can hold: {', '.join(made.lost.effects)}")
        apart = (1e3 * each.mean_distance_m for each in (made.lost.with_them, made.lost.without))
        lines.append(
            "the robot's tables in closed loop: {:.1f} mm from the path with that in the pool, {:.1f} mm "
            "without it".format(*apart)
        )
    lines += [f"tables, {horizon_line(each)}" for each in made.horizons if each.periods > 1]
    if made.done and made.reason:
        lines.append(made.reason)
    if made.better and made.tables is not None:
        lines.append(f"new tables: {made.tables['file']}, firmware: {made.out / 'firmware'}")
        lines.append(f"old tables, to return to: {made.out / 'before.fkt'}")
    if push is not None and made.pushed is not None:
        lines.append(text_of(made.pushed, push))
    return "\n".join(lines)
