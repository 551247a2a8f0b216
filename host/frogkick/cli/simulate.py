"""``frogkick simulate``: a robot's swim in the rod simulation."""

from __future__ import annotations

import io
import math
from pathlib import Path
from typing import Annotated, Any

import typer

import frogkick as fk
from frogkick.cli.common import JsonOption, RobotArgument, show
from frogkick.core.errors import InputError
from frogkick.core.files import require_writable, write_text
from frogkick.core.progress import progress_bar


def _velocity(text: str) -> tuple[float, float, float]:
    parts = text.split(",")
    try:
        values = [float(part) for part in parts]
    except ValueError:
        values = []
    if len(values) != 3 or not all(map(math.isfinite, values)):
        raise InputError(
            f"--initial-velocity is {text!r}: give VX,VY,OMEGA (forward m/s, left m/s, rad/s), e.g. 0.02,0,0"
        )
    return values[0], values[1], values[2]


def _write_csv(target: Path, swum: fk.Trajectory) -> None:
    import numpy as np

    buffer = io.StringIO()
    columns = np.column_stack([swum.time_s, swum.pose_world])
    np.savetxt(buffer, columns, fmt="%.9g", delimiter=",", header="time_s,x_m,y_m,heading_rad", comments="")
    write_text(target, buffer.getvalue())


def simulate(
    robot: RobotArgument = "frog2022",
    egain_percent: Annotated[
        float | None, typer.Option(help="EGaIn fraction of the limbs in a gait, %.")
    ] = None,
    frequency_hz: Annotated[float | None, typer.Option(help="Strokes per second of a gait.")] = None,
    phase: Annotated[
        float, typer.Option(help="Lag of the rear limbs as a fraction of the period, 0 to 1.")
    ] = 0.5,
    cycles: Annotated[int, typer.Option(min=1, max=200, help="Number of cycles of the gait.")] = 8,
    actions: Annotated[
        str | None, typer.Option(help="Names of the actions in their order, such as B,B,C or kick,glide.")
    ] = None,
    initial_velocity: Annotated[str, typer.Option(help="VX,VY,OMEGA: forward, left m/s, rad/s.")] = "0,0,0",
    out: Annotated[
        Path | None, typer.Option(help="CSV file to write, with time_s, x_m, y_m, heading_rad.")
    ] = None,
    animation: Annotated[Path | None, typer.Option(help="Animation to write (.gif or .mp4).")] = None,
    json: JsonOption = False,
) -> None:
    """Simulate a gait or a sequence of actions of a robot."""
    described = fk.load_robot(robot)
    require_writable(out)
    if out is not None and out.suffix.lower() not in (".csv", ".txt", ""):
        raise InputError(
            f"--out {str(out)!r} ends in {out.suffix!r}, but a swim is written as CSV: give a name in .csv"
        )
    if animation is not None:
        from frogkick.report.animation import require_animation_name

        require_animation_name(animation)
        require_writable(animation)
    egain = described.egain_percent if egain_percent is None else egain_percent
    frequency = described.profile_frequency_hz if frequency_hz is None else frequency_hz
    if actions is not None and (egain_percent is not None or frequency_hz is not None):
        raise InputError(
            "--actions uses the robot's own profile: leave out --egain-percent and --frequency-hz"
        )
    begin = (0.0, 0.0, 0.0) if actions is None else _velocity(initial_velocity)
    result = fk.simulate(
        described,
        actions,
        velocity_body=begin,
        egain_percent=egain_percent,
        frequency_hz=frequency_hz,
        phase=phase,
        cycles=cycles,
    )
    if out is not None:
        _write_csv(out, result)
    animated: dict[str, Any] = {}
    if animation is not None:
        from frogkick.report.animation import actions_swim, gait_swim, write_animation

        if actions is not None:
            from frogkick.front.swimming import actions_of

            swim = actions_swim(described, actions_of(described, actions), begin)
        else:
            swim = gait_swim(described, egain, frequency, phase, cycles)
        with progress_bar("animation") as progress:
            animated["animation"] = write_animation(swim, animation, progress)
    show(
        {
            "speed_mps": result.speed_mps,
            "distance_m": result.distance_m,
            # Without forward motion it is infinite, which JSON cannot hold.
            "cost_of_transport": result.cost_of_transport
            if math.isfinite(result.cost_of_transport)
            else None,
            **animated,
        },
        json,
    )
