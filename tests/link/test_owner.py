"""A robot with an owner's key, by the commands and over real wires; and hosts without the key."""

from __future__ import annotations

import random
import stat
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from tests.cli.commands import Outcome, frogkick
from tests.conftest import from_ci, some
from tests.core.store_rig import RECORD, STEP
from tests.link.live_robot import LiveRobot, PatientClock
from tests.link.rigged import TRANSPORTS, rigged
from tests.link.swim import PATH, LivePool
from tests.planner import synthetic
from tests.runs import rig

import frogkick as fk
from frogkick.core.files import write_bytes
from frogkick.link import auth
from frogkick.link.frames import Frame, pack_frame
from frogkick.link.layout import link_layout
from frogkick.link.pty_line import PtyLine
from frogkick.paths import shape
from frogkick.planner.plan import PlanConfig
from frogkick.runs.closed_loop import run_session
from frogkick.runs.lab_session import LabPort, LabSession, lab_session
from frogkick.runs.pushing import own, upload
from frogkick.runs.record import DISARMED, RunOptions
from frogkick.runs.session import LinkError
from frogkick.tables.image import open_image

OLD, NEW = (synthetic.affine_image(20, 9, seed) for seed in (1, 2))


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A user without a key."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "home"))
    return tmp_path / "home"


@pytest.fixture
def robot() -> LiveRobot:
    return LiveRobot(OLD)


@pytest.fixture
def target(robot: LiveRobot, tmp_path: Path) -> Iterator[str]:
    with PtyLine(tmp_path / "robot", robot) as there:
        yield f"serial:{there.path}"


@pytest.fixture
def new(tmp_path: Path) -> Path:
    write_bytes(tmp_path / "new.fkt", NEW)
    return tmp_path / "new.fkt"


def refused(outcome: Outcome, *words: str) -> None:
    assert (outcome.code, outcome.stdout, outcome.stderr.count("\n")) == (2, "", 1), outcome.stderr
    for word in words:
        assert word in outcome.stderr


def owner_of(robot: LiveRobot) -> bytes:
    return bytes(b for word in robot.flash.store.record.owner_key for b in int(word).to_bytes(4, "little"))


@from_ci
def test_a_robot_gets_an_owner_and_loses_him(
    robot: LiveRobot, target: str, new: Path, home: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = frogkick(capsys, "own", "--robot", target)
    key = home / "frogkick" / "owner.key"
    assert output.code == 0 and str(key) in output.stdout and "copy" in output.stdout
    assert owner_of(robot) == auth.read_keys(key)[0].secret != bytes(32)
    if sys.platform != "win32":
        assert stat.S_IMODE(key.stat().st_mode) == 0o600
    output = frogkick(capsys, "push", new, "--robot", target)
    assert output.code == 0 and robot.flash.image == NEW, output.stderr
    again = frogkick(capsys, "own", "--robot", target, "--json")
    assert again.json == {"robot": target, "owned": True, "key": str(key)}
    assert owner_of(robot) == auth.read_keys(key)[0].secret

    moved = tmp_path / "moved.key"
    key.rename(moved)
    refused(
        frogkick(capsys, "push", "--rollback", "--robot", target), "only from its owner", str(key), "--key"
    )
    refused(frogkick(capsys, "own", "--robot", target, "--release"), "only from its owner")
    other = tmp_path / "other.key"
    other.write_text("17" * 32)
    refused(
        frogkick(capsys, "push", "--rollback", "--robot", target, "--key", other),
        "other.key",
        "not this robot",
    )
    refused(frogkick(capsys, "own", "--robot", target, "--key", other), "not this robot's")
    none = tmp_path / "none.key"
    refused(frogkick(capsys, "own", "--robot", target, "--key", none), "only from its owner", str(none))
    assert not none.exists()
    assert robot.flash.image == NEW and owner_of(robot) == auth.read_keys(moved)[0].secret

    output = frogkick(capsys, "push", "--rollback", "--robot", target, "--key", moved)
    assert output.code == 0 and robot.flash.image == OLD
    robot.restart()
    output = frogkick(capsys, "own", "--robot", target, "--release", "--key", moved, "--json")
    assert output.json == {"robot": target, "owned": False, "key": None} and owner_of(robot) == bytes(32)
    assert frogkick(capsys, "push", new, "--robot", target).code == 0


@pytest.mark.parametrize(
    ("content", "words"),
    [("", "64 hexadecimal digits"), ("17" * 31, "64 hexadecimal digits"), ("x" * 64, "is not an owner's key"),
     ("00" * 32, "not all zero")],
)  # fmt: skip
def test_a_file_that_holds_no_key(
    target: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], content: str, words: str
) -> None:
    (tmp_path / "bad.key").write_text(content)
    refused(frogkick(capsys, "own", "--robot", target, "--key", tmp_path / "bad.key"), "bad.key", words)


@pytest.mark.parametrize("command", ["push --rollback", "push NEW", "own"])
def test_a_malformed_key_is_refused_before_the_robot_is_looked_for(
    new: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    (tmp_path / "bad.key").write_text("no key")
    words = [str(new) if word == "NEW" else word for word in command.split()]
    output = frogkick(capsys, *words, "--robot", "serial:/dev/none", "--key", tmp_path / "bad.key")
    refused(output, "bad.key", "64 hexadecimal digits")


def test_a_key_that_cannot_be_kept_is_not_given(
    robot: LiveRobot, target: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    refused(
        frogkick(capsys, "own", "--robot", target, "--key", tmp_path / "file" / "owner.key"),
        "cannot be written",
    )
    assert owner_of(robot) == bytes(32)


def test_no_message_holds_a_key(robot: LiveRobot, target: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Not even if the robot refuses the command that carries it."""
    robot.core.core.fk_test_random_fails = 1
    try:
        output = frogkick(capsys, "own", "--robot", target)
    finally:
        robot.core.core.fk_test_random_fails = 0
    refused(output, "the robot refuses KEY: UNKNOWN")
    (key,) = auth.read_keys(auth.default_key_file())
    assert key.secret.hex() not in output.stderr and "key_0" not in output.stderr
    assert "key=" not in repr(auth.CommandCodes(key.secret)) and "secret" not in repr(key)


def test_what_it_tells_and_what_it_wrote_down_anybody_may_read(robot: LiveRobot, target: str) -> None:
    with fk.connect(target) as bot:
        assert bot.status()["owner"] == link_layout().owner["OPEN"]
        bot.own()
        assert bot.status()["owner"] == link_layout().owner["KEY"]
    (auth.default_key_file()).unlink()
    with fk.connect(target) as bot:
        assert bot.status()["owner"] == link_layout().owner["KEY"]
        with pytest.raises(LinkError, match="only from its owner"):
            bot.push(rig.small_table())


def names_of(robot: LiveRobot) -> set[str]:
    """The commands that it has received since the last call."""
    names = set(robot.names())
    robot.heard.clear()
    return names


def forget(robot: LiveRobot) -> None:
    """Its flash is as new, and it starts again."""
    robot.flash.memory[:] = b"\xff" * len(robot.flash.memory)
    robot.restart()
    robot.heard.clear()


NO_CODE = {"HELLO", "STATUS", "DISARM"}


@pytest.mark.parametrize("has_key", [True, False])
def test_a_robot_whose_flash_has_lost_the_key_says_what_to_do(
    robot: LiveRobot,
    target: str,
    new: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    has_key: bool,
) -> None:
    if has_key:
        assert frogkick(capsys, "own", "--robot", target).code == 0
    else:
        assert robot.flash.upload(NEW) == "OK"
    at = (robot.flash.store.place - 1) * STEP
    for copy in range(2):
        robot.flash.memory[at + copy * RECORD] = bytes([robot.flash.memory[at + copy * RECORD][0] ^ 1])
    robot.restart()
    robot.heard.clear()
    for arguments in (("own",), ("own", "--release"), ("push", new), ("push", "--rollback")):
        refused(frogkick(capsys, *arguments, "--robot", target), "lost the owner's key", "erase its chip")
    assert names_of(robot) <= NO_CODE


def test_each_robot_has_a_key_of_its_own_in_one_file(
    robot: LiveRobot, target: str, new: Path, home: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A device that says that it has no key never hears one that opens another robot."""
    second = LiveRobot(OLD)
    with PtyLine(tmp_path / "second", second) as there:
        other = f"serial:{there.path}"
        for one in (target, other, target):
            assert frogkick(capsys, "own", "--robot", one).code == 0
        assert owner_of(robot) != owner_of(second)
        heard = [bytes(auth.from_words("key", f.values, 8)) for _, f in second.heard if f.name == "KEY"]
        assert heard == [owner_of(second)]
        assert [f.name for _, f in robot.heard].count("KEY") == 1, "its owner again: it keeps its key"
        keys = auth.read_keys(home / "frogkick" / "owner.key")
        assert {key.place: key.secret for key in keys} == {target: owner_of(robot), other: owner_of(second)}
        for one in (other, target):
            assert frogkick(capsys, "push", new, "--robot", one).code == 0
        assert frogkick(capsys, "own", "--robot", other, "--release").code == 0
        assert frogkick(capsys, "push", "--rollback", "--robot", target).code == 0
    assert [key.place for key in auth.read_keys(home / "frogkick" / "owner.key")] == [target, ""]


@pytest.mark.parametrize("given", [False, True])
def test_a_robot_that_has_lost_its_key_gets_no_command_that_needs_one(
    robot: LiveRobot, target: str, new: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], given: bool
) -> None:
    key = ("--key", tmp_path / "mine.key") if given else ()
    assert frogkick(capsys, "own", "--robot", target, *key).code == 0
    first = owner_of(robot)
    forget(robot)
    for command in (("push", new), ("push", "--rollback"), ("own",)):
        refused(
            frogkick(capsys, *command, "--robot", target, *key),
            f"the robot at {target} says that it has no owner's key", "--again", "--release",
        )  # fmt: skip
        assert names_of(robot) <= NO_CODE
    refused(frogkick(capsys, "own", "--robot", target, *key, "--again", "--release"), "one of the two")

    assert frogkick(capsys, "own", "--robot", target, *key, "--again").code == 0
    assert owner_of(robot) not in (first, bytes(32))
    assert frogkick(capsys, "push", new, "--robot", target, *key).code == 0

    forget(robot)
    assert frogkick(capsys, "own", "--robot", target, *key, "--release").code == 0
    assert names_of(robot) <= NO_CODE
    assert frogkick(capsys, "push", new, "--robot", target).code == 0 and owner_of(robot) == bytes(32)
    file = key[1] if given else auth.default_key_file()
    keys = auth.read_keys(Path(file))
    assert first in [one.secret for one in keys] and not any(one.place for one in keys)


def test_a_key_is_given_for_a_robot_that_has_none(
    robot: LiveRobot, target: str, new: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "old.key"
    file.write_text("17" * 32)
    for command in (("push", new), ("push", "--rollback")):
        output = frogkick(capsys, *command, "--robot", target, "--key", file)
        refused(output, "old.key", "the robot says that it has none", "leave out --key")
        assert names_of(robot) <= NO_CODE
    assert frogkick(capsys, "own", "--robot", target, "--key", file).code == 0
    old, mine = auth.read_keys(file)
    assert (old.secret, old.place) == (b"\x17" * 32, "")
    assert (mine.secret, mine.place) == (owner_of(robot), target) and mine.secret != old.secret


def test_a_run_does_not_arm_a_robot_that_has_lost_its_key(
    robot: LiveRobot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with rigged("ble", robot, tmp_path, monkeypatch) as there:
        own(lab_session(there.wire))
        (key,) = auth.read_keys(auth.default_key_file())
        assert key.place == there.target
        forget(robot)
        with pytest.raises(LinkError, match="says that it has no owner's key"):
            lab_session(there.wire).handshake(open_image(OLD))
    assert names_of(robot) <= NO_CODE


@pytest.mark.parametrize("transport", some(TRANSPORTS, 1))
def test_a_run_of_its_owner(transport: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    robot = LiveRobot(clock=PatientClock(), on_for_s=100.0)
    period_s = rig.tables().period_us * 1e-6
    with rigged(transport, robot, tmp_path, monkeypatch) as there:
        session = LabSession(LabPort(there.wire, robot.clock))
        own(session)
        source = LivePool(robot.pulses, robot.clock)
        options = RunOptions(PlanConfig(depth=2), True, 1.5 * period_s)
        recording = run_session(session, source, rig.recording(shape(PATH), options))
    assert len(recording.decisions) == 2 and robot.pulses
    assert sum(fix.robot_status == 0 for fix in recording.fixes) > 10


@contextmanager
def owners(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[LabSession, LiveRobot]]:
    """A robot on a serial line, and a session of its owner's."""
    robot = LiveRobot(clock=PatientClock(), on_for_s=100.0)
    with rigged("serial", robot, folder, monkeypatch) as there:
        session = LabSession(LabPort(there.wire, robot.clock))
        own(session)
        yield session, robot


def frame_of_a_stranger(robot: LiveRobot, name: str, number: int = 0) -> None:
    values = auth.words("nonce", number.to_bytes(16, "big")) if name == "CHALLENGE" else {}
    robot.feed(pack_frame(name, "command", number & 0xFF, values))


def test_a_conversation_that_has_ended_is_begun_again_unasked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of its own DISARM the host knows; of a stranger's, a lost connection and silence it is told."""
    with owners(tmp_path, monkeypatch) as (session, robot):

        def silence() -> None:
            robot.core.memory.heard_us = 0

        def strangers() -> None:
            for number in range(50):
                frame_of_a_stranger(robot, "CHALLENGE", number)
            frame_of_a_stranger(robot, "DISARM")

        for end in (
            lambda: session.request("DISARM"),
            strangers,
            lambda: robot.core.core.fk_robot_note_link_lost(robot.core.memory),
            silence,
        ):
            session.request("ARM")
            end()
            session.set_parameters({"LEVEL_WEIGHT": 0.5})
            session.request("ARM")
            assert robot.core.memory.state == link_layout().state["ARMED"]
            before = len(robot.heard)
            session.request("STATUS")
            session.set_parameters({"LEVEL_WEIGHT": 0.6})
            assert "CHALLENGE" not in robot.names()[before:], "one conversation for all that follows"


def test_a_robot_that_is_disarmed_without_end_is_told_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A stranger switches it off before every command: the host gives up."""
    with owners(tmp_path, monkeypatch) as (session, robot):

        def disarmed_before(frame: Frame) -> bool:
            if frame.name == "ARM":
                frame_of_a_stranger(robot, "DISARM")
            return False

        robot.deaf_to = disarmed_before
        with pytest.raises(LinkError, match="refuses ARM: MAC"):
            session.request("ARM")
        assert robot.names().count("ARM") == 3


@pytest.mark.parametrize("onboard", [True, False])
@pytest.mark.parametrize(
    ("happens", "words"),
    [
        ("restart", "restarted during the run"),
        ("DISARM", DISARMED),
        ("another host", "another host that has"),
    ],
)
def test_a_run_that_its_owner_loses(
    happens: str, words: str, onboard: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The robot takes his commands no longer; he hears it at his next one, not at the run's end."""
    with owners(tmp_path, monkeypatch) as (session, robot):

        def decided(_time_s: float, _index: int) -> None:
            if happens == "restart":
                robot.restart()
            elif happens == "DISARM":
                frame_of_a_stranger(robot, "DISARM")
            else:  # as it would take over after a STOP
                frame_of_a_stranger(robot, "STOP")
                key = auth.read_keys(auth.default_key_file())[0].secret
                robot.core.auth = None
                values = robot.core.ask("CHALLENGE", auth.words("nonce", bytes(16)))
                robot.core.auth = auth.begin(key, bytes(16), values)
                robot.core.ask("ARM")

        recording = rig.recording(shape(PATH), RunOptions(PlanConfig(depth=1), onboard, 20 * rig.PERIOD_S))
        source = LivePool(robot.pulses, robot.clock)
        if words is DISARMED:
            run_session(session, source, recording, decided)
            assert recording.ended == DISARMED
        else:
            with pytest.raises(LinkError, match=words):
                run_session(session, source, recording, decided)
        assert len(recording.decisions) == 1 and robot.left_alone()


@pytest.mark.parametrize("transport", TRANSPORTS)
def test_a_table_of_its_owner_over_a_link_that_loses_frames(
    transport: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Frames and answers are lost, so commands come again and out of order. Each acts once."""
    rng = random.Random(4)

    def lost(frame: Frame) -> bool:
        return frame.name.startswith("TABLE_CHUNK") and rng.random() < 0.1

    robot = LiveRobot(OLD, deaf_to=lost)
    with rigged(transport, robot, tmp_path, monkeypatch) as there:
        session = lab_session(there.wire)
        own(session)
        assert upload(session, NEW).bytes_sent == len(NEW)
        assert session.port.resent > 0  # type: ignore[attr-defined]
    assert robot.flash.image == NEW
