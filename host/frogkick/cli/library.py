"""``frogkick library``: simulate transitions for many initial velocities."""

from __future__ import annotations

import enum
import time
from pathlib import Path
from typing import Annotated

import typer

from frogkick.cli.common import (
    ClusterOption,
    JsonOption,
    SeedOption,
    progress_bar,
    require_writable,
    share_out,
    show,
    stderr,
)
from frogkick.library import RECORD_S, build_library, library_info
from frogkick.robot import load_robot

app = typer.Typer(help="Simulate transitions for many initial velocities.", no_args_is_help=True)


class Sampling(enum.StrEnum):
    """How initial velocities are drawn."""

    box = "box"
    visited = "visited"
    planned = "planned"


@app.command()
def build(
    robot: Annotated[str, typer.Argument(help="TOML file or built-in name.")] = "frog2022",
    states: Annotated[int, typer.Option(min=1, max=65535, help="Initial velocities.")] = 300,
    out: Annotated[Path, typer.Option(help="HDF5 file to write.")] = Path("lib.h5"),
    workers: Annotated[int, typer.Option(min=0, max=256, help="Processes; 0 = one for each core.")] = 0,
    sampling: Annotated[
        Sampling,
        typer.Option(
            help="box: uniform (the paper's); visited: at random strokes; planned: at the planner's."
        ),
    ] = Sampling.box,
    record_s: Annotated[
        float,
        typer.Option(min=0.0, max=60.0, help="Follow and record each transition so long, s; 0: one period."),
    ] = RECORD_S,
    cluster: ClusterOption = None,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Simulate every action from each of many initial velocities. Stopped and started again, it goes on."""
    described = load_robot(robot)
    require_writable(out)
    processes = share_out(workers, cluster)
    began = time.perf_counter()
    with progress_bar("library") as progress:
        report = build_library(
            described,
            states=states,
            seed=seed,
            workers=processes,
            out=out,
            progress=progress,
            sampling=sampling.value,
            record_s=record_s,
            cluster=cluster,
        )
    for line in report.failures:
        stderr.print(f"frogkick: left out of tables, {line}", markup=False, highlight=False, soft_wrap=True)
    show(
        {
            "transitions": report.transitions,
            "failed": len(report.failures),
            "wall_s": round(time.perf_counter() - began, 3),
            "simulated_s": report.simulated_s,
            "out": str(out),
        },
        json,
    )


@app.command()
def info(
    library: Annotated[Path, typer.Argument(help="HDF5 file of 'library build'.")], json: JsonOption = False
) -> None:
    """Say what a library holds."""
    # How long it took is not in the file, whose bytes do not depend on the machine.
    show({**library_info(library), "wall_s": None}, json)
