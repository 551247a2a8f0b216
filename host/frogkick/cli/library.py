"""``frogkick library``: simulate transitions for many initial velocities."""

from __future__ import annotations

import enum
import time
from pathlib import Path
from typing import Annotated

import typer

import frogkick as fk
from frogkick.cli.common import (
    ClusterOption,
    JsonOption,
    RobotArgument,
    SeedOption,
    WholeLines,
    WorkersOption,
    local_processes,
    say,
    show,
)
from frogkick.core.files import require_writable

RECORD_S = 5.0
"""The value of frogkick.library, repeated so that a command's help does not load that package."""

app = typer.Typer(
    cls=WholeLines, help="Simulate transitions for many initial velocities.", no_args_is_help=True
)


class Sampling(enum.StrEnum):
    """How initial velocities are drawn."""

    box = "box"
    visited = "visited"
    planned = "planned"


@app.command()
def build(
    robot: RobotArgument = "frog2022",
    states: Annotated[int, typer.Option(min=1, max=65535, help="Number of initial velocities.")] = 300,
    out: Annotated[Path, typer.Option(help="HDF5 file to write.")] = Path("lib.h5"),
    workers: WorkersOption = 0,
    sampling: Annotated[
        Sampling,
        typer.Option(
            help="How initial velocities are drawn. box: uniformly, as in the paper; visited: from swims "
            "with random strokes; planned: from swims that the planner steers."
        ),
    ] = Sampling.box,
    record_s: Annotated[
        float,
        typer.Option(
            min=0.0,
            max=60.0,
            help="Time to simulate and record after each transition's start, s; 0: one period.",
        ),
    ] = RECORD_S,
    cluster: ClusterOption = None,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Simulate every action from each of many initial velocities. An interrupted build can be resumed."""
    described = fk.load_robot(robot)
    require_writable(out)
    processes = local_processes(workers, cluster)
    began = time.perf_counter()
    made = fk.build_library(
        described,
        states,
        seed,
        sampling=sampling.value,
        record_s=record_s,
        workers=processes,
        cluster=cluster,
        out=out,
        progress=True,
    )
    for failure in made.failed:
        name = described.actions[failure.action].name
        say(f"state {failure.state}, action {name} is left out of the tables: {failure.reason}")
    transitions = states * len(described.actions)
    show(
        {
            "transitions": transitions,
            "failed": len(made.failed),
            "wall_s": round(time.perf_counter() - began, 3),
            "simulated_s": transitions * max(described.period_s, record_s),
            "out": str(out),
        },
        json,
    )


@app.command()
def info(
    library: Annotated[Path, typer.Argument(help="HDF5 file that 'library build' wrote.")],
    json: JsonOption = False,
) -> None:
    """Show what a library holds."""
    from frogkick.front.tables import library_info

    # How long it took is not in the file, whose bytes do not depend on the machine.
    show({**library_info(library), "wall_s": None}, json)
