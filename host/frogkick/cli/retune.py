"""``frogkick retune``: tables that know what has changed in a robot, from its last runs."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from frogkick.cli.common import JsonOption, SeedOption, say, say_left_out, show
from frogkick.cli.identify import horizon_line
from frogkick.cli.push import text_of
from frogkick.errors import FrogkickError, InputError
from frogkick.files import require_writable
from frogkick.progress import progress_bar

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from frogkick.identification.retune import Retuned
    from frogkick.identification.tables import Stage, Tracked
    from frogkick.loop.pushing import Pushed
    from frogkick.robot import Robot

STATES = 800
SAMPLING = "visited"
KIND = "affine"
LOOP_PATHS, LOOP_SEEDS = ("line", "sine", "ellipse"), 2
STATES_LEAST = 46
"""WHOLE_MIN of frogkick.library.fitting: a command's help loads nothing of it."""


@dataclass(frozen=True)
class _Tools:
    """Tables of so many states by so many processes; see frogkick.identification.tables.Tools."""

    count: int
    seed: int
    workers: int

    def tables(self, robot: Robot, library: Path, stage: Stage) -> bytes:
        from frogkick.library import build_library, fit_table, read_library

        with stage(f"library of {self.count} states") as progress:
            build_library(
                robot, self.count, self.seed, self.workers, library, progress, SAMPLING, record_s=0.0
            )
        with stage("tables tried") as progress:
            return fit_table(read_library(library), KIND, progress=progress).image

    def states(self, image: bytes) -> int:
        from frogkick.planner.image import open_image

        return len(open_image(image).states)

    def looked_up(
        self, image: bytes, velocity_body: NDArray[np.float64], previous: NDArray[np.int64]
    ) -> NDArray[np.float64]:
        from frogkick.library.error import looked_up
        from frogkick.planner.image import open_image

        return looked_up(open_image(image), velocity_body, previous)

    def tracked(self, tables: Path, robot: Robot, progress: Callable[[int, int], None]) -> Tracked:
        import numpy as np

        from frogkick.effects import World, effects_of
        from frogkick.front.places import built_firmware
        from frogkick.identification.tables import Tracked
        from frogkick.planner.image import read_image
        from frogkick.study.trial import trials

        with built_firmware("native", tables, robot) as built:
            runs = trials(
                built.image,
                read_image(tables),
                robot,
                lambda: World(effects_of(robot)),
                LOOP_PATHS,
                LOOP_SEEDS,
                progress=progress,
            )
        numbers = [run.tracking for run in runs]
        return Tracked(
            float(np.mean([each.mean_distance_m for each in numbers])),
            float(np.mean([each.progress_mps for each in numbers])),
            sum(each.completed for each in numbers),
            len(numbers),
        )

    def firmware(self, tables: Path, robot: Robot, out: Path) -> Mapping[str, Any]:
        from frogkick_codegen.firmware import build as build_firmware

        built = build_firmware("bench", tables, robot, out)
        return {"image": built.image.name, "flash_bytes": built.flash_bytes, "ram_bytes": built.ram_bytes}


def command(
    runs: Annotated[
        list[Path],
        typer.Argument(help="The robot's last runs: logs, or recorded runs (.csv). Last: to judge."),
    ],
    robot: Annotated[str, typer.Option(help="Robot TOML or name that its tables were made from.")],
    out: Annotated[Path, typer.Option(help="New folder for robot, library, tables and firmware.")],
    tables: Annotated[
        Path | None,
        typer.Option(help="Table image that it carries (.fkt), to compare with; default: made from --robot."),
    ] = None,
    states: Annotated[
        int, typer.Option(min=STATES_LEAST, max=65535, help="States of the libraries that are simulated.")
    ] = STATES,
    workers: Annotated[int, typer.Option(min=0, max=256, help="Processes; 0 = one for each core.")] = 0,
    push: Annotated[
        str | None,
        typer.Option(
            metavar="TARGET", help="Send better tables to ble:NAME, serial:PORT or virtual; it keeps the old."
        ),
    ] = None,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Make a worn robot new tables. Exit 1 where they are no better on held-out periods or runs too short."""
    from frogkick.front.places import robot_of_table
    from frogkick.front.robots import VIRTUAL, require_target
    from frogkick.identification.retune import TABLES, require_new, retune
    from frogkick.identification.swim import read_swim, reliable
    from frogkick.planner.image import read_image
    from frogkick.robot import load_robot
    from frogkick_codegen.firmware import require_tools

    if push is not None:
        require_target(push, (VIRTUAL,))
    require_tools("bench")
    require_writable(out, folder=True)
    require_new(out)
    described = load_robot(robot)
    swims, left_out = reliable([read_swim(path, described) for path in runs])
    say_left_out(left_out)
    old = None
    if tables is not None:
        opened = read_image(tables)
        robot_of_table(tables, robot)
        if opened.period_us != round(described.period_s * 1e6):
            raise InputError(
                f"table {tables.name!r} has a period of {opened.period_us * 1e-6:.3f} s, robot "
                f"{described.id!r} {described.period_s:.3f} s: give the robot's own"
            )
        old = opened.image
    tools = _Tools(states, seed, workers or os.cpu_count() or 1)
    result = retune(swims, described, out, tools, progress_bar, old)
    pushed, failed = _pushed(push, result, out)
    told = {
        **result.as_json(),
        "out": str(out) if result.tables else None,
        "pushed": None,
        "left_out": left_out,
    }
    if pushed is not None:
        told |= {"bytes_sent": pushed.bytes_sent, "pushed": pushed.as_json()}
    lines = [
        _text(result, out),
        *([text_of(pushed, push)] if push is not None and pushed is not None else []),
    ]
    show(told, json, "\n".join(lines))
    if failed is not None:
        raise InputError(
            f"the new tables are made, and not sent: {failed}; then send them by 'frogkick push "
            f"{out / TABLES} --robot {push}'"
        ) from failed
    if result.reason and not result.done:
        say(result.reason)
    if not result.done:
        raise typer.Exit(1)


def _pushed(target: str | None, result: Retuned, out: Path) -> tuple[Pushed | None, FrogkickError | None]:
    """Send tables that are better, and only those; or why that failed. What was made stays either way."""
    from frogkick.front.robots import push_table
    from frogkick.identification.retune import BEFORE, TABLES

    if target is None or not result.better:
        return None, None
    try:
        return push_table(target, out / TABLES, out / BEFORE, progress=True), None
    except FrogkickError as error:
        return None, error


def _text(result: Retuned, out: Path) -> str:
    import numpy as np

    lines = [f"verdict: {result.outcome.verdict}", f"held out: {result.held_out}"]
    for term, row in zip(result.outcome.terms, result.outcome.parameters, strict=True):
        values = ", ".join(f"{p.name} {p.value:.4g} [{p.low:.4g}, {p.high:.4g}] {p.unit}" for p in row)
        lines.append(f"effect {term.title}: {values}")
    for name, error in (("old", result.before), ("new", result.after)):
        if error.count:
            lines.append(
                f"{name} tables: {1e3 * error.position_rmse_m:.2f} mm, "
                f"{np.degrees(error.heading_rmse_rad):.2f} deg RMS a period ahead ({error.count} periods)"
            )
    if result.loop is not None:
        for name, tracked in zip(("old", "new"), result.loop, strict=True):
            lines.append(
                f"{name} tables in closed loop, in a simulated pool with what was found: "
                f"{1e3 * tracked.mean_distance_m:.1f} mm from the path, "
                f"{1e3 * tracked.progress_mps:.1f} mm/s along it, "
                f"{tracked.completed} of {tracked.runs} runs completed"
            )
    lines += [f"tables, {horizon_line(each)}" for each in result.horizons if each.periods > 1]
    if result.done and result.reason:
        lines.append(result.reason)
    if result.better and result.tables is not None:
        lines.append(f"new tables: {result.tables['file']}, firmware: {out / 'firmware'}")
        lines.append(f"old tables, to go back to: {out / 'before.fkt'}")
    return "\n".join(lines)


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command(name="retune")(command)
