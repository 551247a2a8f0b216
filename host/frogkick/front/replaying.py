"""Decisions made again: of a run by its recorded fixes, of a robot's own log by every record of it."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from frogkick.core.errors import InputError, nearest_name
from frogkick.core.files import require_writable
from frogkick.core.progress import Progress, shown
from frogkick.front.default_tables import default_tables
from frogkick.front.places import (
    built_firmware,
    called_by,
    plan_config,
    require_period,
    require_simulated,
    require_simulator,
    robot_of_table,
    simulated_robot,
    table_image,
)
from frogkick.front.robots import session_at
from frogkick.front.running import PLANS, Run
from frogkick.front.tables import Table, load_table
from frogkick.link.log import fetch_log as fetch_bytes
from frogkick.link.wire import is_target, parse_target
from frogkick.robot import Robot, in_a_row
from frogkick.runs.chip_log_file import FetchedLog, read_log, write_log
from frogkick.runs.chip_log_replay import LogReplay
from frogkick.runs.chip_log_replay import replay_log as replay_records
from frogkick.runs.recorded import load_run as load_log
from frogkick.runs.replay import Replay, require_replayable
from frogkick.runs.replay import replay as replay_run
from frogkick.runs.session import Session
from frogkick.tables.image import Tables, read_image
from frogkick_codegen.firmware import require_tools

__all__ = ["FetchedLog", "LogReplayed", "Replayed", "fetch_from", "fetch_log", "replay", "replay_log"]


@dataclass(frozen=True, eq=False, repr=False)
class Replayed:
    """A run whose decisions were made again.

    Attributes:
        result: actions of both sides and of the run, and where the sides differ.
        depth: periods that were looked ahead.
    """

    result: Replay
    depth: int

    @property
    def mismatches(self) -> int:
        """Decisions that robot and host made differently, bit by bit; 0 where only one side decided."""
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
        run: in memory, or a log of ours or a recorded run of the paper.
        plan: who decides: "onboard" (the robot), "host" (the Python twin) or "both", compared bit by bit.
        table: to plan with, or its file; None: the default one of the run's robot.
        planner: whose weights and depth, "robot" or "paper"; None: the run's own where it has them, else
            the paper's.
        depth: periods to look ahead, 1 to 4; None: the planner's own.
        robot: "virtual" (the firmware on the virtual chip) or "pool" (the C core on this computer).
        model: the robot, or its name or TOML file; None: the run's.
        progress: of the decisions: True for a bar, or a function of (done, all).

    Raises:
        InputError: the run holds nothing to decide again, or the table is for another robot or period.
        ToolchainError: no compiler for the firmware.
    """
    if plan not in PLANS:
        raise InputError(f"plan is {plan!r}{nearest_name(plan, PLANS)}: choose {', '.join(PLANS)}")
    (require_simulated if plan == "host" else require_simulator)(robot)
    recorded = run.log if isinstance(run, Run) else load_log(run)
    require_replayable(recorded)
    if isinstance(table, Table):
        used = table
    else:
        file = default_tables(recorded.robot_id) if table is None else table
        used = load_table(file, recorded.robot_id if model is None else model)
    described = used.robot
    if recorded.robot_id != described.id:
        raise InputError(f"run {recorded.source!r} is of robot {recorded.robot_id!r}, not {described.id!r}")
    require_period(used.tables, recorded)
    config = plan_config(described, planner, depth, recorded)
    with ExitStack() as stack:
        port = None
        if plan != "host":
            image = stack.enter_context(used.file())
            port = stack.enter_context(simulated_robot(robot, image, described))
        tell = stack.enter_context(shown(progress, "decisions"))
        result = replay_run(recorded, used.tables, config, port, plan != "onboard", tell)
    return Replayed(result, config.depth)


def fetch_from(session: Session, progress: Progress = False) -> FetchedLog:
    """Fetch the log of the robot at the other end.

    Raises:
        LinkError: no answer.
    """
    told = session.meet()
    with shown(progress, "bytes fetched") as tell:
        found = fetch_bytes(session, progress=tell)
    return FetchedLog(str(told["robot_id"]), int(told["table_crc"]), found)


def fetch_log(target: str, out: Path | None = None, progress: Progress = False) -> FetchedLog:
    """Fetch what a robot wrote down in its RAM; in a run or after it, also after a reset. Changes nothing.

    Args:
        target: ``ble:NAME``, ``ble:ADDRESS`` or ``serial:PORT[:BAUD]``.
        out: file (.h5) to write as well.
        progress: of the bytes: True for a bar, or a function of (done, all).

    Raises:
        InputError: no such kind of place, or the file cannot be written.
        WireError: the robot cannot be reached.
        LinkError: it does not answer.
    """
    if not is_target(target):
        raise InputError(
            f"robot {target!r}{nearest_name(target, ('ble', 'serial'))} keeps no log to fetch: "
            "choose ble:NAME or serial:PORT"
        )
    require_writable(out)
    parse_target(target)
    with session_at(target, None) as session:
        fetched = fetch_from(session, progress)
    if out is not None:
        write_log(out, fetched)
    return fetched


@dataclass(frozen=True, eq=False, repr=False)
class LogReplayed:
    """A robot's own log, decided again.

    Attributes:
        result: what was lived through again, and what came out otherwise.
        tables: that it was decided with.
    """

    result: LogReplay
    tables: Tables

    @cached_property
    def actions(self) -> tuple[str, ...]:
        """The action of each decision, by name; "-" where there was no plan."""
        names = [row.name for row in self.tables.actions] + ["-"]
        return tuple(names[decision.action] for decision in self.result.decisions)

    def as_json(self) -> dict[str, Any]:
        """The keys of the command ``log replay``."""
        result = self.result
        values: dict[str, Any] = {
            "records": result.records,
            "replayed": result.replayed,
            "segments": result.segments,
            "decisions": len(result.decisions),
            "actions": in_a_row(self.actions),
            "mismatches": len(result.mismatches),
        }
        if result.mismatches:
            first = result.mismatches[0]
            values["first_mismatch"] = {
                "time_s": first.time_us * 1e-6,
                "place": first.place,
                "what": first.what,
            }
        return values

    def __repr__(self) -> str:
        found = self.result
        return (
            f"LogReplayed({found.replayed} of {found.records} records, {len(found.decisions)} decisions, "
            f"{len(found.mismatches)} mismatches)"
        )


def replay_log(
    log: FetchedLog | Path | str,
    *,
    tables: Path | None = None,
    model: str | None = None,
    progress: Progress = False,
) -> LogReplayed:
    """Decide a robot's log again, by the C core on this computer and the Python twin, bit by bit.

    Args:
        log: of ``fetch_log``, or its file.
        tables: image that the robot carried; None: the default one of its robot.
        model: name or TOML file of the robot; None: the table's.
        progress: of the records: True for a bar, or a function of (done, all).

    Raises:
        InputError: no such log, the table is another robot's, or nothing in the log was decided by it.
        ToolchainError: no compiler for the core.
    """
    fetched = log if isinstance(log, FetchedLog) else read_log(log)
    name = "the log" if isinstance(log, FetchedLog) else repr(Path(log).name)
    require_tools("native")
    image = table_image(tables, fetched.robot_id if model is None else model)
    opened = read_image(image)
    described = robot_of_table(image, model)
    if described.id != fetched.robot_id:
        raise InputError(
            f"the log is of robot {fetched.robot_id!r}, not {described.id!r}: give its own table "
            "with --tables"
        )
    with built_firmware("native", image, described) as built, shown(progress, "records") as tell:
        found = replay_records(fetched.log, built.image, [opened], tell)
    if not found.segments and not found.mismatches:
        raise InputError(
            f"nothing in {name} can be decided again with table {opened.crc32:08x}, the robot used "
            f"{fetched.table_crc:08x}: give its table with --tables, or fetch after an ARM"
        )
    return LogReplayed(found, called_by(described, opened))
