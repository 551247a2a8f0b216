"""``frogkick run``: follow a path in closed loop."""

from __future__ import annotations

import enum
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

import frogkick as fk
from frogkick.cli.common import JsonOption, SeedOption, say, show
from frogkick.cli.keys import keys_of
from frogkick.cli.options import DepthOption, KeyOption, PlannerName, PlannerOption, TablesOption

WorldOption = Annotated[
    Path | None, typer.Option(help="TOML of effects that are true in the pool and no model knows.")
]


class PlanWhere(enum.StrEnum):
    """Who decides."""

    onboard = "onboard"
    host = "host"
    both = "both"


def run(
    robot: Annotated[
        str,
        typer.Option(
            help="virtual: firmware on the virtual chip; pool: the core here; real: ble:NAME, serial:PORT."
        ),
    ] = "virtual",
    plan: Annotated[
        PlanWhere,
        typer.Option(help="Who decides: the robot, the host, or the robot checked live by the host."),
    ] = PlanWhere.onboard,
    path: Annotated[
        str,
        typer.Option(
            help="line, sine, ellipse, circle, bends, eight, or a CSV file: columns x, y in m (and dx, dy or "
            "tangent_rad), 100 points (more are resampled), 50 m at most."
        ),
    ] = "line",
    planner: PlannerOption = PlannerName.robot,
    depth: DepthOption = None,
    tables: TablesOption = None,
    model: Annotated[str | None, typer.Option(help="Robot TOML or name; default: the table's robot.")] = None,
    simulated_time: Annotated[
        float, typer.Option(help="Longest pool time, s; real for a real robot.")
    ] = 120.0,
    fix_rate: Annotated[float, typer.Option(help="Position fixes per second, simulated.")] = 15.0,
    fixes: Annotated[
        str | None,
        typer.Option(
            help="A real robot's: camera.toml of 'camera calibrate', or stdin = a tracker's lines "
            "'x_m y_m heading_rad [age_s]'; pool = simulated, for a kit without limbs."
        ),
    ] = None,
    source: Annotated[
        str, typer.Option(help="The camera of --fixes camera.toml: number, video, folder of pictures.")
    ] = "0",
    begin: Annotated[
        str | None, typer.Option(help="A real robot's path begins at X,Y,DEG (m, degrees), or here.")
    ] = None,
    dialect: Annotated[
        str, typer.Option(help="A real robot's: frogkick, or frog2022 = the authors' firmware, as text.")
    ] = "frogkick",
    world: WorldOption = None,
    seed: SeedOption = 0,
    out: Annotated[Path | None, typer.Option(help="Log to write (HDF5).")] = None,
    view: Annotated[
        bool,
        typer.Option(
            "--view",
            help="Draw the run in the browser, over a camera's picture; simulated ones in real time.",
        ),
    ] = False,
    video: Annotated[
        bool, typer.Option("--video", help="Keep the camera's pictures beside --out: .avi, .frames.csv.")
    ] = False,
    battery_v: Annotated[
        float | None,
        typer.Option(help="Of a real robot's lowest battery, measured by hand at rest; too low is refused."),
    ] = None,
    key: KeyOption = None,
    yes: Annotated[bool, typer.Option("--yes", help="Arm a real robot without asking for Enter.")] = False,
    json: JsonOption = False,
) -> None:
    """Follow a path: position fixes in, strokes out. Exit 1 if the guard's limits were broken, robot and
    host decide differently (--plan both), or the robot gets nowhere along its path.

    At a terminal a real robot is armed by Enter, and any key stops the run. However it ends, the robot is
    disarmed first.
    """
    found = fk.run(
        tables,
        path,
        robot=robot,
        model=model,
        world=world,
        plan=plan.value,
        planner=planner.value,
        depth=depth,
        seed=seed,
        time_limit_s=simulated_time,
        fix_rate_hz=fix_rate,
        fixes=fixes,
        source=source,
        begin=begin,
        dialect=dialect,
        battery_v=battery_v,
        key=key,
        operator=partial(keys_of, ask=not yes),
        out=out,
        view=view,
        video=video,
        progress=True,
    )
    show(found.as_json(), json)
    if found.tracking.stood:
        say(
            f"after {found.tracking.decisions} decisions the robot is no farther along the path, "
            f"{1e3 * found.tracking.mean_distance_m:.0f} mm beside it on average: "
            "does the path begin where the robot is, and point where it can go?"
        )
    if found.tracking.limit_violations or found.tracking.stood:
        raise typer.Exit(1)


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(run)
