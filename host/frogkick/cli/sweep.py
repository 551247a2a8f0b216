"""``frogkick sweep``: every EGaIn fraction, frequency and phase offset, ranked."""

from __future__ import annotations

import csv
import io
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from frogkick.cli.common import ClusterOption, JsonOption, share_out, show
from frogkick.errors import InputError
from frogkick.files import require_writable, write_text
from frogkick.progress import progress_bar

if TYPE_CHECKING:
    from frogkick.study.paper_winners import Verdict
    from frogkick.study.sweep import Point, Sweep

_TOP = 10


def _numbers(text: str | None, option: str) -> list[float] | None:
    if text is None:
        return None
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise InputError(f"{option} is {text!r}: give numbers with commas between, as 0.4,0.5,0.6") from None


def _csv(points: Sequence[Point]) -> str:
    from frogkick.study.sweep import point_row

    buffer = io.StringIO()
    columns = ["egain_percent", "frequency_hz", "phase", "speed_mps", "cost_of_transport", "failure"]
    writer = csv.DictWriter(buffer, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(point_row(point) for point in points)
    return buffer.getvalue()


def _verdict_row(verdict: Verdict) -> dict[str, Any]:
    from frogkick.study.paper_winners import PAPER_PHASE, explain

    winner = verdict.winner
    return {
        "egain_percent": winner.design.egain_percent,
        "frequency_hz": winner.design.frequency_hz,
        "phase": PAPER_PHASE,
        "paper_speed_mps": winner.speed_mps,
        "paper_cost_of_transport": winner.cost_of_transport,
        "speed_mps": verdict.ours.speed_mps,
        "cost_of_transport": verdict.ours.cost_of_transport,
        "mean_speed_24_cycles_mps": verdict.mean_speed_mps,
        "rank_at_that_phase": verdict.rank,
        "rank_at_any_phase": verdict.rank_all_phases,
        "best_phase": verdict.best.gait.phase,
        "gained_there_mps": verdict.best.speed_mps - verdict.ours.speed_mps,
        "agrees": verdict.agrees,
        "why": explain(verdict),
    }


def _best(sweep: Sweep, phase: float | None = None) -> dict[str, list[dict[str, Any]]]:
    from frogkick.study.sweep import by_cost, by_speed, point_row, rank_designs

    return {
        "fastest": [point_row(point) for point in rank_designs(sweep, by_speed, phase)[:_TOP]],
        "most_efficient": [point_row(point) for point in rank_designs(sweep, by_cost, phase)[:_TOP]],
    }


def _result(sweep: Sweep, verdicts: Sequence[Verdict]) -> dict[str, Any]:
    from frogkick.study.paper_winners import PAPER_PHASE
    from frogkick.study.sweep import PHASE_TIE_MPS, by_cost, by_speed, energy_model, point_row, rank_gaits

    plan = sweep.plan
    result: dict[str, Any] = {
        "robot": plan.robot.id,
        "designs": len(plan.designs),
        "gaits": plan.gaits,
        **_best(sweep),
        "listed_phase": (
            f"nearest to half a cycle of those within {PHASE_TIE_MPS:g} m/s of the design's fastest phase"
        ),
        "fastest_gaits": [point_row(point) for point in rank_gaits(sweep, by_speed)[:_TOP]],
        "most_efficient_gaits": [point_row(point) for point in rank_gaits(sweep, by_cost)[:_TOP]],
    }
    if PAPER_PHASE in plan.phases:
        result[f"at_phase_{PAPER_PHASE:g}"] = _best(sweep, PAPER_PHASE)
    return {
        **result,
        "paper": [_verdict_row(verdict) for verdict in verdicts],
        "energy_model": energy_model(plan.robot),
        "interpolated": [
            {"egain_percent": d.egain_percent, "frequency_hz": d.frequency_hz}
            for d in sorted(plan.interpolated)
        ],
        "skipped": [{"case": skipped.case, "reason": skipped.reason} for skipped in plan.skipped],
        "failures": [point_row(point) for point in sweep.points if point.failure],
    }


def _lines(title: str, points: Sequence[Point]) -> list[str]:
    return [title] + [
        f"  {place}. {point.gait.egain_percent:g} % EGaIn, {point.gait.frequency_hz:g} Hz, phase "
        f"{point.gait.phase:g}: {1e3 * point.speed_mps:.1f} mm/s, cost of transport "
        f"{point.cost_of_transport:.0f}"
        for place, point in enumerate(points[:5], start=1)
    ]


def _text(sweep: Sweep, verdicts: Sequence[Verdict], out: Path) -> str:
    from frogkick.study.paper_winners import explain
    from frogkick.study.sweep import by_cost, by_speed, energy_model, rank_designs

    lines = _lines("fastest:", rank_designs(sweep, by_speed))
    lines += _lines("most efficient:", rank_designs(sweep, by_cost))
    for verdict in verdicts:
        design, fast = verdict.winner.design, verdict.winner.speed_mps is not None
        lines.append(
            f"the paper's {'fastest' if fast else 'most efficient'} {design.egain_percent:g} %, "
            f"{design.frequency_hz:g} Hz: rank {verdict.rank} here"
            f"{'' if verdict.agrees else ', which DISAGREES'}. {explain(verdict)}"
        )
    plan = sweep.plan
    lines += [f"interpolated limb profile: {design.name}" for design in sorted(plan.interpolated)]
    lines += [f"skipped {skipped.case}: {skipped.reason}" for skipped in plan.skipped]
    lines += [f"failed {point.gait}: {point.failure}" for point in sweep.points if point.failure]
    return "\n".join([*lines, energy_model(plan.robot), f"written to {out}"])


def _with_rate(bar: Callable[[int, int], None]) -> Callable[[int, int], None]:
    """Tell a bar, and where there is no terminal for it also the rate and the time left."""
    began, first = time.monotonic(), -1

    def tell(done: int, whole: int) -> None:
        nonlocal first
        bar(done, whole)
        if first < 0:
            first = done  # what an earlier start left was not done at this rate
        passed = time.monotonic() - began
        if done > first and passed > 0.0 and not sys.stderr.isatty():
            rate = (done - first) / passed
            print(f"  {rate:.1f} gaits/s, {(whole - done) / rate:.0f} s left", file=sys.stderr, flush=True)

    return tell


def sweep(
    out: Annotated[Path, typer.Option(help="Folder for results; a second start goes on in it.")],
    robot: Annotated[str, typer.Argument(help="TOML file or built-in name.")] = "frog2022",
    frequencies: Annotated[
        str | None, typer.Option(help="Hz, as 0.4,0.5; default: those measured for each fraction.")
    ] = None,
    phases: Annotated[int, typer.Option(min=1, max=1000, help="Phase offsets, evenly from 0.")] = 10,
    egain: Annotated[
        str | None, typer.Option(help="EGaIn fractions in %, as 10,30; default: the measured ones.")
    ] = None,
    workers: Annotated[int, typer.Option(min=0, max=256, help="Processes; 0 = one for each core.")] = 0,
    cluster: ClusterOption = None,
    json: JsonOption = False,
) -> None:
    """Simulate every EGaIn fraction, frequency and phase offset; rank by speed and by cost of transport.

    Limb profiles between measured ones are interpolated; designs outside of them are left out and listed.
    """
    from frogkick.report.sweep_page import write_sweep_report
    from frogkick.robot import load_robot
    from frogkick.study.paper_winners import paper_verdicts
    from frogkick.study.sweep import plan_sweep, run_sweep

    require_writable(out, folder=True)
    processes = share_out(workers, cluster)
    plan = plan_sweep(
        load_robot(robot), _numbers(frequencies, "--frequencies"), phases, _numbers(egain, "--egain")
    )
    began = time.perf_counter()
    with progress_bar("sweep: gaits") as progress:
        swept = run_sweep(plan, out, processes, _with_rate(progress), cluster)
    verdicts = paper_verdicts(swept)
    write_text(out / "sweep.csv", _csv(swept.points))
    files = [out / "sweep.csv", *write_sweep_report(out, swept, verdicts)]
    result = _result(swept, verdicts)
    result["files"] = [str(file) for file in files]
    result["wall_s"] = round(time.perf_counter() - began, 3)
    show(result, json, _text(swept, verdicts, out))
    if result["failures"]:
        raise typer.Exit(1)


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(sweep)
