"""Runs in real time: a live robot in a simulated pool, over a serial line, Bluetooth, and text."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.cli.commands import frogkick
from tests.conftest import from_ci, some
from tests.link.live_robot import LiveRobot, PatientClock
from tests.link.rigged import TRANSPORTS, rigged
from tests.link.swim import PATH, LivePool, TextFrog
from tests.runs import rig

from frogkick.link.frames import Frame
from frogkick.link.layout import link_layout
from frogkick.link.opening import opened
from frogkick.link.pty_line import PtyLine
from frogkick.link.wire import Target
from frogkick.paths import shape
from frogkick.planner.plan import PlanConfig
from frogkick.pool.monitor import Pulse, pulses_of, violations
from frogkick.pool.native_robot import NativeRobot
from frogkick.runs.closed_loop import run_session
from frogkick.runs.decision import DecisionTwin, LiveCheck
from frogkick.runs.lab_session import LabPort, LabSession
from frogkick.runs.path_change import NextPath
from frogkick.runs.record import DROPPED, ENDED, TIME, RunOptions
from frogkick.runs.runlog_file import read_run
from frogkick.runs.session import LinkError
from frogkick.runs.text_robot import DIALECTS, TextRobot, pulse_line

PERIOD_S = rig.PERIOD_S
STATE = link_layout().state


def seen_pulses(pulses: list[tuple[float, int, int]]) -> list[Pulse]:
    """One pulse for each limb."""
    return [
        Pulse(limb, at_s, at_s + pulse_us * 1e-6)
        for at_s, limb_mask, pulse_us in pulses
        for limb in range(4)
        if limb_mask >> limb & 1
    ]


@pytest.mark.parametrize("onboard", [True, False], ids=["onboard", "host"])
@pytest.mark.parametrize("transport", some(TRANSPORTS, 1))
def test_a_run(transport: str, onboard: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    robot = LiveRobot(clock=PatientClock(), on_for_s=100.0)  # its clock is not the host's
    options = RunOptions(PlanConfig(depth=2), onboard, 2.5 * PERIOD_S)
    with rigged(transport, robot, tmp_path, monkeypatch) as there:
        session = LabSession(LabPort(there.wire, robot.clock))
        source = LivePool(robot.pulses, robot.clock)
        recording = run_session(session, source, rig.recording(shape(PATH), options))
        assert int(session.request("STATUS")["state"]) == STATE["DISARMED"]
    assert recording.ended == TIME and len(recording.decisions) == 3
    assert any(decision.status == 0 for decision in recording.decisions)
    assert sum(fix.robot_status == 0 for fix in recording.fixes) > 20
    assert len(robot.pulses) >= 3 and violations(rig.robot(), seen_pulses(robot.pulses)) == []
    tracked = recording.tracking()
    assert tracked.mean_distance_m < 0.02 and tracked.progress_mps > 0.005
    assert tracked.limit_violations is None
    log = recording.log()
    at_s = log.decisions.time_s  # on the fixes' clock: each decision rests on fixes not long before it
    assert np.all(np.diff(at_s) == pytest.approx(PERIOD_S, abs=1e-6))
    rests = log.decisions.fix_sequence >= 0  # on a busy machine one may find no fix young enough
    newest_s = log.fixes.capture_time_s[log.decisions.fix_sequence[rests]]
    assert np.all(np.abs(at_s[rests] - newest_s) < 1.0)
    if onboard:  # the robot's decisions, again by the twin from what the robot told that it met
        twin = DecisionTwin(rig.tables(), shape(PATH), options.config)
        again = [decision for event in recording.events if (decision := twin.apply(event))]
        assert [one.differences(two) for one, two in zip(recording.decisions, again, strict=True)] == [[]] * 3


@from_ci
@pytest.mark.parametrize("transport", some(TRANSPORTS, 1))
def test_a_path_takes_over_though_a_part_of_it_is_lost(
    transport: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The part is sent again. Answers are handled in order: host and robot change at the same decision."""
    lost: list[str] = []

    def is_lost(frame: Frame) -> bool:
        if frame.name != "PATH" or "START" not in robot.names() or lost:
            return False
        lost.append(frame.name)
        return True

    robot = LiveRobot(clock=PatientClock(), on_for_s=100.0, deaf_to=is_lost)
    line = shape(PATH)
    beside = replace(line, name="beside", y_m=line.y_m + np.float32(0.01))
    check = LiveCheck()
    options = RunOptions(PlanConfig(), True, 3.5 * PERIOD_S, check, then=(NextPath(beside, 0.5 * PERIOD_S),))
    with rigged(transport, robot, tmp_path, monkeypatch) as there:
        session = LabSession(LabPort(there.wire, robot.clock))
        source = LivePool(robot.pulses, robot.clock)
        recording = run_session(session, source, rig.recording(line, options))
        assert session.port.resent >= 1
    assert lost == ["PATH"]
    assert [(change.path, change.decision) for change in recording.then] == [(beside, 1)]
    assert check.agreed == len(recording.decisions) == 4 and check.unchecked == 0


@pytest.mark.parametrize("transport", TRANSPORTS)
def test_a_run_goes_on_through_a_drop(
    transport: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot, options = LiveRobot(clock=PatientClock()), RunOptions(PlanConfig(), True, 1.5 * PERIOD_S)
    with rigged(transport, robot, tmp_path, monkeypatch) as there:
        session = LabSession(LabPort(there.wire, robot.clock))
        dropped = []

        def drop(_time_s: float, _index: int) -> None:
            if not dropped:
                dropped.append(True)
                there.drop()

        recording = run_session(
            session, LivePool(robot.pulses, robot.clock), rig.recording(shape(PATH), options), drop
        )
        assert there.wire.connections == 2
    assert recording.ended == TIME and len(recording.decisions) == 2
    assert sum(fix.robot_status == 0 for fix in recording.fixes) > 20


@pytest.mark.parametrize("transport", TRANSPORTS)
def test_a_robot_that_restarts_in_a_drop_has_ended_its_run(
    transport: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot, options = LiveRobot(clock=PatientClock()), RunOptions(PlanConfig(), True, 10 * PERIOD_S)
    with rigged(transport, robot, tmp_path, monkeypatch) as there:
        session = LabSession(LabPort(there.wire, robot.clock))

        def power(_time_s: float, _index: int) -> None:
            robot.restart()
            there.drop()

        pool = LivePool(robot.pulses, robot.clock)
        try:
            ended = run_session(session, pool, rig.recording(shape(PATH), options), power).ended
        except LinkError as error:  # it asked for the time between the restart and the drop
            ended = DROPPED if "restarted during the run" in str(error) else str(error)
    assert ended == DROPPED


@pytest.mark.parametrize("when", ["settling", "running"])
def test_whatever_ends_a_run_disarms_first(
    when: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot, options = LiveRobot(clock=PatientClock()), RunOptions(PlanConfig(), True, 10 * PERIOD_S)

    class Breaks(LivePool):
        def advance(self, until_s: float) -> list[object]:
            if "START" in robot.names() if when == "running" else "ARM" in robot.names():
                raise RuntimeError("the camera is gone")
            return list(super().advance(until_s))

    with rigged("serial", robot, tmp_path, monkeypatch) as there:
        session = LabSession(LabPort(there.wire, robot.clock))
        with pytest.raises(RuntimeError, match="the camera is gone"):
            run_session(session, Breaks(robot.pulses, robot.clock), rig.recording(shape(PATH), options))
        assert int(session.request("STATUS")["state"]) == STATE["DISARMED"]
    assert "DISARM" in robot.names()


@from_ci
def test_a_robot_that_does_not_say_so_is_told_of(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    robot, options = LiveRobot(clock=PatientClock()), RunOptions(PlanConfig(), True, 10 * PERIOD_S)
    with rigged("serial", robot, tmp_path, monkeypatch) as there:
        session = LabSession(LabPort(there.wire, robot.clock))

        def fall_silent(_time_s: float, _index: int) -> None:
            robot.mute = True
            raise KeyboardInterrupt

        with pytest.raises(LinkError, match="interrupted; the robot did not confirm DISARM: switch"):
            run_session(
                session, LivePool(robot.pulses, robot.clock), rig.recording(shape(PATH), options), fall_silent
            )


@from_ci
@pytest.mark.parametrize("onboard", some([True, False], 1), ids=lambda onboard: "core" if onboard else "twin")
def test_the_authors_dialect(onboard: bool, tmp_path: Path) -> None:
    """The authors' firmware fires whatever a line says, so the host keeps the limits."""
    frog, options = TextFrog(clock=PatientClock()), RunOptions(PlanConfig(), onboard, 2.5 * PERIOD_S)
    with (
        PtyLine(tmp_path / "robot", frog) as line,
        opened(Target("serial", str(line.path)), pulse_line(rig.tables().pulse_us)) as wire,
    ):
        core = TextRobot(wire, NativeRobot(rig.firmware("native").image, 4), rig.robot(), frog.clock)
        session = LabSession(core)
        recording = run_session(
            session, LivePool(frog.pulses, frog.clock), rig.recording(shape(PATH), options)
        )
        fired = len(frog.pulses)
        # A host that asks for more than the limits allow gets what they allow.
        session.request("ARM")
        for _ in range(8):
            session.ask("STROKE", {"action": 1})
            end_s = session.port.now_s + 0.3
            while session.time_s < end_s:
                session.step(end_s)
        session.request("DISARM")
        core.close()
    assert recording.ended == TIME and len(recording.decisions) == 3
    assert frog.lines[0][1] == f"p {rig.tables().pulse_us // 1000}"
    assert fired >= 4 and len(frog.pulses) > fired
    assert violations(rig.robot(), pulses_of(session.edges, math.inf)) == []
    # What the line delivered is what the log has, in its order.
    booked = [(edge.time_s, edge.limb) for edge in session.edges if edge.level]
    masks = [sum(1 << limb for at, limb in booked if at == at_s) for at_s in sorted({at for at, _ in booked})]
    assert [limb_mask for _, limb_mask, _ in frog.pulses] == masks
    tracked = recording.tracking()
    assert tracked.limit_violations == 0


@contextmanager
def command(line: PtyLine, pool: LivePool, *options: str) -> Iterator[subprocess.Popen[str]]:
    """``frogkick run`` with the robot on a line, and a tracker that pipes its fixes in until the end."""
    process = subprocess.Popen(
        [
            sys.executable, "-m", "frogkick.cli.main", "run", "--path", PATH, "--tables", rig.small_table(),
            "--robot", f"serial:{line.path}:115200", "--fixes", "stdin", *options,
        ],
        cwd=line.path.parent, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        text=True, start_new_session=True,
    )  # fmt: skip
    assert process.stdin is not None
    stdin, stop = process.stdin, threading.Event()

    def write(text: str) -> None:
        with suppress(BrokenPipeError):
            stdin.write(text)
            stdin.flush()

    tracker = threading.Thread(target=pool.lines, args=(write, stop), daemon=True)
    tracker.start()
    try:
        yield process
    finally:
        process.kill()
        stop.set()
        tracker.join()
        with suppress(BrokenPipeError):
            stdin.close()
        process.wait()
        for stream in (process.stdout, process.stderr):
            assert stream is not None
            stream.close()


@pytest.mark.skipif(sys.platform == "win32", reason="sends signals")
@pytest.mark.parametrize("number", some([signal.SIGINT, signal.SIGTERM], 1))
def test_a_signal_disarms_first(tmp_path: Path, number: signal.Signals) -> None:
    robot = LiveRobot()
    with PtyLine(tmp_path / "robot", robot) as line, command(line, LivePool(robot.pulses)) as process:
        deadline_s = time.monotonic() + 60.0
        while not robot.pulses and time.monotonic() < deadline_s:
            time.sleep(0.005)
        assert robot.pulses, "it never swam"
        asked_s = time.monotonic()
        os.kill(process.pid, number)
        assert process.stdout is not None and process.stderr is not None
        stdout, stderr = process.stdout.read(), process.stderr.read()
        assert (process.wait(), stdout) == (130, ""), stderr
        assert stderr.splitlines()[-1] == "frogkick: interrupted"
        assert robot.names()[-1] == "DISARM", "the last that the robot heard"
        assert robot.heard[-1][0] >= asked_s and robot.off_at
        assert int(robot.core.ask("STATUS")["state"]) == STATE["DISARMED"]


@from_ci
@pytest.mark.parametrize("dialect", some(DIALECTS, 1))
def test_a_whole_run_by_the_command(tmp_path: Path, dialect: str) -> None:
    """Fixes are piped in; numbers and a log come out."""
    robot = LiveRobot() if dialect == "frogkick" else TextFrog()
    options = ("--plan", "host", "--simulated-time", f"{1.5 * PERIOD_S}", "--json", "--out", "run.h5")
    with (
        PtyLine(tmp_path / "robot", robot) as line,
        command(line, LivePool(robot.pulses), "--dialect", dialect, *options) as process,
    ):
        assert process.stdout is not None and process.stderr is not None
        output, said = process.stdout.read(), process.stderr.read()
        assert process.wait() == 0, said
    # The core that drives the authors' robot begins with each run, and knows nothing of its limbs' heat.
    assert ("start check: limbs: after a time without supply" in said) == (dialect == "frog2022"), said
    numbers = json.loads(output)
    # Real time here: on a busy machine a decision may be missing.
    assert 1 <= numbers["decisions"] <= 2 and numbers["ended"] in (TIME, ENDED["STALE"])
    assert numbers["limit_violations"] == (0 if dialect == "frog2022" else None)
    log = read_run(tmp_path / "run.h5")
    assert log.truth is None and len(log.fixes.x_m) > 5


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("--robot ble:frogkick", "--robot ble:frogkick needs position fixes, and none are given: pipe"),
        ("--robot serial:/dev/none", "--fixes stdin"),
        ("--robot ble:frogkick --fixes camera", "--fixes is 'camera': choose stdin"),
        ("--robot ble:frogkick --fixes stdim", "did you mean 'stdin'"),
        ("--robot ble: --fixes stdin", "neither ble:NAME nor serial:PORT"),
        ("--robot ble:frogkick --world w.toml --fixes stdin", "--world 'w.toml' is for a simulated pool"),
        ("--robot pool --fixes stdin", "--fixes stdin is for a real robot"),
        ("--robot virtual --dialect frog2022", "--dialect frog2022 is for a real robot"),
        ("--robot serial:COM3 --dialect frog2023", "did you mean 'frog2022'"),
        ("--robot bel:frog", "--robot is 'bel:frog'"),
        (
            "--robot serial:/dev/none --fixes stdin --battery-v 3.9",
            "the battery has 3.9 V, 10.5 V is the least",
        ),
        (
            "--robot serial:COM3 --fixes pool --begin here",
            "--begin is for a robot in water, but --fixes pool is for a",
        ),
        (
            "--robot serial:COM3 --fixes pool --battery-v 12",
            "--battery-v is for a robot in water, but --fixes pool",
        ),
        ("--robot serial:COM3 --fixes pol", "did you mean 'pool'"),
        ("--robot pool --battery-v 12", "--battery-v 12.0 is for a real robot"),
        ("--robot pool --begin here", "--begin here is for a real robot"),
        ("--robot pool --key none.key", "--key none.key is for a real robot"),
        ("--robot serial:/dev/none --fixes stdin --key none.key", "no owner's key in 'none.key'"),
    ],
)
def test_what_does_not_go_together(capsys: pytest.CaptureFixture[str], options: str, words: str) -> None:
    output = frogkick(capsys, "run", "--tables", rig.small_table(), *options.split())
    assert (output.code, output.stdout) == (2, "")
    assert output.stderr.count("\n") == 1 and words in output.stderr
