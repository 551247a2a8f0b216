"""``frogkick parity``, ``validate``, ``sweep``: tests of the bits and of the model; ``study``: of the method.

Studies are part of a clone of the project, next to the package, and not of the wheel.
"""

from __future__ import annotations

import importlib
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import MISSING, fields
from inspect import Parameter, Signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_origin, get_type_hints

import typer

from frogkick.cli import options as opt
from frogkick.cli.common import Result, require_one_place, save
from frogkick.core.errors import InputError
from frogkick.core.files import require_writable
from frogkick.core.progress import progress_bar, tell_line
from frogkick.report.style import write_picture

if TYPE_CHECKING:
    from frogkick.front.gaits import Point, Swept

LOOP_DECISIONS = 200
"""The value of frogkick.front.parity, repeated so that a command's help does not load that module."""


def parity(
    states: Annotated[int, "Number of states for Python and native C.", opt.With(10, 10_000_000)] = 100_000,
    chip_states: Annotated[
        int | None,
        "How many of the states the virtual chip decides as well.  [default: all]",
        opt.With(0, 10_000_000),
    ] = None,
    loop_decisions: Annotated[
        int, "Number of decisions of the closed-loop run, from fixes to decisions.", opt.With(0, 100_000)
    ] = LOOP_DECISIONS,
    tables: opt.Tables = None,
    model: opt.Model = None,
    planner: opt.Planner = opt.PlannerName.paper,
    depth: opt.Depth = None,
    seed: opt.Seed = 0,
) -> Result:
    """Make the same decisions in Python, in native C and on the virtual chip, and count differing bits.

    Single decisions start from states of every kind, at depth 1 to 4. A closed-loop run follows at --depth.
    Native C is compiled by zig's clang (native), and by gcc if this machine has it. The exit code is 1 if a
    bit differs.
    """
    from frogkick.front.parity import compare_places

    found = opt.call(compare_places, locals(), table=tables, robot=model, progress=True)
    return Result(found.as_json(), passed=found.same)


def _compared(result: dict[str, Any]) -> list[str]:
    shape, authors, floor = (
        result[key] for key in ("within_cycle_rms_mm", "authors_rmse_mps", "noise_floor_mps")
    )
    lines = [f"profiles: {result['profiles']}"]
    for group, rmse in result["rmse_mps"].items():
        line = f"{group}: speed RMSE {1e3 * rmse:.2f} mm/s"
        if group in shape:
            line += f", within a cycle {shape[group]:.2f} mm RMS"
        if group in authors:
            line += f"; the authors' simulation {1e3 * authors[group]:.2f}"
        if group in floor:
            line += f", noise floor {1e3 * floor[group]:.2f}"
        lines.append(line)
    for asked in (*result["requirements"], *result["groups_above_limit"]):
        verdict = "held" if asked["held"] else "MISSED"
        lines.append(
            f"limit {verdict}: {asked['what']} of {asked['group']} {asked['value']:.3g}, "
            f"limit {asked['limit']:.3g}"
        )
    if result["left_out"]:
        lines += [
            f"{part['egain_percent']:g} % EGaIn, with constants matched only to the others: speed RMSE "
            f"{1e3 * part['left_out_rmse_mps']:.2f} mm/s, on the others {1e3 * part['matched_rmse_mps']:.2f}"
            for part in result["left_out"]["parts"]
        ]
        lines += [
            f"{group}, each fraction held out: speed RMSE {1e3 * rmse:.2f} mm/s, within a cycle "
            f"{result['left_out']['within_cycle_rms_mm'][group]:.2f} mm RMS"
            for group, rmse in result["left_out"]["rmse_mps"].items()
        ]
    if any(group.startswith("experiments") for group in floor):
        lines.append(f"noise floor: {result['noise']['method']}")
    return lines + [f"skipped {skipped['case']}: {skipped['reason']}" for skipped in result["skipped"]]


def validate(
    data_dir: Annotated[Path, typer.Argument(help="Folder of the paper's data: sim/, exp/, profile/.")],
    robot: opt.RobotFile = "frog2022-sim",
    report: Annotated[Path | None, "HTML report to write."] = None,
    left_out: Annotated[
        bool, "Match the robot's constants again with each EGaIn fraction held out; this takes minutes."
    ] = False,
    workers: opt.Workers = 0,
    check: Annotated[bool, typer.Option(help="Exit with code 1 if a limit is exceeded.")] = False,
) -> Result:
    """Compare the model with every simulation and measured swim of a data folder.

    All are compared with one parameter set. Limb profiles come from the folder's own files if it has them.
    Constants that no paper gives were matched to these simulations. --left-out shows the errors on fractions
    that the constants were not matched to.
    """
    from frogkick.front.gaits import validate as compare

    began = time.perf_counter()
    found = compare(data_dir, robot, left_out=left_out, workers=workers or None, progress=True)
    result = found.as_json()
    if report is not None:
        save(found.report, report)
        result["report"] = str(report)
    result["wall_s"] = round(time.perf_counter() - began, 3)
    return Result(result, _compared(result), passed=not check or found.held)


def _numbers(text: str | None, option: str) -> list[float] | None:
    if text is None:
        return None
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise InputError(
            f"{option} is {text!r}: give numbers separated by commas, such as 0.4,0.5,0.6"
        ) from None


def _ranks(title: str, points: Sequence[Point]) -> list[str]:
    return [title] + [
        f"  {place}. {point.gait.egain_percent:g} % EGaIn, {point.gait.frequency_hz:g} Hz, phase "
        f"{point.gait.phase:g}: {1e3 * point.speed_mps:.1f} mm/s, {point.cost_text}"
        for place, point in enumerate(points[:5], start=1)
    ]


def _ranked(swept: Swept, out: Path) -> list[str]:
    lines = _ranks("fastest:", swept.fastest)
    lines += _ranks("most efficient:", swept.most_efficient)
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
    return [*lines, swept.energy_model, f"written to {out}"]


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
    out: Annotated[
        Path, "Folder for the results; an interrupted sweep resumes there.", opt.With(folder=True)
    ],
    robot: opt.RobotArgument = "frog2022",
    frequencies: Annotated[
        str | None, "Frequencies in Hz, such as 0.4,0.5; default: those measured for each fraction."
    ] = None,
    phases: Annotated[int, "Number of phase offsets, evenly spaced from 0.", opt.With(1, 1000)] = 10,
    egain: Annotated[str | None, "EGaIn fractions in %, such as 10,30; default: the measured ones."] = None,
    workers: opt.Workers = 0,
    cluster: opt.Cluster = None,
) -> Result:
    """Simulate every EGaIn fraction, frequency and phase offset, and rank by speed and cost of transport.

    Limb profiles between the measured ones are interpolated. Designs outside their range are left out and
    listed.
    """
    from frogkick.front.gaits import sweep as run

    require_one_place(workers, cluster)
    designs = {
        "frequencies_hz": _numbers(frequencies, "--frequencies"),
        "egain_percent": _numbers(egain, "--egain"),
    }
    began = time.perf_counter()
    with progress_bar("sweep: gaits") as bar:
        swept = opt.call(run, locals(), **designs, progress=_with_rate(bar))
    files = swept.save(out)
    result = swept.as_json()
    result["files"] = [str(file) for file in files]
    result["wall_s"] = round(time.perf_counter() - began, 3)
    return Result(result, _ranked(swept, out), passed=not result["failures"])


SHARED: dict[tuple[str, str], Any] = {
    ("seed", "int"): opt.Seed,
    ("depth", "int | None"): opt.Depth,
    ("model", "str | None"): opt.Model,
    ("robot", "str | None"): opt.Nominal,
    ("robot", "str"): opt.RobotFile,
    ("planner", "str"): opt.Planner,
    ("tables", "Path | None"): opt.Tables,
    ("workers", "int"): opt.Workers,
    ("swims", "str"): opt.Unseen,
}
"""The shared options, by the name and type of a configuration's field."""


def command(name: str) -> Callable[..., Result]:
    """Return the command of a study; its options are the fields of the study's configuration.

    Raises:
        InputError: frogkick was installed without the studies.
    """
    folder = Path(__file__).parents[2] / "studies"
    if not (folder / "frogkick_studies").is_dir():
        raise InputError(
            "the studies are part of a clone of the project, not of the wheel: run them in a clone"
        )
    if str(folder) not in sys.path:
        sys.path.append(str(folder))
    config = importlib.import_module("frogkick_studies.configs").STUDIES[name]
    hints = get_type_hints(config, include_extras=True)
    parameters = [
        Parameter(
            field.name,
            Parameter.KEYWORD_ONLY,
            default=Parameter.empty if field.default is MISSING else field.default,
            annotation=hints[field.name]
            if get_origin(hints[field.name]) is Annotated
            else SHARED[field.name, str(field.type)],
        )
        for field in fields(config)
    ]

    def run(**given: Any) -> Result:
        chosen = config(**given)
        out: Path | None = getattr(chosen, "out", None)
        require_writable(out, folder=chosen.folder)
        for option, value in given.items():
            for file in value if isinstance(value, list | tuple) else [value]:
                if option != "out" and isinstance(file, Path) and not file.exists():
                    raise InputError(
                        f"{option.replace('_', ' ')} {str(file)!r} does not exist: check the path"
                    )
        found = importlib.import_module(f"frogkick_studies.{name}").run(chosen)
        values = found.as_json()
        if out is not None:
            figure = out / f"{name}.png" if chosen.folder else out
            save(lambda file: write_picture(found.plot(), file, ".png"), figure)
            values["figure"] = str(figure)
        return Result(values, found.text(values).splitlines() or None, passed=found.passed)

    run.__doc__ = config.__doc__
    run.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    return run
