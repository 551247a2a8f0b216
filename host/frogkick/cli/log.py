"""``frogkick log``: runs and a robot's own log, shown and compared; ``export``, ``import`` and ``replay``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

import frogkick as fk
from frogkick.cli import options as opt
from frogkick.cli.common import Result, say, short, text_lines
from frogkick.core.errors import InputError
from frogkick.core.files import require_writable
from frogkick.core.progress import progress_bar
from frogkick.report.style import write_picture

RunArgument = Annotated[
    Path, typer.Argument(help="Log of frogkick (.h5), or a recorded run of the paper (such as line1.csv).")
]


def show_run(
    run: RunArgument,
    out: Annotated[Path | None, "Picture (.png) or animation (.gif, .mp4) to write."] = None,
    view: Annotated[bool, "Play the run in the browser."] = False,
    speed: Annotated[float, "Speed of --view; 2 is twice real time."] = 1.0,
) -> Iterator[Result]:
    """Show a run in numbers and in one picture: track, distance, actions and prediction errors."""
    moving = out is not None and out.suffix.lower() in (".gif", ".mp4")
    if not moving:
        _require_picture(out, ", .gif or .mp4")
    log = fk.load_run(run)
    found = log.summary()
    if moving and out is not None:
        from frogkick.report.animation import run_swim, write_animation

        with progress_bar("animation") as progress:
            write_animation(run_swim(log), out, progress)
    elif out is not None:
        from frogkick.report.run_figure import run_figure

        write_picture(run_figure(log, f"{run.name}: {found.decisions} decisions"), out, ".png")
    yield Result({**found.as_json(), "picture": out and str(out)}, _lines(found.as_json()))
    if view:
        log.play(speed)


def compare(
    a: RunArgument,
    b: RunArgument,
    out: Annotated[Path | None, "Picture (.png) to write."] = None,
) -> Result:
    """Compare two runs: their distances to the path, their first different decision, and their separation."""
    _require_picture(out)
    one, two = fk.load_run(a), fk.load_run(b)
    found = one.compare(two)
    if out is not None:
        from frogkick.report.run_figure import compare_figure

        names = (a.name, b.name) if a.name != b.name else (str(a), str(b))
        write_picture(compare_figure((one, two), names), out, ".png")
    values = found.as_json()
    rows = [
        f"{key:18s}  {short(values['a'][key]):>22s}  {short(values['b'][key]):>22s}"
        for key in values["a"]
        if key not in ("actions", "clock", "notes", "made")
    ]
    more = {
        key: values[key] for key in ("same_robot", "same_table", "same_path", "same_decisions", "apart_m")
    }
    return Result({**values, "picture": out and str(out)}, [*rows, *_lines(more)])


def export(
    run: RunArgument,
    out: Annotated[Path, "File to write (.mcap), or folder for CSV.", opt.With(folder=None)],
    csv: Annotated[bool, "Write one CSV file for each group of columns."] = False,
    mcap: Annotated[bool, "Write one MCAP file for Foxglove, and a layout."] = False,
) -> Result:
    """Export a run as CSV (a folder of files) or as MCAP (poses, path and plan in Foxglove's schemas)."""
    if csv == mcap:
        raise InputError(
            "--csv, --mcap: give exactly one, --csv for a folder of files or --mcap for one file"
        )
    require_writable(out, folder=csv)
    log = fk.load_run(run)
    if csv:
        files = [str(file) for file in log.export_csv(out)]
        return Result({"files": files}, files)
    counts = log.export_mcap(out)
    files = [str(out), str(out.with_suffix(".layout.json"))]
    lines = [*files, *(f"  {topic:12s} {count}" for topic, count in counts.items())]
    return Result({"files": files, "messages": counts}, lines)


def _require_picture(out: Path | None, moving: str = "") -> None:
    """Raise InputError if the name of the picture ends otherwise than in .png."""
    if out is not None and out.suffix.lower() != ".png":
        raise InputError(f"--out {str(out)!r} does not end in .png{moving}: name the picture so")


def _lines(values: Mapping[str, Any]) -> list[str]:
    facts = {key: value for key, value in values.items() if key not in ("actions", "clock", "made")}
    facts |= values.get("clock", {}) | values.get("made", {})
    if "actions" in values:
        facts["actions"] = ", ".join(f"{name} {count}" for name, count in values["actions"].items())
    return text_lines(facts)


def import_(
    data_dir: Annotated[
        Path,
        typer.Argument(help="Folder of recorded runs and their paths, such as line1.csv and linep1.csv."),
    ],
    out: Annotated[Path, "Folder for the logs.", opt.With(folder=True)],
) -> Result:
    """Read recorded runs, repair or mark their faults, and write logs. No data is invented."""
    from frogkick.front.logs import import_runs

    runs = import_runs(data_dir, out, progress=True)
    columns = list(dict.fromkeys(c for row in runs for c in row if c not in ("clock_notes", "skipped")))
    lines = ["  ".join(columns)] + ["  ".join(short(row.get(c)) for c in columns) for row in runs]
    lines += [f"{row['run']}: skipped, {row['skipped']}" for row in runs if "skipped" in row]
    for row in runs:
        for note in row.get("clock_notes", ()):
            say(f"{row['run']}: {note}")
    return Result({"runs": runs, "out": str(out)}, lines)


def replay(
    run: RunArgument,
    plan: Annotated[
        opt.PlanWhere, "Who decides: the virtual chip, its twin on the host, or both."
    ] = opt.PlanWhere.both,
    tables: opt.Tables = None,
    planner: Annotated[
        opt.PlannerName | None,
        "Planner whose weights and depth are used; default: the run's own if its log has them, else paper.",
    ] = None,
    depth: opt.Depth = None,
    robot: Annotated[str, "virtual: the chip; pool: the C core on this computer."] = "virtual",
    model: Annotated[str | None, "Robot TOML file or built-in name; default: the table's robot."] = None,
) -> Result:
    """Give a run's fixes to the planner again and compare every decision.

    The exit code is 1 if a decision differs.
    """
    from frogkick.front.replaying import replay as replay_run

    replayed = opt.call(replay_run, locals(), table=tables, progress=True)
    return Result(replayed.as_json(), passed=not replayed.mismatches)


def fetch(robot: opt.Target, out: Annotated[Path, "Log file to write (.h5)."]) -> Result:
    """Fetch the log that a robot keeps in its RAM.

    It can be fetched during a run, after it, and after a reset of the robot. Fetching changes nothing on the
    robot.
    """
    from frogkick.front.replaying import fetch_log

    return Result({**fetch_log(robot, out, progress=True).summary(), "out": str(out)})


def replay_fetched(
    file: Annotated[Path, typer.Argument(help="Log file that 'log fetch' wrote.")],
    tables: opt.Tables = None,
    model: opt.Model = None,
) -> Result:
    """Repeat the decisions of a robot's log by the C core and by the Python twin, bit by bit.

    The exit code is 1 if a decision differs.
    """
    from frogkick.front.replaying import replay_log

    found = replay_log(file, tables=tables, model=model, progress=True)
    return Result(found.as_json(), passed=not found.mismatches)
