"""The robot decides, the host repeats each decision during the run, and every bit counts."""

from __future__ import annotations

import functools
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from tests.cli.commands import frogkick
from tests.conftest import from_ci, some
from tests.link.live_robot import LiveRobot, PatientClock
from tests.link.rigged import TRANSPORTS, rigged
from tests.link.swim import PATH, LivePool
from tests.runs import rig

from frogkick.core.errors import CheckError, InputError
from frogkick.link.layout import link_layout
from frogkick.paths import shape
from frogkick.planner.plan import PlanConfig
from frogkick.runs.closed_loop import TIME, run_session
from frogkick.runs.decision import DecisionTwin, LiveCheck
from frogkick.runs.lab_session import LabPort, LabSession
from frogkick.runs.live_log import logged, part_of
from frogkick.runs.record import RunOptions
from frogkick.runs.runlog_file import read_run
from frogkick.runs.session import Session
from frogkick.tables.image import Tables, open_image

PERIOD_S = rig.PERIOD_S
STATE = link_layout().state


@functools.cache
def image_with_one_entry_changed() -> bytes:
    """The small table with a changed transition, one that a run takes often, and a right CRC-32."""
    ours, bits = rig.tables(), dict[tuple[int, int], bytes]()
    for at in range(ours.sections.models, ours.sections.length):
        for bit in range(8):
            image = rig.changed_image(at, bytes([ours.image[at] ^ 1 << bit]))
            try:
                rows = np.argwhere((open_image(image).transitions != ours.transitions).any(axis=2))
            except InputError:
                continue
            if len(rows) == 1:
                bits.setdefault((int(rows[0, 0]), int(rows[0, 1])), image)
    taken = Counter(
        (each.nearest_state, each.action) for each in rig.swim("pool", PATH, 20 * PERIOD_S).decisions
    )
    for entry, count in taken.most_common():
        if entry in bits and count > 1:
            return bits[entry]
    raise AssertionError("no bit of the image holds an entry alone that it takes twice")


@pytest.fixture
def past_the_hash(monkeypatch: pytest.MonkeyPatch) -> None:
    """The hash of the robot's table is not compared, so that a fault behind it shows, as of its memory."""

    def handshake(self: Session, tables: Tables) -> dict[str, object]:
        reported = self.hello()
        tables.require_robot(str(reported["robot_id"]))
        return dict(reported)

    monkeypatch.setattr(Session, "handshake", handshake)


@pytest.mark.parametrize("transport", some(TRANSPORTS, 1))
def test_host_and_robot_agree(transport: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    robot, check = LiveRobot(clock=PatientClock(), on_for_s=100.0), LiveCheck()
    options = RunOptions(PlanConfig(depth=2), True, 2.5 * PERIOD_S, check)
    reported: list[str] = []
    with rigged(transport, robot, tmp_path, monkeypatch) as there:
        session = LabSession(LabPort(there.wire, robot.clock))
        source = LivePool(robot.pulses, robot.clock)
        path = shape(PATH)
        recording = run_session(
            session, source, rig.recording(path, options), lambda _t, _i: reported.append(check.text)
        )
    assert recording.ended == TIME and len(recording.decisions) == 3
    assert check.as_json() == {"decisions_checked": 3, "decisions_unchecked": 0, "mismatches": 0}
    assert reported == [f"host agrees with {count} decisions" for count in (1, 2, 3)]


@from_ci
def test_another_entry_in_the_robot_s_table_ends_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, past_the_hash: None
) -> None:
    robot = LiveRobot(built_in=image_with_one_entry_changed(), clock=PatientClock())
    options = RunOptions(PlanConfig(), True, 20 * PERIOD_S, LiveCheck())
    with rigged("serial", robot, tmp_path, monkeypatch) as there:
        session = LabSession(LabPort(there.wire, robot.clock))
        source = LivePool(robot.pulses, robot.clock)
        log = logged(tmp_path / "run.h5", rig.recording(shape(PATH), options))
        with log as keep, pytest.raises(CheckError, match=r"decision \d+ .* every bit") as said:
            run_session(session, source, rig.recording(shape(PATH), options), keep=keep)
        assert int(session.request("STATUS")["state"]) == STATE["DISARMED"]
    assert "\n" not in str(said.value) and "did not confirm DISARM" not in str(said.value)
    assert robot.off_at and "DISARM" in robot.names()
    assert len(read_run(part_of(tmp_path / "run.h5")).fixes.x_m) > 3


def test_after_a_drop_nothing_is_compared_and_that_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot, check = LiveRobot(clock=PatientClock()), LiveCheck()
    options = RunOptions(PlanConfig(), True, 1.5 * PERIOD_S, check)
    with rigged("serial", robot, tmp_path, monkeypatch) as there:
        session = LabSession(LabPort(there.wire, robot.clock))
        dropped = []

        def drop(_time_s: float, _index: int) -> None:
            if not dropped:
                dropped.append(True)
                there.drop()

        source = LivePool(robot.pulses, robot.clock)
        run_session(session, source, rig.recording(shape(PATH), options), drop)
    assert (check.agreed, check.unchecked) == (1, 1)
    assert check.text == "host agrees with 1 decisions, 1 not compared after a gap"


def test_the_command_tells_the_agreement(capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--tables", rig.small_table(), "--robot", "pool", "--path", "sine", "--simulated-time", "6"]
    output = frogkick(capsys, "run", *options, "--plan", "both", "--json")
    assert output.code == 0, output.stderr
    assert output.json["decisions_checked"] == output.json["decisions"] >= 4
    assert (output.json["decisions_unchecked"], output.json["mismatches"]) == (0, 0)
    assert "host agrees with" in output.stderr


def test_a_mismatch_is_a_check_that_failed(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Exit code 1, one line. The host's planner has another weight than the robot's here."""
    begin = LiveCheck.begin
    other = PlanConfig(angle_weight_per_rad=51.0)
    monkeypatch.setattr(
        LiveCheck,
        "begin",
        lambda self, twin: begin(self, DecisionTwin(twin.tables, shape("sine"), other)),
    )
    options = ["--tables", rig.small_table(), "--robot", "pool", "--path", "sine", "--simulated-time", "6"]
    output = frogkick(capsys, "run", *options, "--plan", "both", "--json")
    assert (output.code, output.stdout) == (1, "")
    last = output.stderr.splitlines()[-1]
    assert last.startswith("frogkick: decision ") and "cost" in last


def test_the_chip_is_checked_too() -> None:
    check = LiveCheck()
    options = RunOptions(PlanConfig(depth=2), True, 3.0, check)
    run_session(Session(rig.port("virtual")), rig.new_pool("sine"), rig.recording(shape("sine"), options))
    assert check.agreed >= 2 and check.unchecked == 0
