"""``frogkick push``, ``retune --push``: a better table is sent, the previous one kept and rolled back to."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from tests.cli.commands import Outcome, frogkick
from tests.conftest import from_ci
from tests.core.store_rig import crc_of
from tests.identification.made import make_run
from tests.link.live_robot import LiveRobot
from tests.link.rigged import TRANSPORTS, rigged
from tests.planner import synthetic
from tests.runs import rig

from frogkick.core.files import write_bytes
from frogkick.core.poses import PredictionError
from frogkick.front import retuning as retune_module
from frogkick.front.retuning import BEFORE, TABLES, Retuning
from frogkick.identification.verdict import FOUND
from frogkick.link.pty_line import PtyLine
from frogkick.pool.native_robot import NativeRobot
from frogkick.runs.pushing import push
from frogkick.runs.runlog_file import write_run
from frogkick.runs.session import Session
from frogkick.tables.image import open_image
from frogkick_codegen.firmware import build

OLD, NEW, OTHER = (synthetic.affine_image(20, 9, seed) for seed in (1, 2, 3))


@pytest.fixture
def robot() -> LiveRobot:
    return LiveRobot(OLD)


@pytest.fixture
def line(robot: LiveRobot, tmp_path: Path) -> Iterator[PtyLine]:
    with PtyLine(tmp_path / "robot", robot) as there:
        yield there


@pytest.fixture
def new(tmp_path: Path) -> Path:
    write_bytes(tmp_path / "new.fkt", NEW)
    return tmp_path / "new.fkt"


@pytest.mark.parametrize("transport", TRANSPORTS)
def test_push_and_back(
    transport: str,
    robot: LiveRobot,
    new: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    with rigged(transport, robot, tmp_path, monkeypatch) as there:
        there.wire.close()  # the command opens its own
        output = frogkick(capsys, "push", new, "--robot", there.target, "--json")
        assert output.code == 0, output.stderr
        numbers = output.json
        assert (numbers["bytes_sent"], numbers["resumed_at"]) == (len(NEW), 0)
        assert (numbers["table_crc"], numbers["kept_crc"]) == (f"{crc_of(NEW):08x}", f"{crc_of(OLD):08x}")
        assert robot.flash.image == NEW
        again = frogkick(capsys, "push", new, "--robot", there.target)
        assert again.code == 0 and "which it already had" in again.stdout
        back = frogkick(capsys, "push", "--rollback", "--robot", there.target, "--json")
        assert back.code == 0 and back.json["table_crc"] == f"{crc_of(OLD):08x}"
        assert robot.flash.image == OLD


def test_a_robot_left_armed_is_disarmed_and_rests_first(
    robot: LiveRobot, line: PtyLine, new: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert robot.core.status("ARM") == "OK"
    output = frogkick(capsys, "push", new, "--robot", f"serial:{line.path}")
    assert output.code == 0, output.stderr
    assert f"received {len(NEW)} bytes" in output.stdout and "frogkick push --rollback" in output.stdout
    assert robot.core.state() == "DISARMED"


def test_limbs_that_rest_for_long_have_rested_first(tmp_path: Path) -> None:
    """1.3 s after each pulse, in a period of 1.425 s."""
    guard = replace(rig.robot().guard, rest_min_s=1.3)
    write_bytes(tmp_path / "old.fkt", OLD)
    slow = build("native", tmp_path / "old.fkt", replace(rig.robot(), guard=guard), tmp_path / "out")
    session = Session(NativeRobot(slow.image, len(rig.robot().limbs)))
    session.handshake(open_image(OLD))
    session.step(2.0)
    session.request("ARM")
    session.request("STROKE", {"action": 1})
    session.step(session.time_s + 0.05)
    assert push(session, open_image(NEW)).bytes_sent == len(NEW)


def test_another_robot_refuses(
    robot: LiveRobot, line: PtyLine, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_bytes(tmp_path / "newt.fkt", synthetic.affine_image(20, 9, 1, robot_id="newt"))
    output = frogkick(capsys, "push", tmp_path / "newt.fkt", "--robot", f"serial:{line.path}")
    assert (output.code, output.stdout) == (2, "") and "newt" in output.stderr
    assert robot.flash.image == OLD and "TABLE_BEGIN" not in robot.names()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("push --robot serial:COM3", "push takes either a table image or --rollback"),
        ("push x.fkt --rollback --robot serial:COM3", "push takes either a table image or --rollback"),
        ("push x.fkt --robot pool", "'pool' is not the target of a robot: choose ble:NAME, serial:PORT"),
        ("push x.fkt --robot seriel", "did you mean 'serial'"),
        ("own --robot serial", "robot 'serial' is neither ble:NAME nor serial:PORT"),
        ("retune x.h5 --robot frog2022 --out new --push virtuel", "did you mean 'virtual'"),
        ("push x.fkt --robot ble:", "neither ble:NAME nor serial:PORT"),
        ("push missing.fkt --robot serial:COM3", "missing.fkt"),
    ],
)
def test_bad_arguments(capsys: pytest.CaptureFixture[str], arguments: str, words: str) -> None:
    output = frogkick(capsys, *arguments.split())
    assert (output.code, output.stdout) == (2, "")
    assert words in output.stderr and output.stderr.count("\n") == 1


def retuned(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    folder: Path,
    target: str,
    better: bool,
    before: bytes = OLD,
    after: bytes = NEW,
) -> Outcome:
    """``retune --push`` with a given result of the search and given tables; all else is the command's own."""
    write_run(folder / "run.h5", make_run([], 1, 6))

    class Known:
        verdict = FOUND
        terms: tuple[object, ...] = ()
        parameters: tuple[object, ...] = ()

        def effects_as_json(self) -> list[object]:
            return []

        def tested_as_json(self) -> dict[str, object]:
            return {}

    def given(_swims: Any, _robot: Any, out: Path, *_more: Any) -> Retuning:
        out.mkdir()
        write_bytes(out / BEFORE, before)
        write_bytes(out / (TABLES if better else "refused.fkt"), after)
        errors = [PredictionError(0.002, 0.01, 10), PredictionError(0.001, 0.005, 10)]
        outcome: Any = Known()
        reason = "" if better else "no better"
        tables = {"file": str(out / TABLES), "bytes": len(after), "states": 20}
        return Retuning(
            outcome=outcome, before=errors[0], after=errors[1], better=better, reason=reason,
            held_out="run.h5", tables=tables, out=out,
        )  # fmt: skip

    monkeypatch.setattr(retune_module, "retuned", given)
    return frogkick(
        capsys, "retune", folder / "run.h5", "--robot", "frog2022", "--out", folder / "out", "--push", target,
        "--json",
    )  # fmt: skip


def test_retune_sends_what_is_better(
    robot: LiveRobot, line: PtyLine, tmp_path: Path, monkeypatch: Any, capsys: Any
) -> None:
    output = retuned(monkeypatch, capsys, tmp_path, f"serial:{line.path}", better=True)
    assert output.code == 0, output.stderr
    assert output.json["bytes_sent"] == len(NEW)
    assert output.json["pushed"]["kept_crc"] == f"{crc_of(OLD):08x}"
    assert robot.flash.image == NEW


def test_retune_sends_nothing_that_is_no_better(
    robot: LiveRobot, line: PtyLine, tmp_path: Path, monkeypatch: Any, capsys: Any
) -> None:
    output = retuned(monkeypatch, capsys, tmp_path, f"serial:{line.path}", better=False)
    assert output.code == 1 and output.json["bytes_sent"] == 0 and output.json["pushed"] is None
    assert robot.heard == [] and line.received == 0


def test_retune_sends_nothing_to_a_robot_with_other_tables(
    robot: LiveRobot, line: PtyLine, tmp_path: Path, monkeypatch: Any, capsys: Any
) -> None:
    """The new table was compared with a table that this robot does not have."""
    reported = retuned(monkeypatch, capsys, tmp_path, f"serial:{line.path}", better=True, before=OTHER)
    assert reported.code == 2 and reported.json["pushed"] is None and reported.json["better"] is True
    assert reported.stderr.splitlines()[-1].startswith(
        f"frogkick: the new table was made but not sent: the robot carries the table with CRC-32 "
        f"{crc_of(OLD):08x}, the new one was compared with {crc_of(OTHER):08x}"
    )
    assert "TABLE_BEGIN" not in robot.names() and (tmp_path / "out" / TABLES).exists()


def test_retune_keeps_what_it_made_where_no_robot_answers(
    tmp_path: Path, monkeypatch: Any, capsys: Any
) -> None:
    output = retuned(monkeypatch, capsys, tmp_path, f"serial:{tmp_path / 'none'}", better=True)
    assert output.code == 2 and output.json["bytes_sent"] == 0
    last = output.stderr.splitlines()[-1]
    assert "is not there" in last and f"'frogkick push {tmp_path / 'out' / TABLES} --robot serial:" in last


@from_ci
def test_retune_sends_to_a_virtual_robot(tmp_path: Path, monkeypatch: Any, capsys: Any) -> None:
    """It was switched on with the old tables, and takes the new ones by its UART."""
    old, new = rig.small_table().read_bytes(), rig.changed_image(32, b"another library")
    output = retuned(monkeypatch, capsys, tmp_path, "virtual", True, old, new)
    assert output.code == 0, output.stderr
    pushed = output.json["pushed"]
    assert output.json["bytes_sent"] == pushed["bytes_sent"] == len(new)
    assert (pushed["table_crc"], pushed["kept_crc"]) == (f"{crc_of(new):08x}", f"{crc_of(old):08x}")
