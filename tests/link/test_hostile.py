"""The host with a device that lies: soon a line or a result comes out, which commands no terminal."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.cli.commands import frogkick
from tests.conftest import count
from tests.link.air import Peripheral, breathe
from tests.link.hostile import Hostile, Simulated, liar, packed, short
from tests.link.live_robot import LiveRobot
from tests.planner import synthetic
from tests.runs import rig

import frogkick as fk
from frogkick.core.errors import FrogkickError, printable
from frogkick.link.frames import Frame, FrameCollector
from frogkick.link.layout import Value, link_layout
from frogkick.link.log import LOG_BYTES_MAX, LogError, fetch_log
from frogkick.link.wire import ARRIVED_MAX, Delivery, Wire
from frogkick.paths import shape
from frogkick.planner.plan import PlanConfig
from frogkick.runs.chip_log import FetchedLog, write_log
from frogkick.runs.closed_loop import configure, run_session
from frogkick.runs.decision import events_of_frame
from frogkick.runs.lab_session import HELLO_TRIES, LabPort, LabSession
from frogkick.runs.pushing import UploadError, own, push, roll_back, upload
from frogkick.runs.record import RunOptions
from frogkick.runs.session import LinkError, Session
from frogkick.tables.image import open_image

OLD, NEW = (synthetic.affine_image(20, 9, seed) for seed in (1, 2))
TIME_MAX_S = 3000.0  # simulated; each command is waited for
ESCAPES = "\x1b[2J\x1b]0;x\x07"
ANSWERS = [name for name, message in link_layout().messages.items() if message.answer]


@pytest.fixture(autouse=True)
def home(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path_factory.mktemp("home")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(folder))
    return folder


def fetch(session: Session) -> dict[str, Any]:
    log = FetchedLog(str(session.hello()["robot_id"]), 1, fetch_log(session))
    write_log(Path(fk.link.auth.default_key_file()).parent / "log.h5", log)
    return log.summary()


def owned_and_released(session: Session) -> None:
    own(session)
    session.request("PARAM", {"parameter": 1, "value": 1.0})
    own(session, release=True)


def pushed_and_back(session: Session) -> None:
    push(session, open_image(NEW))
    roll_back(session)


COMMANDS: dict[str, Callable[[Session], object]] = {
    "status": lambda session: {**session.hello(), **session.request("STATUS")},
    "push": pushed_and_back,
    "own": owned_and_released,
    "fetch": fetch,
    "handshake": lambda session: session.handshake(open_image(OLD)),
    "rest": lambda session: session.rest(lambda _line: None, 60.0),
    "configure": lambda session: configure(session, PlanConfig(depth=1), False),
    "path": lambda session: session.send_path(shape("line")),
}


def outcome(session: Session, command: Callable[[Session], object]) -> object:
    """What a command gives; of an error its text, which is one printable line."""
    try:
        found = command(session)
    except FrogkickError as error:
        found = str(error)
        assert found and "\n" not in found
    assert repr(found) == printable(repr(found)) and session.time_s < TIME_MAX_S
    return found


@pytest.mark.parametrize("command", COMMANDS)
def test_each_command_with_an_honest_robot(command: str) -> None:
    """So that the tests below begin where a command works."""
    port = Hostile(Simulated(OLD), packed)
    session = Session(port)
    COMMANDS["status"](session)
    COMMANDS[command](session)
    assert port.commands < 500 and session.time_s < 60.0


@pytest.mark.parametrize("command", COMMANDS)
@settings(max_examples=count(25, 1000, 8), deadline=None)
@given(
    seed=st.integers(0, 2**32),
    rate=st.sampled_from([1.0, 0.3, 0.05]),
    names=st.sets(st.sampled_from(ANSWERS), min_size=1),
)
def test_whatever_a_device_answers(command: str, seed: int, rate: float, names: set[str]) -> None:
    port = Hostile(Simulated(OLD), liar(random.Random(seed), rate, names))
    outcome(Session(port), COMMANDS[command])


@pytest.mark.parametrize("status", [-128, -79, -66, -65, 0, 1])
@pytest.mark.parametrize("name", ANSWERS)
def test_an_answer_of_one_byte(name: str, status: int) -> None:
    """It is a refusal with its status, or no answer where it does not refuse."""

    def change(frame: Frame) -> bytes:
        return short(frame, status) if frame.name == name else packed(frame)

    for command in COMMANDS.values():
        session = Session(Hostile(Simulated(OLD), change))
        found = outcome(session, command)
        if isinstance(found, str) and name not in ("DISARM", "STATUS", "CHALLENGE", "KEY"):
            named = link_layout().status_name(status)
            assert name in found and (named in found or status >= 0)


@settings(max_examples=count(6, 200, 3), deadline=None)
@given(
    seed=st.integers(0, 2**32),
    rate=st.sampled_from([1.0, 0.3, 0.05]),
    names=st.sampled_from(
        [
            {"FIX"}, {"DECISION"}, {"REFUSED", "ENDED"}, {"START", "ARM", "STATUS"}, {"PATH", "PARAM"},
            {"FIX", "DECISION", "STATUS", "ENDED", "REFUSED"},
        ]
    ),
    onboard=st.booleans(),
)  # fmt: skip
def test_a_run_with_a_device_that_lies(seed: int, rate: float, names: set[str], onboard: bool) -> None:
    pool = rig.new_pool("line")
    port = Hostile(rig.port("pool"), liar(random.Random(seed), rate, names))
    options = RunOptions(PlanConfig(depth=1), onboard, 4.0)
    recording = rig.recording(shape("line"), options, pool)

    def run(session: Session) -> str:
        run_session(session, pool, recording)
        return recording.log().notes

    session = Session(port)
    outcome(session, run)
    assert session.time_s < 60.0


@pytest.mark.parametrize("status", ["MAC", "AUTH", "LENGTH", "UNKNOWN", "STATE"])
def test_a_fix_that_the_robot_refuses_at_its_door_is_no_input_of_its_estimator(status: str) -> None:
    values: dict[str, Value] = {"status": link_layout().status[status], "fix_sequence": 0, "capture_us": 0}
    assert events_of_frame(Frame("FIX", "answer", 7, values), {7: rig.robot().limbs}) == []  # type: ignore[dict-item]


def test_a_start_that_lies_far_ahead_keeps_the_host_for_no_longer() -> None:
    def change(frame: Frame) -> bytes:
        later = {"first_decision_us": 2**52} if frame.name == "START" else {}
        return packed(frame, **later)

    pool, session = rig.new_pool("line"), Session(Hostile(rig.port("pool"), change))
    options = RunOptions(PlanConfig(depth=1), True, 2.0)
    run_session(session, pool, rig.recording(shape("line"), options, pool))
    assert session.time_s < 5.0


def test_limbs_that_rest_for_an_hour() -> None:
    session = Session(Hostile(Simulated(), lambda frame: packed(frame, rest_us=2**32 - 1)))
    with pytest.raises(LinkError, match=r"rest for 4295.0 s, its description for 31.0 s at most"):
        session.rest(lambda _line: None, 31.0)
    assert session.time_s < 1.0


class Asked:
    """A device that answers each command by a function of its fields."""

    window = 1

    def __init__(self, answer: Callable[[str, dict[str, Value]], dict[str, Value]]) -> None:
        self.answer, self.count = answer, 0

    def ask_all(self, name: str, many: Any, timeout_s: float = 1.0) -> list[dict[str, Value]]:
        self.count += len(many)
        assert self.count < 3 * LOG_BYTES_MAX // 208
        return [self.answer(name, values or {}) for values, _ in many]


@pytest.mark.parametrize(
    ("begin", "end", "at", "byte", "words"),
    [
        (6, 10, 5, "abc", "from byte 6 to 10 has 3 bytes from 5 on"),
        (0, 2**32 - 1, None, "x" * 208, "from byte 0 to 4294967295"),
        (0, 5000, None, "", "has 0 bytes from 0 on"),
        (0, 5000, None, "x", "has 1 bytes from 0 on"),
        (0, 5000, 7, "x" * 208, "from 7 on"),
        (0, 5000, 0, "x" * 208, "does not end"),
        (5000, 0, None, "x" * 208, "which no log has"),
    ],
)
def test_a_log_that_is_none(begin: int, end: int, at: int | None, byte: str, words: str) -> None:
    def answer(_name: str, values: dict[str, Value]) -> dict[str, Value]:
        offset = values["offset"] if at is None else at
        return {"status": 0, "offset": offset, "begin": begin, "end": end, "lost": 0, "byte": byte}

    with pytest.raises(LogError, match=words):
        fetch_log(Asked(answer))


@pytest.mark.parametrize("wanted", [0, 128, 127, 2**32 - 1, len(NEW) + 1])
def test_a_table_that_is_never_complete(wanted: int) -> None:
    def answer(name: str, _values: dict[str, Value]) -> dict[str, Value]:
        if name == "TABLE_STATUS":
            return {"status": 0, "slot_bytes": 2**31, "running_crc": 1, "built_in_crc": 2, "previous_crc": 0}
        return {"status": 0, "next_offset": wanted, "error": 0, "table_crc": 0}

    asked = Asked(answer)
    with pytest.raises(UploadError, match=f"wants byte {wanted} of {len(NEW)} next"):
        upload(asked, NEW)
    assert asked.count < 4 * len(NEW) // 128


class Deaf(Wire):
    """A wire whose bytes nobody takes."""

    def send(self, encoded: bytes, how: Delivery) -> None: ...
    def close(self) -> None: ...


def test_bytes_that_nobody_takes_do_not_fill_the_memory() -> None:
    wire = Deaf()
    for _ in range(3 * ARRIVED_MAX // 1000):
        wire.put(bytes(1000))
    assert ARRIVED_MAX - 1000 <= sum(len(data) for _, data in wire.receive(0.0)) <= ARRIVED_MAX
    wire.put(b"later")
    assert [data for _, data in wire.receive(0.0)] == [b"later"]


class Flapping(Deaf):
    """A wire that comes up and drops again at once, as long as somebody listens; its time is simulated."""

    name, window = "serial:flapping", 1

    def __init__(self) -> None:
        super().__init__()
        self.now_s = 0.0
        self.connected()

    def receive(self, timeout_s: float) -> list[tuple[float, bytes]]:
        self.now_s += max(0.001, timeout_s)
        assert self.now_s < 1000.0
        self.connected()
        self.lost()
        return []


def test_a_device_that_comes_and_goes_ends_the_session() -> None:
    wire = Flapping()
    session = LabSession(LabPort(wire, lambda: wire.now_s))
    with pytest.raises(LinkError, match="serial:flapping is connected and does not answer HELLO"):
        session.hello()
    assert wire.connections > 10 and wire.now_s < 2 * HELLO_TRIES * session.patience_s


class Escapes(LiveRobot):
    """A robot with terminal escapes for its id."""

    def feed(self, data: bytes) -> bytes:
        made = b""
        for frame in FrameCollector().feed(super().feed(data)):
            made += packed(frame, **{"robot_id": ESCAPES} if frame.name == "HELLO" else {})
        return made


class OneByte(LiveRobot):
    """A robot that answers each command with one byte."""

    def feed(self, data: bytes) -> bytes:
        return b"".join(short(frame, -66) for frame in FrameCollector().feed(super().feed(data)))


@pytest.fixture
def strangers(monkeypatch: pytest.MonkeyPatch) -> None:
    breathe(
        monkeypatch,
        Peripheral(LiveRobot(), "frog"),
        Peripheral(OneByte(), "short"),
        Peripheral(Escapes(), "\x1b]0;evil\x07\u202e"),
    )


@pytest.mark.usefixtures("strangers")
def test_a_scan_outlives_each_stranger_and_prints_no_escapes(capsys: pytest.CaptureFixture[str]) -> None:
    output = frogkick(capsys, "scan", "--seconds", "0.5")
    assert output.code == 0 and "\x1b" not in output.stdout + output.stderr
    lines = {line.partition("  ")[0]: line for line in output.stdout.splitlines()}
    assert set(lines) == {"ble:frog", "ble:short", r"ble:\x1b]0;evil\x07\u202e"}
    assert "frog2022, table" in lines["ble:frog"] and "DISARMED" in lines["ble:frog"]
    assert "the robot refuses HELLO: UNKNOWN" in lines["ble:short"]
    assert r"\x1b[2J\x1b]0;x\x07, table" in lines[r"ble:\x1b]0;evil\x07\u202e"]


@pytest.mark.usefixtures("strangers")
def test_a_name_is_taken_as_a_scan_prints_it() -> None:
    with fk.connect(r"ble:\x1b]0;evil\x07\u202e") as bot:
        assert bot.status()["robot_id"] == r"\x1b[2J\x1b]0;x\x07"
