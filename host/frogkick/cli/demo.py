"""``frogkick demo``: once round the ring, on the virtual chip."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from frogkick.cli.common import DepthOption, JsonOption, RobotFileOption, SeedOption, show

if TYPE_CHECKING:
    from frogkick.front.ring import Closing


def demo(
    out: Annotated[Path, typer.Option(help="Folder for all results.")] = Path("demo"),
    robot: RobotFileOption = "frog2022",
    states: Annotated[
        int | None,
        typer.Option(
            min=10,
            max=2000,
            help="Initial velocities of the library; default: as for the default table.",
            show_default=False,
        ),
    ] = None,
    depth: DepthOption = None,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Simulate, make tables, build the firmware and swim on the virtual chip.

    Then a limb is worn, the wear is identified from the runs, and new tables are made and tried.
    """
    from frogkick.front.ring import demonstrate

    ring, report = demonstrate(out, robot, states=states, depth=depth, seed=seed, progress=True)
    values = {**ring.as_json(), "report": str(report)}
    lines = [
        f"{name:8s} mean distance {1e3 * float(path['mean_distance_m']):5.1f} mm, "
        f"{path['decisions']} decisions, {'completed' if path['completed'] else 'not completed'}, "
        f"{path['mismatches']} mismatches between chip and twin"
        for name, path in values["paths"].items()
    ]
    if ring.closing is not None:
        lines += _closing_lines(ring.closing)
    show(values, json, "\n".join([*lines, f"report: {report.resolve()}"]))
    if not ring.passed:
        raise typer.Exit(1)


def _closing_lines(closing: Closing) -> list[str]:
    tested, found = closing.outcome.tested, [term.title for term in closing.outcome.terms]
    hidden = ", ".join(str(value) for value in closing.planted.values())
    lines = [
        f"hidden effect: {hidden}; verdict: {closing.outcome.verdict} ({', '.join(found) or 'no effect'})"
    ]
    lines += [
        f"{name:8s} {error} RMS one period ahead on the test run"
        for name, error in (("before", tested.before), ("after", tested.after), ("noise", tested.noise_floor))
    ]
    if closing.new:
        lines.append(
            f"worn robot: {1e3 * closing.distance_m(closing.old):.1f} mm from its paths with the old "
            f"firmware, {1e3 * closing.distance_m(closing.learned):.1f} mm with it while it learned, "
            f"{1e3 * closing.distance_m(closing.new):.1f} mm with the new"
        )
    return lines
