"""``frogkick log fetch`` and ``log replay``: what a robot wrote down in its RAM, and decided again."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from frogkick.cli.common import JsonOption, show
from frogkick.cli.options import TablesOption
from frogkick.errors import InputError, nearest_name
from frogkick.files import require_writable
from frogkick.progress import progress_bar

if TYPE_CHECKING:
    from frogkick.link.log import Record
    from frogkick.loop.chip_log_file import FetchedLog
    from frogkick.loop.chip_log_replay import LogReplay
    from frogkick.loop.session import Session


def fetch_from(session: Session) -> FetchedLog:
    """Fetch the log of the robot at the other end."""
    from frogkick.link.log import fetch_log
    from frogkick.loop.chip_log_file import FetchedLog

    told = session.meet()
    with progress_bar("bytes fetched") as progress:
        found = fetch_log(session, progress=progress)
    return FetchedLog(str(told["robot_id"]), int(told["table_crc"]), found)


def _told(records: list[Record], name: str, field: str) -> list[Any]:
    return [record.values[field] for record in records if record.name == name]


def summary_of(fetched: FetchedLog) -> dict[str, Any]:
    """What is in a log, as keys of the command."""
    from frogkick.link.layout import link_layout

    records = [record for stretch in fetched.log.records() for record in stretch]
    resets = {number: name for name, number in link_layout().reset.items()}
    faults = {number: name for name, number in link_layout().fault.items()}
    return {
        "robot_id": fetched.robot_id,
        "records": len(records),
        "lost": fetched.log.lost,
        "bytes": sum(len(stretch.content) for stretch in fetched.log.stretches),
        "gaps": max(0, len(fetched.log.stretches) - 1),
        "seconds": (records[-1].time_us - records[0].time_us) * 1e-6 if records else 0.0,
        "starts": [resets.get(int(reset), str(reset)) for reset in _told(records, "BOOT", "reset")],
        "faults": [faults.get(int(fault), str(fault)) for fault in _told(records, "FAULT", "fault")],
        "kinds": dict(sorted(Counter(record.command or record.name for record in records).items())),
    }


def fetch(
    robot: Annotated[
        str, typer.Option(metavar="TARGET", help="ble:NAME, ble:ADDRESS or serial:PORT[:BAUD].")
    ],
    out: Annotated[Path, typer.Option(help="File (.h5) to write.")],
    json: JsonOption = False,
) -> None:
    """Fetch what a robot wrote down in its RAM; in a run or after it, also after a reset. Changes nothing."""
    from frogkick.front.robots import session_at
    from frogkick.link.wire import is_target, parse_target
    from frogkick.loop.chip_log_file import write_log

    if not is_target(robot):
        raise InputError(
            f"robot {robot!r}{nearest_name(robot, ('ble', 'serial'))} keeps no log to fetch: "
            "choose ble:NAME or serial:PORT"
        )
    require_writable(out)
    parse_target(robot)
    with session_at(robot, None) as session:
        fetched = fetch_from(session)
    write_log(out, fetched)
    show({**summary_of(fetched), "out": str(out)}, json)


def replayed(fetched: FetchedLog, image: Path, model: str | None) -> LogReplay:
    """Decide a fetched log again.

    Raises:
        InputError: the table is for another robot.
    """
    from frogkick.front.places import built_firmware, robot_of_table
    from frogkick.loop.chip_log_replay import replay_log
    from frogkick.planner.image import read_image

    described = robot_of_table(image, model)
    if described.id != fetched.robot_id:
        raise InputError(
            f"the log is of robot {fetched.robot_id!r}, not {described.id!r}: give its own table "
            "with --tables"
        )
    with built_firmware("native", image, described) as built, progress_bar("records") as progress:
        return replay_log(fetched.log, built.image, [read_image(image)], progress)


def replay(
    file: Annotated[Path, typer.Argument(help="File that 'log fetch' wrote.")],
    tables: TablesOption = None,
    model: Annotated[str | None, typer.Option(help="Robot TOML or name; default: the table's.")] = None,
    json: JsonOption = False,
) -> None:
    """Decide a robot's log again, by the C core and the Python twin, bit by bit. Exit 1 on a mismatch."""
    from frogkick.front.places import table_image
    from frogkick.loop.chip_log_file import read_log
    from frogkick.planner.image import read_image
    from frogkick_codegen.firmware import require_tools

    fetched = read_log(file)
    require_tools("native")
    image = table_image(tables, fetched.robot_id if model is None else model)
    opened = read_image(image)
    found = replayed(fetched, image, model)
    if not found.segments and not found.mismatches:
        raise InputError(
            f"nothing in {file.name!r} can be decided again with table {opened.crc32:08x}, the robot used "
            f"{fetched.table_crc:08x}: give its table with --tables, or fetch after an ARM"
        )
    names = [row.name for row in opened.actions] + ["-"]
    values: dict[str, Any] = {
        "records": found.records,
        "replayed": found.replayed,
        "segments": found.segments,
        "decisions": len(found.decisions),
        "actions": "".join(names[decision.action] for decision in found.decisions),
        "mismatches": len(found.mismatches),
    }
    if found.mismatches:
        first = found.mismatches[0]
        values["first_mismatch"] = {"time_s": first.time_us * 1e-6, "place": first.place, "what": first.what}
    show(values, json)
    if found.mismatches:
        raise typer.Exit(1)


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.command()(fetch)
    app.command()(replay)
