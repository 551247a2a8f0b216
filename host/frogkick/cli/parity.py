"""``frogkick parity``: the same bits from Python, native C and the chip."""

from __future__ import annotations

from typing import Annotated

import typer

from frogkick.cli.common import JsonOption, SeedOption, show
from frogkick.cli.options import DepthOption, ModelOption, PlannerName, PlannerOption, TablesOption

LOOP_DECISIONS = 200
"""That of frogkick.front.parity: a command's help loads nothing of it."""


def parity(
    states: Annotated[
        int, typer.Option(min=10, max=10_000_000, help="States for Python and native C.")
    ] = 100_000,
    chip_states: Annotated[
        int | None,
        typer.Option(min=0, max=10_000_000, help="States of them for the virtual chip.  [default: all]"),
    ] = None,
    loop_decisions: Annotated[
        int, typer.Option(min=0, max=100_000, help="Decisions of a whole loop, fixes in, decisions out.")
    ] = LOOP_DECISIONS,
    tables: TablesOption = None,
    model: ModelOption = None,
    planner: PlannerOption = PlannerName.paper,
    depth: DepthOption = None,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Decide in every place and count differing bits. Exit 1 if there are any.

    Single decisions from states of every kind, at depth 1 to 4, and a whole loop at --depth. Places: Python,
    native C by zig's clang (native), by gcc where this machine has it, and the virtual chip.
    """
    from frogkick.front.parity import compare_places

    found = compare_places(
        tables,
        robot=model,
        states=states,
        chip_states=chip_states,
        loop_decisions=loop_decisions,
        planner=planner.value,
        depth=depth,
        seed=seed,
        progress=True,
    )
    show(found.as_json(), json)
    if not found.same:
        raise typer.Exit(1)


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(parity)
