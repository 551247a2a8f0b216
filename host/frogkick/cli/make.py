"""``frogkick simulate``, ``library``, ``tables``, ``codegen``, ``firmware``: from the model to firmware."""

from __future__ import annotations

import enum
import io
import math
import time
from pathlib import Path
from typing import Annotated, Any

import typer

import frogkick as fk
from frogkick.cli import options as opt
from frogkick.cli.common import Result, require_one_place, save, say
from frogkick.core.errors import InputError
from frogkick.core.files import write_text
from frogkick.core.progress import progress_bar

LibraryArgument = Annotated[Path, typer.Argument(help="HDF5 file that 'library build' wrote.")]
TableArgument = Annotated[Path, typer.Argument(help="Table image (.fkt).")]

RECORD_S = 5.0
"""The value of frogkick.library, repeated so that a command's help does not load that package."""

PHASE, CYCLES = 0.5, 8

Kind = enum.StrEnum("Kind", ["nearest", "affine"])
Target = enum.StrEnum("Target", ["bench", "native"])


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
    robot: opt.RobotArgument = "frog2022",
    egain_percent: Annotated[float | None, "EGaIn fraction of the limbs in a gait, %."] = None,
    frequency_hz: Annotated[float | None, "Strokes per second of a gait."] = None,
    phase: Annotated[float, "Lag of the rear limbs as a fraction of the period, 0 to 1."] = PHASE,
    cycles: Annotated[int, "Number of cycles of the gait.", opt.With(1, 200)] = CYCLES,
    actions: Annotated[
        str | None, "Names of the actions in their order, such as B,B,C or kick,glide."
    ] = None,
    initial_velocity: Annotated[str, "VX,VY,OMEGA: forward, left m/s, rad/s."] = "0,0,0",
    out: Annotated[Path | None, "CSV file to write, with time_s, x_m, y_m, heading_rad."] = None,
    animation: Annotated[Path | None, "Animation to write (.gif or .mp4)."] = None,
) -> Result:
    """Simulate a gait or a sequence of actions of a robot."""
    described = fk.load_robot(robot)
    if out is not None and out.suffix.lower() not in (".csv", ".txt", ""):
        raise InputError(
            f"--out {str(out)!r} ends in {out.suffix!r}, but a swim is written as CSV: give a name in .csv"
        )
    if animation is not None:
        from frogkick.report.animation import require_animation_name

        require_animation_name(animation)
    egain = described.egain_percent if egain_percent is None else egain_percent
    frequency = described.profile_frequency_hz if frequency_hz is None else frequency_hz
    of_gaits = (egain_percent, frequency_hz) != (None, None) or (phase, cycles) != (PHASE, CYCLES)
    if actions is not None and of_gaits:
        raise InputError(
            "--actions uses the robot's own profile: leave out --egain-percent, --frequency-hz, --phase and "
            "--cycles, which are of gaits"
        )
    begin = _velocity(initial_velocity)
    if actions is None and any(begin):
        raise InputError(
            f"--initial-velocity is {initial_velocity!r}, but a gait begins at rest: give --actions too"
        )
    result = opt.call(fk.simulate, locals(), robot=described, velocity_body=begin)
    if out is not None:
        save(lambda file: _write_csv(file, result), out)
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
    return Result(
        {
            "speed_mps": result.speed_mps,
            "distance_m": result.distance_m,
            "cost_of_transport": result.cost_of_transport,  # infinite without forward motion: shown as null
            **animated,
        },
        remarks=(described.cost_unknown,),
    )


def build_library(
    robot: opt.RobotArgument = "frog2022",
    states: Annotated[int, "Number of initial velocities.", opt.With(1, 65535)] = 300,
    out: Annotated[Path, "HDF5 file to write."] = Path("lib.h5"),
    workers: opt.Workers = 0,
    sampling: Annotated[
        opt.Sampling,
        "How initial velocities are drawn. box: uniformly, as in the paper; visited: from swims with random "
        "strokes; planned: from swims that the planner steers.",
    ] = opt.Sampling.box,
    record_s: Annotated[
        float,
        "Time to simulate and record after each transition's start, s; 0: one period.",
        opt.With(0.0, 60.0),
    ] = RECORD_S,
    cluster: opt.Cluster = None,
    seed: opt.Seed = 0,
) -> Result:
    """Simulate every action from each of many initial velocities. An interrupted build can be resumed."""
    described = fk.load_robot(robot)
    require_one_place(workers, cluster)
    began = time.perf_counter()
    made = opt.call(fk.build_library, locals(), robot=described, progress=True)
    for failure in made.failed:
        name = described.actions[failure.action].name
        say(f"state {failure.state}, action {name} is left out of the tables: {failure.reason}")
    transitions = states * len(described.actions)
    return Result(
        {
            "transitions": transitions,
            "failed": len(made.failed),
            "wall_s": round(time.perf_counter() - began, 3),
            "simulated_s": transitions * max(described.period_s, record_s),
            "out": str(out),
        }
    )


def show_library(library: LibraryArgument) -> Result:
    """Show the contents of a library."""
    from frogkick.front.tables import library_info

    # How long it took is not in the file, whose bytes do not depend on the machine.
    return Result({**library_info(library), "wall_s": None})


def build_table(
    library: LibraryArgument,
    kind: Annotated[
        Kind | None,
        "nearest: the paper's table; affine: fewer states, with local linear corrections and limb history. "
        "Default: the kind with the smaller error: affine, unless the library has too few states.",
        opt.With(show_default=False),
    ] = None,
    budget_kib: Annotated[
        float | None,
        "Largest size of the image, KiB; states are placed where the error is largest. Default: 64 for "
        "affine, no limit for nearest.",
        opt.With(0.5, 16384, show_default=False),
    ] = None,
    out: Annotated[Path, "Table image to write (.fkt)."] = Path("tables.fkt"),
    test_states: Annotated[int, "Number of unseen states to measure the error on.", opt.With(4, 10000)] = 64,
    sampling: opt.Unseen = opt.Sampling.planned,
    seed: opt.Seed = 1,
) -> Result:
    """Make a table image, and measure its error on states that are not in it, as 'tables info' does."""
    content = fk.load_library(library)
    table = fk.fit_table(content, kind.value if kind else None, budget_kib, progress=True)
    error = table.error(test_states, seed, sampling.value, progress=True)
    save(table.save, out)
    return Result({**table.facts(), "error": error, "sampling": sampling.value, "out": str(out)})


def show_table(
    tables: TableArgument,
    robot: Annotated[
        str | None,
        "Refuse a table that was not made for this robot.",
        opt.With(names=opt.FILE),
    ] = None,
    test_states: Annotated[
        int, "Number of unseen states to measure the error on; 0: do not measure it.", opt.With(0, 10000)
    ] = 64,
    sampling: opt.Unseen = opt.Sampling.planned,
    seed: opt.Seed = 1,
) -> Result:
    """Check a table image, show its contents, and measure its error on unseen states."""
    from frogkick.front.tables import read_facts

    facts = read_facts(tables)
    error = None
    try:
        table = fk.load_table(tables, robot)
    except fk.InputError:
        if robot is not None:
            raise  # otherwise no built-in robot fits, and only the image's own facts are shown
    else:
        if test_states:
            error = table.error(test_states, seed, sampling.value, progress=True)
    return Result({**facts, "error": error, "sampling": sampling.value if error else None})


def codegen(
    tables: TableArgument,
    out: Annotated[Path, "Folder to write.", opt.With(folder=True)],
    robot: opt.Model = None,
    measured: Annotated[
        bool,
        "Measure sizes and times on the virtual chip and write them into the README.",
        opt.With(names=("--measure/--no-measure",)),
    ] = True,
) -> Result:
    """Generate C99 from a table and the planner, with a README of their sizes and times on the chip.

    The planner's weights and depth are those of the robot's file.
    """
    files = fk.emit_c(tables, out, robot=robot, measure=measured, progress=True)
    return Result({"out": str(out), "files": files}, [f"{files[name]}  {name}" for name in sorted(files)])


def build_firmware(
    tables: Annotated[Path, "Table image (.fkt)."],
    target: Annotated[Target, "bench: nRF52832; native: this computer."] = Target.bench,
    robot: opt.Model = None,
    out: Annotated[Path, "Folder for the results.", opt.With(folder=True)] = Path("firmware-build"),
) -> Result:
    """Build the firmware around a table image.

    The value stack_bytes is the stack that the image reserves. Of the target bench, plan_time has how long a
    decision takes the chip: the worst of some states, and a bound for all.
    """
    built = fk.build_firmware(fk.load_table(tables, robot), target.value, out)
    return Result(built.as_json())


def measure_firmware(tables: opt.Tables = None, robot: opt.Model = None) -> Result:
    """Measure flash, RAM and stack of the bench image.

    The stack is measured on the virtual chip, and an upper bound over all paths of the machine code is given.
    """
    from frogkick.front.building import sizes_of, try_firmware

    return Result(sizes_of(*try_firmware(tables, robot)))


def flash_firmware(
    image: Annotated[
        Path | None, "Intel HEX file (bench.hex of 'firmware build'); default: built from --tables."
    ] = None,
    tables: opt.Tables = None,
    robot: opt.Model = None,
    probe: Annotated[str | None, "Serial number of the debug probe, if several are plugged in."] = None,
) -> Result:
    """Flash the bench image into a development kit through its debug probe."""
    from frogkick.front.building import flash_firmware as flash

    return Result(flash(image, table=tables, robot=robot, probe=probe, progress=True))


def check_firmware(tables: opt.Tables = None, robot: opt.Model = None) -> Result:
    """Boot the image on the virtual chip and test every command, stroke and limit."""
    from frogkick.front.building import checks_of, try_firmware

    checks = checks_of(*try_firmware(tables, robot, progress=True))
    return Result(checks, passed=checks["passed"])
