"""``frogkick demo``: all stages once; ``doctor``: the tools of this machine; ``robot``: robot files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import frogkick as fk
from frogkick.cli import options as opt
from frogkick.cli.common import Result, say
from frogkick.core.files import file_to_write
from frogkick.report.style import write_picture

if TYPE_CHECKING:
    from frogkick.front.readiness import Finding
    from frogkick.front.ring import Adaptation


def demo(
    out: Annotated[Path, "Folder for all results.", opt.With(folder=True)] = Path("demo"),
    robot: opt.RobotFile = "frog2022",
    states: Annotated[
        int | None,
        "Initial velocities of the library; default: as for the default table.",
        opt.With(10, 2000, show_default=False),
    ] = None,
    depth: opt.Depth = None,
    seed: opt.Seed = 0,
) -> Result:
    """Simulate a robot, make its table, build the firmware, and follow paths on the virtual chip.

    Then a limb is worn, the wear is identified from the runs, and a new table is made and tested.
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
    if ring.adaptation is not None:
        lines += _adaptation_lines(ring.adaptation)
    return Result(values, [*lines, f"report: {report.resolve()}"], passed=ring.passed)


def _adaptation_lines(adaptation: Adaptation) -> list[str]:
    tested, found = adaptation.outcome.tested, [term.title for term in adaptation.outcome.terms]
    hidden = ", ".join(str(value) for value in adaptation.true_effect.values())
    lines = [
        f"hidden effect: {hidden}; verdict: {adaptation.outcome.verdict} ({', '.join(found) or 'no effect'})"
    ]
    lines += [
        f"{name:8s} {error} RMS one period ahead on the test run"
        for name, error in (("before", tested.before), ("after", tested.after), ("noise", tested.noise_floor))
    ]
    if adaptation.new:
        lines.append(
            f"worn robot: {1e3 * adaptation.distance_m(adaptation.old):.1f} mm from its paths with the old "
            f"firmware, {1e3 * adaptation.distance_m(adaptation.learned):.1f} mm with it and --learn, "
            f"{1e3 * adaptation.distance_m(adaptation.new):.1f} mm with the new firmware"
        )
    return lines


def _hint(finding: Finding) -> str:
    """Return what to do, unless the error itself says it."""
    return f" -> {finding.install}" if finding.install and finding.install not in finding.detail else ""


def doctor() -> Result:
    """Check which tools this machine has. The exit code is 1 if no run can be simulated here."""
    from frogkick.front.readiness import check_machine

    found = check_machine()
    values = found.as_json()
    lines = [f"frogkick {values['frogkick']}, Python {values['python']}, {values['cores']} cores"]
    for title, findings in (("needed", found.needed), ("for more", found.optional)):
        lines.append(f"{title}:")
        for finding in findings:
            mark = "ok     " if finding.works else "MISSING"
            lines.append(f"  {mark} {finding.name}: {finding.detail} ({finding.needed_for}){_hint(finding)}")
    lines.append("plugged in:")
    lines += [f"  {finding.name}: {finding.detail}" for finding in found.hardware]
    lines.append("ready for:")
    for stage in found.stages:
        lines.append(f"  {'ready    ' if stage.ready else 'NOT READY'} {stage.name}: {stage.begin}")
        lines += [
            f"            {finding.name}: {finding.detail}{_hint(finding)}"
            for finding in stage.findings
            if not finding.works
        ]
    remarks = [] if found.ready else ["doctor found something missing"]
    return Result(values, lines, found.ready, remarks)


def list_robots() -> Result:
    """List the built-in robots."""
    names = fk.built_in_robots()
    robots = [fk.load_robot(name) for name in names]
    rows = [
        {
            "name": name,
            "title": robot.title,
            "limbs": len(robot.limbs),
            "actions": len(robot.actions),
            "period_s": robot.period_s,
        }
        for name, robot in zip(names, robots, strict=True)
    ]
    lines = [
        f"{row['name']}: {row['title']}; {row['limbs']} limbs, {row['actions']} actions, {row['period_s']} s"
        for row in rows
    ]
    return Result({"robots": rows}, lines)


def new_robot(
    out: Annotated[
        Path,
        typer.Argument(
            help="TOML file to write; its file name becomes the robot's id.",
            parser=file_to_write,
        ),
    ],
    base: Annotated[
        str, "Built-in name or TOML file to start from.", opt.With(names=("--from",))
    ] = "frog2022",
    limbs: Annotated[
        int | None, "Number of limbs, in mirrored pairs and an odd one as a tail; default: as many as it has."
    ] = None,
) -> Result:
    """Write a complete robot file to start from, with a comment on every key."""
    from frogkick.front.describing import write_new_robot

    robot = write_new_robot(out, base, limbs)
    limbs, actions = len(robot.limbs), len(robot.actions)
    return Result({"id": robot.id, "limbs": limbs, "actions": actions, "out": str(out)})


def fit_stroke(
    strokes: Annotated[
        list[Path],
        typer.Argument(
            help="CSV files, each of one cycle that starts with the pulse. Columns: time_s,curvature_per_m "
            "or time_s,tip_x_m,tip_y_m (position of the tip from the root, x along the limb at the root)."
        ),
    ],
    out: Annotated[Path, "TOML file to write, for the key profiles_file of a robot."],
    egain_percent: Annotated[float, "EGaIn fraction of the limb's alloy, %.", opt.With(0.0, 100.0)] = 0.0,
    frequency_hz: Annotated[
        list[float] | None,
        "Strokes per second of a file, given once for each file in their order; default: one over the last "
        "time of each.",
    ] = None,
    length_m: Annotated[float | None, "Length of the limb, needed if its tip was tracked."] = None,
    picture: Annotated[Path | None, "PNG to write, of the measured strokes and the fits."] = None,
) -> Result:
    """Fit limb profiles to measured strokes: how the curvature falls and recovers."""
    from frogkick.front.describing import fit_strokes

    found = fit_strokes(strokes, egain_percent=egain_percent, frequency_hz=frequency_hz, length_m=length_m)
    found.save(out)
    if picture is not None:
        write_picture(found.plot(), picture, ".png")
    return Result({**found.as_json(), "out": str(out), "picture": picture and str(picture)})


def show_robot(
    robot: opt.RobotArgument = "frog2022",
    out: Annotated[Path | None, "Picture to write (.png, .svg or .pdf)."] = None,
) -> Result:
    """Show a robot in numbers, and draw it as it is simulated: nodes, frame, limbs at rest and active.

    All lengths are those at rest. Doubtful geometry and doubtful limits are reported as warnings.
    """
    from frogkick.front.describing import describe

    described = fk.load_robot(robot)
    facts = describe(described)
    if out is not None:
        from frogkick.report.robot_figure import robot_figure

        write_picture(robot_figure(described), out)
    for warning in facts["warnings"]:
        say(f"warning: {warning}")
    return Result({**facts, "out": out and str(out)}, _robot_lines(described, facts))


def draw_frames(out: Annotated[Path, "Picture to write (.png, .svg or .pdf)."]) -> Result:
    """Draw the frames and units that files, options and logs use: pool, robot, tag and heights."""
    from frogkick.report.frames_figure import UNITS, frames_figure

    write_picture(frames_figure(), out, dpi=90)
    return Result({"out": str(out), "units": {what: unit for what, unit, _ in UNITS}})


def _robot_lines(robot: fk.Robot, facts: dict[str, Any]) -> list[str]:
    sizes, guard = facts["sizes"], robot.guard
    lines = [
        f"{robot.id}: {robot.title}",
        f"{facts['nodes']} nodes, segments {1e3 * sizes['segment_min_m']:.2f} to "
        f"{1e3 * sizes['segment_max_m']:.2f} mm",
        f"{1e3 * robot.mass_kg:.0f} g; {1e3 * sizes['length_m']:.0f} mm long, "
        f"{1e3 * sizes['width_m']:.0f} mm wide at rest",
        f"one stroke every {robot.period_s:g} s, pulses of {1e3 * robot.pulse_s:g} ms",
        f"guard: pulses up to {1e3 * guard.pulse_max_s:g} ms, then {guard.rest_min_s:g} s of rest; "
        f"on for up to {100 * guard.duty_max:g} % of {guard.duty_window_s:g} s; "
        f"{guard.limbs_at_once_max} limb{'' if guard.limbs_at_once_max == 1 else 's'} at once",
    ]
    for limb in facts["limbs"]:
        x, y = (1e3 * value for value in limb["root_m"])
        place = f"corner {limb['corner']} at ({x:g}, {y:g}) mm"
        fired = " ".join(limb["actions"]) or "none"
        lines.append(f"limb {limb['index']} {limb['name']}: {place}, actions {fired}")
    for action in facts["actions"]:
        first, second = (" ".join(action[group]) or "none" for group in ("first", "second"))
        lines.append(f"action {action['name']}: {first}; then {second}")
    return lines
