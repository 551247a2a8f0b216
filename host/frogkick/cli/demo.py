"""``frogkick demo``: the whole ring once, on the virtual chip."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from frogkick.cli.common import JsonOption, SeedOption, show
from frogkick.cli.options import DepthOption
from frogkick.files import require_writable
from frogkick.progress import progress_bar

if TYPE_CHECKING:
    from frogkick.study.closing import Closing


def demo(
    out: Annotated[Path, typer.Option(help="Folder for everything that is made.")] = Path("demo"),
    robot: Annotated[str, typer.Option(help="TOML file or built-in name.")] = "frog2022",
    states: Annotated[int, typer.Option(min=10, max=2000, help="Initial velocities of the library.")] = 300,
    depth: DepthOption = None,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Simulate, tabulate, build firmware, swim on the virtual chip; wear a limb, find and learn it, again."""
    from frogkick.front.places import plan_config
    from frogkick.report.identify_page import write_identify_page
    from frogkick.report.ring_page import write_ring_report
    from frogkick.robot import load_robot
    from frogkick.study.ring import close, go_round
    from frogkick_codegen.firmware import require_tools

    described = load_robot(robot)
    require_writable(out, folder=True)
    require_tools("bench")
    levels = plan_config(described, "robot", depth).depth
    ring = go_round(described, out, states, levels, seed, progress_bar)
    close(ring, out, seed, progress_bar)
    assert ring.closing is not None
    closing = ring.closing.as_json()
    report = out / "report.html"
    write_identify_page(out / "identify.html", ring.closing.outcome)
    write_ring_report(report, ring)
    paths = {
        run.log.path.name: {**run.tracking.as_json(), "mismatches": run.mismatches}
        for run in ring.runs
        if run.log.path is not None
    }
    values = {
        "mean_distance_m": ring.mean_distance_m,
        "paths": paths,
        **closing,  # before and after: see Closing
        "table_missed": ring.missed,
        "chip_checks_passed": ring.chip.passed,
        "report": str(report),
    }
    lines = [
        f"{name:8s} mean distance {1e3 * float(path['mean_distance_m']):5.1f} mm, "
        f"{path['decisions']} decisions, {'completed' if path['completed'] else 'not completed'}, "
        f"{path['mismatches']} mismatches between chip and twin"
        for name, path in paths.items()
    ]
    lines += _closing_lines(ring.closing)
    show(values, json, "\n".join([*lines, f"report: {report.resolve()}"]))
    broken = any(run.mismatches or run.tracking.limit_violations for run in ring.runs)
    if broken or not ring.chip.passed:
        raise typer.Exit(1)


def _closing_lines(closing: Closing) -> list[str]:
    import numpy as np

    tested, found = closing.outcome.tested, [term.title for term in closing.outcome.terms]
    hidden = ", ".join(str(value) for value in closing.planted.values())
    lines = [f"hidden: {hidden}; verdict: {closing.outcome.verdict} ({', '.join(found) or 'no effect'})"]
    lines += [
        f"{name:8s} {1e3 * error.position_rmse_m:.2f} mm, {np.degrees(error.heading_rmse_rad):.2f} deg RMS a "
        "period ahead on the run kept out of learning"
        for name, error in (("before", tested.before), ("after", tested.after), ("noise", tested.noise_floor))
    ]
    if closing.new:
        lines.append(
            f"worn robot: {1e3 * closing.distance_m(closing.old):.1f} mm from its paths with the old "
            f"firmware, {1e3 * closing.distance_m(closing.new):.1f} mm with the new"
        )
    return lines


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(demo)
