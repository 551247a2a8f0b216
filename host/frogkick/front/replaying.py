"""Decisions repeated: those of a run from its recorded fixes, those of a robot's own log from its records."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from frogkick.core.arguments import typed
from frogkick.core.errors import InputError
from frogkick.core.files import require_writable
from frogkick.core.progress import Progress, shown, tell_line
from frogkick.front import places
from frogkick.front.logs import Run, knows_robot, robot_of, run_of
from frogkick.front.robots import connect, require_target
from frogkick.front.tables import Table, default_tables, load_table, table_image
from frogkick.link.log import fetch_log as fetch_bytes
from frogkick.pool.native_robot import kept_wear
from frogkick.robot import Robot, in_a_row, load_robot
from frogkick.runs.chip_log import FetchedLog, LogReplay, read_log, write_log
from frogkick.runs.chip_log import replay_log as replay_records
from frogkick.runs.replay import Replay, require_replayable
from frogkick.runs.replay import replay as replay_run
from frogkick.runs.session import Session
from frogkick.runs.summary import lost_at_start
from frogkick_codegen.firmware import require_tools


@dataclass(frozen=True, eq=False, repr=False)
class Replayed:
    """A run whose decisions were repeated.

    Attributes:
        result: actions of both sides and of the run, and the differences.
        depth: of the planner's search, 1 to 4.
    """

    result: Replay
    depth: int

    @property
    def mismatches(self) -> int:
        """Number of decisions in which robot and host differ in any bit; 0 if only one side decided."""
        return len(self.result.differences)

    def as_json(self) -> dict[str, Any]:
        """The keys of the command ``replay``."""
        result = self.result
        values: dict[str, Any] = {
            "decisions": len(result.actions),
            "actions": in_a_row(result.actions),
            "mismatches": self.mismatches,
            "recorded_actions": in_a_row([name or "?" for name in result.recorded]),
            "agreement_with_recorded": result.agreement,
            "depth": self.depth,
            "places": [place for place, made in (("onboard", result.onboard), ("host", result.host)) if made],
        }
        if result.differences:
            decision, fields = result.differences[0]
            values["first_mismatch"] = {"decision": decision, "fields": fields}
        return values

    def __repr__(self) -> str:
        agreement = self.result.agreement
        recorded = "" if agreement is None else f", {100 * agreement:.0f} % as recorded"
        return f"Replayed({len(self.result.actions)} decisions, {self.mismatches} mismatches{recorded})"


@typed
def replay(
    run: Run | Path | str,
    *,
    plan: str = "both",
    table: Table | Path | str | None = None,
    planner: str | None = None,
    depth: int | None = None,
    robot: str = "virtual",
    model: Robot | str | None = None,
    progress: Progress = False,
) -> Replayed:
    """Give a run's fixes to the planner again, and compare every decision.

    Args:
        run: a run in memory, a log of frogkick, or a recorded run of the paper.
        plan: who decides: "onboard" (the robot), "host" (the Python twin) or "both", compared bit by bit.
        table: the table to plan with, or its file; None: the default table of the run's robot.
        planner: planner whose weights and depth are used, "robot" or "paper"; None: the run's own if its log
            has them, else the paper's.
        depth: of the planner's search, 1 to 4; None: the planner's own.
        robot: "virtual" (the firmware on the virtual chip) or "pool" (the C core on this computer).
        model: the robot, its name or its TOML file; None: the one in the run's log, or that of the table.
        progress: of the decisions: True for a bar, or a function of (done, all).

    Raises:
        InputError: the run holds no decision to repeat, or the table is for another robot or period.
        ToolchainError: no compiler for the firmware is found.
    """
    places.require_simulator(robot, builds=plan != "host")
    recorded = run_of(run)
    require_replayable(recorded)
    places.require_plan(plan)
    asked = None if model is None else load_robot(model)
    if asked is not None and recorded.robot_id != asked.id:
        raise InputError(
            f"run {recorded.source!r} is of robot {recorded.robot_id!r}, not {asked.id!r}: give "
            "its robot with --model"
        )
    if asked is not None or knows_robot(recorded):
        asked = robot_of([(recorded, recorded.source)], asked)
    used = load_table(default_tables(asked or recorded.robot_id) if table is None else table, asked)
    used.tables.require_robot(recorded.robot_id)
    described = used.robot
    period_s = used.tables.period_us * 1e-6
    if abs(period_s / recorded.period_s - 1.0) > 0.1:
        raise InputError(
            f"run {recorded.source!r} has a period of {recorded.period_s:.3f} s, but the table has "
            f"{period_s:.3f} s: build a library and a table with the run's period"
        )
    if recorded.table_crc not in (None, used.crc32):
        tell_line(
            f"frogkick: run {recorded.source!r} was planned with table {recorded.table_crc:08x}, and this "
            f"replay uses {used.crc32:08x}: give the run's own table (--tables) to repeat its decisions"
        )
    config = places.plan_config(described, planner, depth, recorded)
    with ExitStack() as stack:
        port = None
        if plan != "host":
            image = stack.enter_context(used.file())
            learned = kept_wear(used.tables.crc32, lost_at_start(recorded))
            port = stack.enter_context(places.simulated_robot(robot, image, described, learned=learned))
        tell = stack.enter_context(shown(progress, "decisions"))
        result = replay_run(recorded, used.tables, config, port, plan != "onboard", tell)
    return Replayed(result, config.depth)


def fetch_from(session: Session, progress: Progress = False) -> FetchedLog:
    """Fetch the log of the robot of a session."""
    hello = session.hello()
    with shown(progress, "bytes fetched") as tell:
        found = fetch_bytes(session, progress=tell)
    return FetchedLog(str(hello["robot_id"]), int(hello["table_crc"]), found)


def fetch_log(target: str, out: Path | None = None, progress: Progress = False) -> FetchedLog:
    """Fetch the log that a robot keeps in its RAM, with the options of the command ``log fetch``."""
    require_target(target)
    require_writable(out)
    with connect(target) as bot:
        fetched = fetch_from(bot.session(), progress)
    if out is not None:
        write_log(out, fetched)
    return fetched


def replay_log(
    log: FetchedLog | Path | str,
    *,
    tables: Path | None = None,
    model: str | None = None,
    progress: Progress = False,
) -> LogReplay:
    """Repeat the decisions of a robot's log by the C core on this computer and by the Python twin.

    The arguments are the options of the command ``log replay``; ``log`` may be what ``fetch_log`` returned.
    """
    fetched = log if isinstance(log, FetchedLog) else read_log(log)
    name = "the log" if isinstance(log, FetchedLog) else repr(Path(log).name)
    require_tools("native")
    used = load_table(table_image(tables, fetched.robot_id if model is None else model), model)
    opened, described = used.tables, used.robot
    if described.id != fetched.robot_id:
        raise InputError(
            f"the log is of robot {fetched.robot_id!r}, not {described.id!r}: give its own table "
            "with --tables"
        )
    with (
        used.file() as image,
        places.built_firmware("native", image, described) as built,
        shown(progress, "records") as tell,
    ):
        found = replay_records(fetched.log, built.image, [opened], tell)
    if not found.segments and not found.mismatches:
        if opened.crc32 == fetched.table_crc:
            raise InputError(
                f"no decision in {name} can be repeated, because it has no ARM, at which the robot logs its "
                "state: fetch the log during a run, or after it"
            )
        raise InputError(
            f"no decision in {name} can be repeated with table {opened.crc32:08x}, because the robot used "
            f"{fetched.table_crc:08x}: give its table with --tables"
        )
    return found
