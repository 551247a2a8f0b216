"""``frogkick study``: questions about the method, answered with figures."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import Annotated

import typer

from frogkick.cli.common import JsonOption, SeedOption, show, write_picture
from frogkick.cli.options import PlannerName, PlannerOption, TablesOption
from frogkick.progress import progress_bar


def convergence(
    robot: Annotated[str, typer.Argument(help="TOML file or built-in name.")] = "frog2022",
    out: Annotated[Path | None, typer.Option(help="Picture to write (PNG).")] = None,
    every: Annotated[int, typer.Option(min=1, max=100, help="Take every so many-th gait.")] = 1,
    json: JsonOption = False,
) -> None:
    """Error of the rod simulation against its time step. Exit 1 if the default step errs too much."""
    from frogkick.der import STEP_S
    from frogkick.report.convergence_figure import convergence_figure
    from frogkick.robot import load_robot
    from frogkick.study.convergence import ERROR_LIMIT
    from frogkick.study.convergence import convergence as measure

    described = load_robot(robot)
    with progress_bar("convergence") as progress:
        curves = measure(described, progress, every)
    if out is not None:
        write_picture(convergence_figure(curves, STEP_S), out)
    values = {
        "default_step_s": STEP_S,
        "limit": ERROR_LIMIT,
        "order": {curve.name: round(curve.order, 3) for curve in curves},
        "error_at_default": {curve.name: curve.at_default for curve in curves},
        "worst": {
            curve.name: dict(zip(curve.step_s.tolist(), curve.worst.tolist(), strict=True))
            for curve in curves
        },
        "rms": {
            curve.name: dict(zip(curve.step_s.tolist(), curve.error.tolist(), strict=True))
            for curve in curves
        },
    }
    show(values, json)
    if any(curve.worst[curve.step_s == STEP_S].max() > ERROR_LIMIT for curve in curves):
        raise typer.Exit(1)


def chip(
    tables: TablesOption = None,
    model: Annotated[str | None, typer.Option(help="Robot TOML or name; default: the table's robot.")] = None,
    states: Annotated[int, typer.Option(min=12, max=1_000_000, help="Decisions at each depth.")] = 300,
    planner: PlannerOption = PlannerName.robot,
    workers: Annotated[int, typer.Option(min=0, max=256, help="Processes; 0: one for each core.")] = 1,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """How long the chip plans: cycles of the flashed image over many states. Exit 1 over a limit.

    Of very many states the dearest are run on the virtual chip, which a model of the planner's blocks finds
    among all of them: "run" is how many, "model_error" its largest error, "unrun_ms" its bound of the rest.
    """
    from frogkick.front.places import built_firmware, plan_config, robot_of_table, table_image
    from frogkick.paths import SHAPES, shape
    from frogkick.pool.chip import CostModel
    from frogkick.study.chip_speed import DEPTHS, LIMIT_MS, chip_speed, open_ms
    from frogkick_codegen.firmware import require_tools

    require_tools("bench")
    image = table_image(tables, model)
    described = robot_of_table(image, model)
    counts = {depth: states if depth in LIMIT_MS else max(3, states // 50) for depth in DEPTHS}
    paths = {name: shape(name) for name in SHAPES}
    config = plan_config(described, planner.value, None)
    with built_firmware("bench", image, described) as built, progress_bar("decisions") as progress:
        opened_ms = open_ms(built.image)
        processes = workers or os.cpu_count() or 1
        speeds = chip_speed(built.image, image, paths, config, counts, seed, processes, progress)
    over = [
        depth
        for depth, limit in LIMIT_MS.items()
        if max(speeds[depth].worst_ms, speeds[depth].unrun_ms) > limit
    ]
    show(
        {
            "plan_ms": {
                str(depth): {"mean": round(speed.mean_ms, 4), "worst": round(speed.worst_ms, 4)}
                for depth, speed in speeds.items()
            },
            "limit_ms": {str(depth): limit for depth, limit in LIMIT_MS.items()},
            "states": {str(depth): speed.states for depth, speed in speeds.items()},
            "run": {str(depth): speed.run for depth, speed in speeds.items()},
            "model_error": {str(depth): round(speed.model_error, 5) for depth, speed in speeds.items()},
            "unrun_ms": {str(depth): round(speed.unrun_ms, 4) for depth, speed in speeds.items()},
            "worst_ms_by_reach": {
                str(depth): {str(reach): round(one, 4) for reach, one in speed.worst_ms_by_reach.items()}
                for depth, speed in speeds.items()
            },
            "nodes": {str(depth): round(speed.nodes, 1) for depth, speed in speeds.items()},
            "instructions_per_node": {
                str(depth): round(speed.instructions_per_node, 1) for depth, speed in speeds.items()
            },
            "open_ms": round(opened_ms, 2),
            "worst": {
                str(depth): {
                    "path": speed.worst_path,
                    "state": speed.worst_state,
                    "limb_use": speed.worst_limb_use,
                    "along_points": speed.worst_along_points,
                }
                for depth, speed in speeds.items()
            },
            "share_percent": {
                str(depth): {share.function: round(share.percent, 1) for share in speed.shares[:12]}
                for depth, speed in speeds.items()
            },
            "calls": {
                str(depth): {share.function: round(share.calls, 1) for share in speed.shares[:12]}
                for depth, speed in speeds.items()
            },
            "cycle_model": dataclasses.asdict(CostModel()),
            "seed": seed,
        },
        json,
    )
    if over:
        raise typer.Exit(1)


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.command()(convergence)
    app.command()(chip)
