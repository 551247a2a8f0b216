"""Talking with a robot in simulated time: commands with their answers, events, a pool moving along."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path as FilePath

from frogkick.core.errors import FrogkickError
from frogkick.core.poses import Fix
from frogkick.link import auth
from frogkick.link.frames import Frame, hello, pack_frame, path_frames
from frogkick.link.layout import Value, link_layout
from frogkick.link.wire import Edge, RobotPort
from frogkick.paths import Path
from frogkick.tables.image import Tables

STEP_S = 0.002
ANSWER_TIMEOUT_S = 1.0
HELLO_TIMEOUT_S = 0.05
HELLO_TRIES = 20
DISARM_TRIES = 3


class LinkError(FrogkickError):
    """The robot refused a command or did not answer."""


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Ctrl-C does nothing meanwhile."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


Asked = tuple[dict[str, Value] | None, Sequence[Sequence[Value]]]
"""Values and rows of a command."""


@dataclass(frozen=True)
class Arrival:
    """A frame from the robot and when its last byte came, robot time."""

    time_s: float
    frame: Frame


@dataclass
class Session:
    """One conversation with a robot. ``on_step`` lets a pool live through the same time.

    Attributes:
        port: the robot.
        on_step: called after each step with the new time and the pin edges of that step.
        edges: every pin edge so far.
        conversation: another number for each session with the same robot: sequence numbers begin anew.
        key_file: the owner's key, for a robot that has one; None: the user's own, see ``default_key_file``.
    """

    port: RobotPort
    on_step: Callable[[float, Sequence[Edge]], None] = lambda _time_s, _edges: None
    time_s: float = 0.0
    edges: list[Edge] = field(default_factory=list)
    conversation: int = 1
    key_file: FilePath | None = None
    _auth: auth.Conversation | None = None
    _sequence: int = 0
    _inbox: list[Arrival] = field(default_factory=list)

    def step(self, until_s: float) -> None:
        """Let robot and pool live until a time."""
        self.port.advance(until_s)
        edges = self.port.edges()
        self.edges += edges
        self._inbox += [Arrival(time_s, frame) for time_s, frame in self.port.frames()]
        self.on_step(until_s, edges)
        self.time_s = until_s

    def post(
        self,
        name: str,
        values: dict[str, Value] | None = None,
        rows: Sequence[Sequence[Value]] = (),
        at_s: float | None = None,
    ) -> int:
        """Send a command without waiting; return its sequence number."""
        self._sequence = (self._sequence + 1) & 0xFF
        encoded = pack_frame(name, "command", self._sequence, values, rows, self._auth)
        self.port.send(encoded, self.time_s if at_s is None else at_s)
        return self._sequence

    def post_fix(self, fix: Fix, at_s: float) -> int:
        """Send a position fix; its age counts from the picture to this moment."""
        values: dict[str, Value] = {
            "fix_sequence": fix.sequence,
            "quality": 1,
            "capture_age_us": max(0, round((at_s - fix.capture_s) * 1e6)),
            "x_m": fix.x_m,
            "y_m": fix.y_m,
            "heading_rad": fix.heading_rad,
        }
        return self.post("FIX", values, at_s=at_s)

    def take(self, *names: str) -> list[Arrival]:
        """Take the frames of these names that have arrived, in order."""
        taken = [arrival for arrival in self._inbox if arrival.frame.name in names]
        self._inbox = [arrival for arrival in self._inbox if arrival.frame.name not in names]
        return taken

    def request(
        self, name: str, values: dict[str, Value] | None = None, rows: Sequence[Sequence[Value]] = ()
    ) -> dict[str, Value]:
        """Send a command and live until its answer.

        Raises:
            LinkError: no answer within a second, or an answer that refuses.
        """
        answer = self.ask(name, values, rows)
        status = int(answer["status"])
        if status < 0:
            said = " ".join((name, str(values))) if values and name != "KEY" else name  # which is a secret
            raise LinkError(
                f"the robot refuses {said}: {link_layout().status_name(status)}{self._why(status)}"
            )
        return answer

    def _why(self, status: int) -> str:
        """Of a refusal that names no reason itself: what is behind it, and what to do."""
        if status in (link_layout().status["AUTH"], link_layout().status["MAC"]):
            return ", as it takes commands from its owner alone, and does not know this host: try again"
        if status != link_layout().status["FAULT"]:
            return ""
        told = self.ask("STATUS")
        return f", internal error {link_layout().fault_name(int(told['fault']))} ({told['fault_detail']})"

    def ask(
        self,
        name: str,
        values: dict[str, Value] | None = None,
        rows: Sequence[Sequence[Value]] = (),
        timeout_s: float = ANSWER_TIMEOUT_S,
    ) -> dict[str, Value]:
        """Like ``request``, but a refusal is an answer too.

        Raises:
            LinkError: no answer in time.
        """
        return self.ask_all(name, [(values, rows)], timeout_s)[0]

    @property
    def window(self) -> int:
        """Commands that may be asked at once: a UART's chip takes no more than one."""
        return 1

    def ask_all(
        self, name: str, many: Sequence[Asked], timeout_s: float = ANSWER_TIMEOUT_S
    ) -> list[dict[str, Value]]:
        """Ask several times the same at once, and wait for all answers.

        Args:
            name: of the command.
            many: values and rows of each.
            timeout_s: for all together.

        Raises:
            LinkError: an answer is missing.
        """
        sequences = [self.post(name, values, rows) for values, rows in many]
        told: dict[int, dict[str, Value]] = {}
        deadline_s = self.time_s + timeout_s
        while self.time_s < deadline_s:
            self.step(self.time_s + STEP_S)
            if self._answered(name, sequences, told):
                return [told[sequence] for sequence in sequences]
        raise LinkError(f"no answer to {name} within {timeout_s:g} s: is the firmware running?")

    def _answered(self, name: str, sequences: Sequence[int], told: dict[int, dict[str, Value]]) -> bool:
        """Take the answers that have come; whether these are all."""
        for arrival in self.take(name):
            frame = arrival.frame
            if frame.kind == "answer" and frame.sequence in sequences:
                told[frame.sequence] = frame.values
            else:
                self._inbox.append(arrival)
        return len(told) == len(sequences)

    def make_safe(self) -> bool:
        """DISARM, whatever was going on; False where the robot does not say that its outputs are off.

        Nothing but the robot lives on meanwhile, and Ctrl-C does nothing.
        """
        self.on_step = lambda _time_s, _edges: None
        with uninterrupted():
            for _ in range(DISARM_TRIES):
                try:
                    self.ask("DISARM")
                except FrogkickError:
                    continue
                return True  # disarmed, or in a fault, which has its outputs off as well
        return False

    def reconnected(self) -> bool:
        """The connection has dropped and come back since this was asked last; never in simulated time."""
        return False

    def real_time_guard(self) -> AbstractContextManager[None]:
        """What a run goes on in; in simulated time nothing hurries."""
        return nullcontext()

    @property
    def gaps(self) -> int:
        """How often something that the robot said may have been lost; 0 in simulated time."""
        return 0

    def robot_clock_offset_us(self) -> int:
        """Robot time minus this session's: 0 in simulated time."""
        return 0

    def check_clock_sync(self, capture_s: float, capture_us: int) -> None:
        """Check that the session's clock (s) and the robot's (us) give a fix the same capture time.

        In simulated time there is one clock.
        """

    def hello(self) -> dict[str, Value]:
        """HELLO, and refuse a robot that speaks another protocol.

        Raises:
            LinkError: no answer, or another protocol.
        """
        told = self._hello()
        ours = link_layout().protocol_version
        if told["protocol_version"] != ours:
            raise LinkError(
                f"the robot speaks protocol {told['protocol_version']}, this host {ours}: flash it again"
            )
        return told

    def authenticate(self) -> None:
        """Prove to a robot with an owner's key that this host has it too; where it has none, nothing.

        Raises:
            LinkError: it has a key, and this host another one or none; or it does not answer.
            InputError: the key's file cannot be read.
        """
        if int(self.request("STATUS")["owner"]) == link_layout().owner["OPEN"]:
            self._auth = None
            return
        file = self.key_file or auth.default_key_file()
        if self.key_file is None and not file.exists():
            raise LinkError(
                "the robot takes commands from its owner alone, and there is no owner's key in "
                f"{str(file)!r}: give the key's file (--key)"
            )
        self._prove(auth.read_key(file), str(file))

    def _prove(self, key: bytes, name: str) -> None:
        nonce = auth.challenge()
        self._auth = auth.begin(key, nonce, self.request("CHALLENGE", auth.words("nonce", nonce)))
        if self._auth is None:
            raise LinkError(
                f"the owner's key in {name!r} is not this robot's: give the file of its own (--key)"
            )

    def handshake(self, tables: Tables) -> dict[str, Value]:
        """Handshake: HELLO, and refuse a robot with other tables than ours.

        Raises:
            LinkError: another protocol, robot or table.
        """
        told = self.hello()
        tables.require_robot(str(told["robot_id"]))
        if told["table_crc"] != tables.crc32:
            period_s = [int(us) * 1e-6 for us in (told["period_us"], tables.period_us)]
            of = f" and a period of {period_s[0]:.3f} s, ours {period_s[1]:.3f} s"
            raise LinkError(
                f"the robot's table has CRC-32 {told['table_crc']:08x}, ours {tables.crc32:08x}"
                f"{of if period_s[0] != period_s[1] else ''}: "
                "build the firmware with this table, or send it ('frogkick push')"
            )
        return told

    def _hello(self) -> dict[str, Value]:
        """A robot that has just been switched on checks its table first, and does not listen meanwhile."""
        values = hello(self.conversation)
        for _ in range(HELLO_TRIES - 1):
            try:
                return self.ask("HELLO", values, timeout_s=HELLO_TIMEOUT_S)
            except LinkError:
                continue
        return self.ask("HELLO", values, timeout_s=HELLO_TIMEOUT_S)

    def rest(self, tell: Callable[[str], None]) -> None:
        """Wait until the robot's limbs count as cool, where it started without knowing how hot they were.

        Args:
            tell: gets one line where that takes a while.

        Raises:
            LinkError: no answer.
        """
        rest_s = int(self.request("STATUS")["rest_us"]) * 1e-6
        if rest_s > 0.0:
            tell(
                f"limbs: after a time without supply it does not know how hot they are, and lets them rest "
                f"for {rest_s:.1f} s"
            )
        until_s = self.time_s + rest_s
        while self.time_s < until_s:
            self.step(until_s)

    def send_path(self, path: Path) -> None:
        """Give the robot its path.

        Raises:
            LinkError: the robot refuses a part of it.
        """
        points = [
            (float(x), float(y), float(t))
            for x, y, t in zip(path.x_m, path.y_m, path.tangent_rad, strict=True)
        ]
        for values, rows in path_frames(points):
            self.request("PATH", values, rows)

    def set_parameters(self, values: dict[str, float]) -> None:
        """PARAM for each name.

        Raises:
            LinkError: a value out of its limits.
        """
        for name, value in values.items():
            self.request("PARAM", {"parameter": link_layout().parameter[name], "value": value})
