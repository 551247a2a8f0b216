"""``frogkick demo``: the whole ring once, on the virtual chip."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from frogkick.cli.common import JsonOption, SeedOption, progress_bar, require_writable, show
from frogkick.cli.places import DepthOption, PlannerName, plan_config
from frogkick.report.ring_page import write_ring_report
from frogkick.robot import load_robot
from frogkick.study.ring import go_round


def demo(
    out: Annotated[Path, typer.Option(help="Folder for everything that is made.")] = Path("demo"),
    robot: Annotated[str, typer.Option(help="TOML file or built-in name.")] = "frog2022",
    states: Annotated[int, typer.Option(min=10, max=2000, help="Initial velocities of the library.")] = 300,
    depth: DepthOption = None,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Simulate, tabulate, emit C, build firmware, swim three paths with it on the virtual chip, report."""
    described = load_robot(robot)
    require_writable(out, folder=True)
    levels = plan_config(described, PlannerName.robot, depth).depth
    ring = go_round(described, out, states, levels, seed, progress_bar)
    report = out / "report.html"
    write_ring_report(report, ring)
    paths = {
        run.log.path.name: {**run.tracking.as_json(), "mismatches": run.mismatches}
        for run in ring.runs
        if run.log.path is not None
    }
    values = {
        "mean_distance_m": ring.mean_distance_m,
        "paths": paths,
        # What the model missed. Nothing is identified and added yet, so there is no "after".
        "before": ring.missed,
        "after": None,
        "chip_checks_passed": ring.chip.passed,
        "report": str(report),
    }
    lines = [
        f"{name:8s} mean distance {1e3 * float(path['mean_distance_m']):5.1f} mm, "
        f"{path['decisions']} decisions, {'completed' if path['completed'] else 'not completed'}, "
        f"{path['mismatches']} mismatches between chip and twin"
        for name, path in paths.items()
    ]
    show(values, json, "\n".join([*lines, f"report: {report.resolve()}"]))
    broken = any(run.mismatches or run.tracking.limit_violations for run in ring.runs)
    if broken or not ring.chip.passed:
        raise typer.Exit(1)


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(demo)
