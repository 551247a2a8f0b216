"""``frogkick study ceiling``: tables against the rods themselves in the loop."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import typer

from frogkick.cli.common import JsonOption, show, write_picture
from frogkick.core.files import require_writable

_DepthsOption = Annotated[
    list[int] | None, typer.Option("--depth", min=1, max=3, help="Strokes to look ahead; may be repeated.")
]


TIME_LIMIT_S = 120.0
"""That of frogkick_studies.ceiling: a command's help loads nothing of it."""


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
    from frogkick_studies.input_studies import study_ceiling

    require_writable(out)
    found = study_ceiling(
        library,
        tables=tables,
        depths=depth or (1, 2),
        seeds=seeds,
        time_limit_s=simulated_time,
        workers=workers or None,
        progress=True,
    )
    if out is not None:
        write_picture(found.plot(), out)
    values = found.as_json()
    show(values, json, _text(values))


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
