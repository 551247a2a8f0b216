"""``frogkick sweep``: every EGaIn fraction, frequency and phase offset, ranked."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from frogkick.cli.common import ClusterOption, JsonOption, RobotArgument, WorkersOption, local_processes, show
from frogkick.core.errors import InputError
from frogkick.core.files import require_writable
from frogkick.core.progress import progress_bar, tell_line

if TYPE_CHECKING:
    from frogkick.front.gaits import Point, Swept


def _numbers(text: str | None, option: str) -> list[float] | None:
    if text is None:
        return None
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise InputError(
            f"{option} is {text!r}: give numbers separated by commas, such as 0.4,0.5,0.6"
        ) from None


def _lines(title: str, points: Sequence[Point]) -> list[str]:
    return [title] + [
        f"  {place}. {point.gait.egain_percent:g} % EGaIn, {point.gait.frequency_hz:g} Hz, phase "
        f"{point.gait.phase:g}: {1e3 * point.speed_mps:.1f} mm/s, cost of transport "
        f"{point.cost_of_transport:.0f}"
        for place, point in enumerate(points[:5], start=1)
    ]


def _text(swept: Swept, out: Path) -> str:
    lines = _lines("fastest:", swept.fastest)
    lines += _lines("most efficient:", swept.most_efficient)
    for verdict in swept.verdicts:
        design, fast = verdict.winner.design, verdict.winner.speed_mps is not None
        lines.append(
            f"the paper's {'fastest' if fast else 'most efficient'} {design.egain_percent:g} %, "
            f"{design.frequency_hz:g} Hz: rank {verdict.rank} here"
            f"{'' if verdict.agrees else ', which DISAGREES'}. {verdict.why}"
        )
    plan = swept.sweep.plan
    lines += [f"interpolated limb profile: {design.name}" for design in sorted(plan.interpolated)]
    lines += [f"skipped {skipped.case}: {skipped.reason}" for skipped in plan.skipped]
    lines += [f"failed {point.gait}: {point.failure}" for point in swept.points if point.failure]
    return "\n".join([*lines, swept.energy_model, f"written to {out}"])


def _with_rate(bar: Callable[[int, int], None]) -> Callable[[int, int], None]:
    """Update a progress bar; without a terminal, also print the rate and the time left."""
    began, first = time.monotonic(), -1

    def update(done: int, whole: int) -> None:
        nonlocal first
        bar(done, whole)
        if first < 0:
            first = done  # results of an earlier start do not count for the rate
        passed = time.monotonic() - began
        if done > first and passed > 0.0 and not sys.stderr.isatty():
            rate = (done - first) / passed
            tell_line(f"  {rate:.1f} gaits/s, {(whole - done) / rate:.0f} s left")

    return update


def sweep(
    out: Annotated[Path, typer.Option(help="Folder for the results; an interrupted sweep resumes there.")],
    robot: RobotArgument = "frog2022",
    frequencies: Annotated[
        str | None,
        typer.Option(help="Frequencies in Hz, such as 0.4,0.5; default: those measured for each fraction."),
    ] = None,
    phases: Annotated[
        int, typer.Option(min=1, max=1000, help="Number of phase offsets, evenly spaced from 0.")
    ] = 10,
    egain: Annotated[
        str | None, typer.Option(help="EGaIn fractions in %, such as 10,30; default: the measured ones.")
    ] = None,
    workers: WorkersOption = 0,
    cluster: ClusterOption = None,
    json: JsonOption = False,
) -> None:
    """Simulate every EGaIn fraction, frequency and phase offset, and rank by speed and cost of transport.

    Limb profiles between the measured ones are interpolated. Designs outside their range are left out and
    listed.
    """
    from frogkick.front.gaits import sweep as run

    require_writable(out, folder=True)
    processes = local_processes(workers, cluster)
    designs = {
        "frequencies_hz": _numbers(frequencies, "--frequencies"),
        "egain_percent": _numbers(egain, "--egain"),
    }
    began = time.perf_counter()
    with progress_bar("sweep: gaits") as bar:
        swept = run(
            robot,
            **designs,
            phases=phases,
            out=out,
            workers=processes,
            cluster=cluster,
            progress=_with_rate(bar),
        )
    files = swept.save(out)
    result = swept.as_json()
    result["files"] = [str(file) for file in files]
    result["wall_s"] = round(time.perf_counter() - began, 3)
    show(result, json, _text(swept, out))
    if result["failures"]:
        raise typer.Exit(1)
