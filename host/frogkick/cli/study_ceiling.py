"""``frogkick study ceiling``: tables against the rods themselves in the loop."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from frogkick.cli.common import JsonOption, show, write_picture
from frogkick.errors import InputError
from frogkick.files import require_writable
from frogkick.progress import progress_bar

if TYPE_CHECKING:
    from frogkick.study.ceiling import Mean, Run

_DepthsOption = Annotated[
    list[int] | None, typer.Option("--depth", min=1, max=3, help="Strokes to look ahead; may be repeated.")
]
_MEASURES = ("mean_distance_m", "progress_mps")


TIME_LIMIT_S = 120.0
"""That of frogkick.study.ceiling: a command's help loads nothing of it."""


def ceiling(
    library: Annotated[Path, typer.Argument(help="HDF5 file of 'library build', the larger the better.")],
    tables: Annotated[
        Path | None, typer.Option(help="Robot's own table; default: affine, 64 KiB, of that library.")
    ] = None,
    seeds: Annotated[int, typer.Option(min=1, max=1000, help="Runs of each, by noise and start.")] = 8,
    depth: _DepthsOption = None,
    simulated_time: Annotated[float, typer.Option(help="Longest pool time of a run, s.")] = TIME_LIMIT_S,
    workers: Annotated[int, typer.Option(min=0, max=256, help="Processes; 0: one for each core.")] = 0,
    out: Annotated[Path | None, typer.Option(help="Picture to write (PNG).")] = None,
    json: JsonOption = False,
) -> None:
    """One planner in the pool, told by a full nearest table, by the robot's, or by the rods themselves.

    Each --depth that the rods look further takes as many times longer as the robot has actions.
    """
    from frogkick.library import fit_table, quantise, read_library
    from frogkick.library.fitting import BUDGET_BYTES, require_enough
    from frogkick.loop.closed_loop import require_time
    from frogkick.paths import SHAPES
    from frogkick.planner.image import read_image
    from frogkick.report.ceiling_figure import ceiling_figure
    from frogkick.study.ceiling import AFFINE, NEAREST, SOURCES, follow_paths, rms_error

    require_writable(out)
    require_time(simulated_time)
    content = read_library(library)
    robot = content.robot()
    if tables is None:
        require_enough(content)
        with progress_bar("robot's table") as progress:
            own = fit_table(content, "affine", BUDGET_BYTES, progress).image
    else:
        opened = read_image(tables)
        opened.require_robot(robot.id)
        if opened.period_us != round(robot.period_s * 1e6) or len(opened.actions) != len(robot.actions):
            raise InputError(
                f"table {tables.name!r} has another period or other actions than the robot of library "
                f"{library.name!r}: build it from a library of this robot"
            )
        own = opened.image
    images = {NEAREST: quantise(content), AFFINE: own}
    depths = sorted(set(depth or (1, 2)))
    processes = workers or os.cpu_count() or 1
    with progress_bar("runs") as progress:
        runs = follow_paths(robot, images, list(SHAPES), depths, seeds, simulated_time, processes, progress)
    if out is not None:
        write_picture(ceiling_figure(runs), out)
    rows = [
        _row(runs, path, source, levels)
        for levels in depths
        for path in (*SHAPES, None)
        for source in SOURCES
    ]
    ahead = {
        source: {of: rms_error([r for r in runs if r.source == source], of) for of in ("told", "planned")}
        for source in SOURCES
    }
    values = {
        "rows": rows,
        "further_than_rods_m": [
            _beside_rods(runs, source, d) for d in depths for source in (NEAREST, AFFINE)
        ],
        "one_stroke_ahead": ahead,
        "table_bytes": {name: len(image) for name, image in images.items()},
        "seeds": seeds,
    }
    show(values, json, _text(values))


def _row(runs: Sequence[Run], path: str | None, source: str, depth: int) -> dict[str, Any]:
    """One path's runs; without a path those of all, a mean for each seed."""
    from frogkick.study.ceiling import mean_of, over_seeds

    mine = [r for r in runs if (r.source, r.depth) == (source, depth) and path in (None, r.path)]
    means: dict[str, Mean] = {
        name: over_seeds(mine, name) if path is None else mean_of([getattr(r, name) for r in mine])
        for name in _MEASURES
    }
    return {
        "path": path or "all",
        "source": source,
        "depth": depth,
        **{name: dataclasses.asdict(mean) for name, mean in means.items()},
        "completed": sum(r.completed for r in mine) / len(mine),
        "decisions": sum(len(r.planned) for r in mine),
    }


def _beside_rods(runs: Sequence[Run], source: str, depth: int) -> dict[str, Any]:
    """How much further from the paths a source's runs are than those of the rods, seed by seed."""
    from frogkick.study.ceiling import RODS, more_than

    mine, rods = ([r for r in runs if (r.source, r.depth) == (each, depth)] for each in (source, RODS))
    mean = more_than(mine, rods, "mean_distance_m")
    return {"source": source, "depth": depth, **dataclasses.asdict(mean)}


def _text(values: dict[str, Any]) -> str:
    lines = []
    for row in values["rows"]:
        far, fast = row["mean_distance_m"], row["progress_mps"]
        lines.append(
            f"depth {row['depth']} {row['path']:8s} {row['source']:8s} "
            f"{1e3 * far['value']:6.2f} +- {1e3 * far['half_width']:4.2f} mm, "
            f"{1e3 * fast['value']:5.1f} +- {1e3 * fast['half_width']:3.1f} mm/s, "
            f"{100 * row['completed']:3.0f} % completed"
        )
    for more in values["further_than_rods_m"]:
        lines.append(
            f"depth {more['depth']} {more['source']:8s} further from the paths than the rods by "
            f"{1e3 * more['value']:.2f} +- {1e3 * more['half_width']:.2f} mm"
        )
    for source, errors in values["one_stroke_ahead"].items():
        told, planned = (
            f"{1e3 * error['position_m']:.3f} mm, {math.degrees(error['heading_rad']):.3f} degrees"
            for error in (errors["told"], errors["planned"])
        )
        lines.append(f"one stroke ahead {source:8s} of the true state {told}; as planned {planned}")
    return "\n".join(lines)


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(ceiling)
