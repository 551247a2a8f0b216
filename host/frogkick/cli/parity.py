"""``frogkick parity``: checks that Python, native C and the chip decide the same bits."""

from __future__ import annotations

from typing import Annotated

import typer

from frogkick.cli.common import (
    DepthOption,
    JsonOption,
    ModelOption,
    PlannerName,
    PlannerOption,
    SeedOption,
    TablesOption,
    show,
)

LOOP_DECISIONS = 200
"""The value of frogkick.front.parity, repeated so that a command's help does not load that module."""


def parity(
    states: Annotated[
        int, typer.Option(min=10, max=10_000_000, help="Number of states for Python and native C.")
    ] = 100_000,
    chip_states: Annotated[
        int | None,
        typer.Option(
            min=0, max=10_000_000, help="How many of the states the virtual chip decides too.  [default: all]"
        ),
    ] = None,
    loop_decisions: Annotated[
        int,
        typer.Option(
            min=0, max=100_000, help="Number of decisions of the closed-loop run, from fixes to decisions."
        ),
    ] = LOOP_DECISIONS,
    tables: TablesOption = None,
    model: ModelOption = None,
    planner: PlannerOption = PlannerName.paper,
    depth: DepthOption = None,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Make the same decisions in Python, in native C and on the virtual chip, and count differing bits.

    Single decisions start from states of every kind, at depth 1 to 4. A closed-loop run follows at --depth.
    Native C is compiled by zig's clang (native), and by gcc if this machine has it. The exit code is 1 if a
    bit differs.
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
