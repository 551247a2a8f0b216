"""A session with a robot in simulated time: commands and their answers, and events.

Every method that sends a command raises a ``LinkError`` if the robot refuses it or does not answer in time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path as FilePath

from frogkick.core.errors import FrogkickError
from frogkick.core.interrupts import uninterrupted
from frogkick.core.poses import Fix
from frogkick.link import auth
from frogkick.link.frames import Frame, hello, pack_frame, path_frames
from frogkick.link.layout import Arguments, Value, link_layout
from frogkick.link.wire import Edge, RobotPort
from frogkick.paths import Path
from frogkick.planner.plan import path_rows
from frogkick.tables.image import Tables

STEP_S = 0.002
ANSWER_TIMEOUT_S = 1.0
HELLO_TIMEOUT_S = 0.05
HELLO_TRIES = 20
DISARM_TRIES = 3
NUMBERS_MOST = 127
"""Sequence numbers in use after the newest answered one, at most. The robot takes one much farther ahead for
an earlier one, and an answer would fit two commands."""
INBOX_MOST = 1024
"""Frames that wait to be taken, at most; of more the oldest are dropped. Fewer come while a request waits."""
CONVERSATION_TRIES = 3  # of a command that a robot refuses its owner because their conversation has ended


class LinkError(FrogkickError):
    """The robot refused a command or did not answer."""


def fix_values(fix: Fix, age_us: int) -> dict[str, Value]:
    """The fields of a FIX command; ``age_us``: of the picture at its reading."""
    return {
        "fix_sequence": fix.sequence,
        "quality": 1,
        "capture_age_us": age_us,
        "x_m": fix.x_m,
        "y_m": fix.y_m,
        "heading_rad": fix.heading_rad,
    }


@dataclass(frozen=True)
class Arrival:
    """A frame from the robot, and the arrival of its last byte in robot time."""

    time_s: float
    frame: Frame


@dataclass
class _Numbers:
    """Sequence numbers of commands, or of fixes: these have their own, because so many come."""

    newest: int = 0
    unheard: int = 0  # numbers in use after the newest one that was answered
    unanswered: dict[int, str] = field(default_factory=dict)  # number -> name of its command

    def begin(self, newest: int) -> None:
        """Go on after a number of the robot's."""
        self.newest, self.unheard = newest, 0

    def use(self, name: str) -> int:
        """The number of a new command: that of the last one if too many were not answered."""
        if self.unheard < NUMBERS_MOST:
            self.newest = (self.newest + 1) & 0xFF
            self.unheard += 1
        self.unanswered[self.newest] = name
        return self.newest

    def answered(self, frame: Frame) -> bool:
        """Whether an answer is the first one to a command."""
        if self.unanswered.get(frame.sequence) != frame.name:
            return False
        del self.unanswered[frame.sequence]
        self.unheard = min(self.unheard, (self.newest - frame.sequence) & 0xFF)
        return True


@dataclass
class Session:
    """A session with a robot."""

    port: RobotPort  # the robot
    # called after each step with the new time and the pin edges of the step
    on_step: Callable[[float, Sequence[Edge]], None] = lambda _time_s, _edges: None
    time_s: float = 0.0  # session time, from 0
    edges: list[Edge] = field(default_factory=list)  # pin edges so far
    # file of the owner's key, for a robot that has one; None: ``default_key_file``
    key_file: FilePath | None = None
    _apart: int = 0  # sequence numbers between the robot's newest one and this session's first
    _is_owner: bool = False  # the robot's key is known, so that a conversation with it can be begun
    _auth: auth.CommandCodes | None = None  # of the conversation; None: none is on
    _numbers: _Numbers = field(default_factory=_Numbers)
    _fix_numbers: _Numbers = field(default_factory=_Numbers)
    _inbox: list[Arrival] = field(default_factory=list)

    def step(self, until_s: float) -> None:
        """Advance robot and pool to a time."""
        self.port.advance(until_s)
        edges = self.port.edges()
        self.edges += edges
        self._receive()
        self.on_step(until_s, edges)
        self.time_s = until_s

    def _receive(self) -> None:
        """Take what has arrived: events, and the first answer to each command."""
        for time_s, frame in self.port.frames():
            if frame.kind == "command":  # from a line that echoes
                continue
            if frame.kind == "answer" and not self._numbers_of(frame.name).answered(frame):
                continue
            self._inbox.append(Arrival(time_s, frame))
        del self._inbox[:-INBOX_MOST]

    def post(
        self,
        name: str,
        values: dict[str, Value] | None = None,
        rows: Sequence[Sequence[Value]] = (),
        at_s: float | None = None,
    ) -> int:
        """Send a command without waiting; return its sequence number."""
        sequence = self._next_sequence(name)
        encoded = pack_frame(name, "command", sequence, values, rows, self._auth)
        self.port.send(encoded, self.time_s if at_s is None else at_s)
        if name == "DISARM":  # ends the conversation
            self._auth = None
        return sequence

    def _numbers_of(self, name: str) -> _Numbers:
        return self._fix_numbers if name == "FIX" else self._numbers

    def _next_sequence(self, name: str) -> int:
        """The sequence number of a new command. An answer that came to an earlier one by it is dropped."""
        numbers = self._numbers_of(name)
        sequence = numbers.use(name)
        self._inbox = [
            arrival
            for arrival in self._inbox
            if arrival.frame.kind != "answer"
            or arrival.frame.sequence != sequence
            or self._numbers_of(arrival.frame.name) is not numbers
        ]
        return sequence

    def post_fix(self, fix: Fix, at_s: float) -> int:
        """Send a position fix at ``at_s``, which its age counts to; return its sequence number."""
        age_us = max(0, round((at_s - fix.capture_s) * 1e6))
        return self.post("FIX", fix_values(fix, age_us), at_s=at_s)

    def take(self, *names: str) -> list[Arrival]:
        """Remove and return the arrived frames of some names, in order."""
        taken = [arrival for arrival in self._inbox if arrival.frame.name in names]
        self._inbox = [arrival for arrival in self._inbox if arrival.frame.name not in names]
        return taken

    def request(
        self, name: str, values: dict[str, Value] | None = None, rows: Sequence[Sequence[Value]] = ()
    ) -> dict[str, Value]:
        """Send a command and wait for its answer. LinkError: no answer in time, or the robot refuses."""
        answer = self.ask(name, values, rows)
        self.require_done(name, values, answer)
        return answer

    def require_done(self, name: str, values: dict[str, Value] | None, answer: dict[str, Value]) -> None:
        """Raise LinkError if the answer to a command is a refusal."""
        status = int(answer["status"])
        if status < 0:
            command = f"{name} {values}" if values and name != "KEY" else name  # a key is secret
            raise LinkError(
                f"the robot refuses {command}: {link_layout().status_name(status)}{self._why(status)}"
            )

    def _why(self, status: int) -> str:
        """Explain a status that names no reason itself."""
        if status in (link_layout().status["AUTH"], link_layout().status["MAC"]):
            return ": it takes commands only from its owner and has not authenticated this host: try again"
        if status != link_layout().status["FAULT"]:
            return ""
        answer = self.ask("STATUS")
        return f", internal error {link_layout().fault_name(int(answer['fault']))} ({answer['fault_detail']})"

    def ask(
        self,
        name: str,
        values: dict[str, Value] | None = None,
        rows: Sequence[Sequence[Value]] = (),
        timeout_s: float = ANSWER_TIMEOUT_S,
    ) -> dict[str, Value]:
        """Like ``request``, but return a refusal too."""
        return self.ask_all(name, [(values, rows)], timeout_s)[0]

    @property
    def window(self) -> int:
        """Number of commands that may wait for their answers at the same time."""
        return 1

    def ask_all(
        self, name: str, many: Sequence[Arguments], timeout_s: float = ANSWER_TIMEOUT_S
    ) -> list[dict[str, Value]]:
        """Send a command several times with different arguments, and wait for all answers.

        If the robot has an owner, a conversation is begun where none is on: whatever disarms the robot ends
        it. What was refused for that alone is sent again.

        Raises:
            LinkError: an answer is missing after ``timeout_s``.
        """
        is_guarded = self._is_owner and link_layout().messages[name].needs_code
        for _ in range(CONVERSATION_TRIES):
            if is_guarded and self._auth is None:
                self.prove()
            answers = self._ask_all(name, many, timeout_s)
            if not is_guarded or all(answer["status"] != link_layout().status["MAC"] for answer in answers):
                break
            self._auth = None
        return answers

    def _ask_all(self, name: str, many: Sequence[Arguments], timeout_s: float) -> list[dict[str, Value]]:
        """``ask_all`` in the conversation that is on."""
        sequences = [self.post(name, values, rows) for values, rows in many]
        answers: dict[int, dict[str, Value]] = {}
        deadline_s = self.time_s + timeout_s
        while self.time_s < deadline_s:
            self.step(self.time_s + STEP_S)
            if self._answered(name, sequences, answers):
                return [answers[sequence] for sequence in sequences]
        raise LinkError(f"no answer to {name} within {timeout_s:g} s: check that the firmware runs")

    def _answered(self, name: str, sequences: Sequence[int], answers: dict[int, dict[str, Value]]) -> bool:
        """Move arrived answers from the inbox to ``answers``; whether all have come."""
        for arrival in self.take(name):
            frame = arrival.frame
            if frame.kind == "answer" and frame.sequence in sequences:
                answers[frame.sequence] = frame.values
            else:
                self._inbox.append(arrival)
        return len(answers) == len(sequences)

    def make_safe(self) -> bool:
        """Send DISARM until the robot answers; False if it does not. Pool and Ctrl-C wait meanwhile."""
        self.on_step = lambda _time_s, _edges: None
        with uninterrupted():
            for _ in range(DISARM_TRIES):
                try:
                    self.ask("DISARM")
                except Exception:  # whatever it is: the user must hear of the robot
                    continue
                return True  # disarmed, or in a fault with its outputs off
        return False

    @property
    def link_s(self) -> float:
        """Session time without the times at which the connection was down."""
        return self.time_s

    def forget(self, sequence: int) -> None:
        """Do not send a command again; never done in simulated time."""

    def reconnected(self) -> bool:
        """Whether the connection was lost and restored since the last call; never in simulated time."""
        return False

    @staticmethod
    def real_time_guard() -> AbstractContextManager[None]:
        """Context of a run; no effect in simulated time."""
        return nullcontext()

    @property
    def gaps(self) -> int:
        """How often frames from the robot may have been lost; 0 in simulated time."""
        return 0

    def robot_clock_offset_us(self) -> int:
        """Robot time minus session time; 0 in simulated time."""
        return 0

    def check_clock_sync(self, capture_s: float, capture_us: int) -> None:
        """Check that session clock and robot clock agree on a capture time; no effect in simulated time."""

    @property
    def place(self) -> str:
        """Where the robot is, as ``Wire.place``; "" in simulated time."""
        return ""

    def hello(self) -> dict[str, Value]:
        """Answer to HELLO."""
        answer = self._hello()
        if answer["status"] != link_layout().status["VERSION"]:
            self.require_done("HELLO", None, answer)
        ours = link_layout().protocol_version
        if answer["protocol_version"] != ours:
            raise LinkError(
                f"the robot speaks protocol {answer['protocol_version']}, this host {ours}: flash it again"
            )
        self._numbers.begin((int(answer["newest"]) + self._apart) & 0xFF)
        return answer

    def authenticate(self) -> None:
        """Authenticate to a robot that has an owner's key; no effect with one that never had.

        Raises:
            LinkError: this host has no key or not the robot's, the robot has none although this host has one
                for it, or it does not answer.
            InputError: the key's file cannot be read.
        """
        if self.is_open():
            self.require_unowned()
            if self.key_file is not None:
                raise LinkError(
                    f"the key {str(self.key_file)!r} is given, and the robot says that it has none: leave "
                    "out --key, or give it one with 'frogkick own'"
                )
        else:
            self.prove()

    def prove(self) -> auth.OwnerKey:
        """Let a robot with an owner's key prove that it is one of this host's, and return that one.

        Raises:
            LinkError: this host has no key or not the robot's, or the robot does not answer.
            InputError: the key's file cannot be read.
        """
        file = self.key_file or auth.default_key_file()
        if not file.exists():
            raise LinkError(
                "the robot takes commands only from its owner, and there is no owner's key in "
                f"{str(file)!r}: give the key's file (--key)"
            )
        keys, nonce = auth.read_keys(file), auth.challenge()
        answer = self.request("CHALLENGE", auth.words("nonce", nonce))
        for key in keys:
            self._auth = auth.begin(key.secret, nonce, answer)
            if self._auth is not None:
                self._is_owner = True
                return key
        raise LinkError(
            f"the owner's key in {str(file)!r} is not this robot's: give the file of its own (--key)"
        )

    def is_open(self) -> bool:
        """Whether the robot says that anybody may command it; commands carry no codes then.

        Raises:
            LinkError: it has lost its key and obeys nobody, or it does not answer.
        """
        self._is_owner, self._auth = False, None
        status = self.request("STATUS")
        if int(status["fault"]) == link_layout().fault["STORE"]:
            raise LinkError(
                "the robot's flash is damaged and has lost the owner's key, so it obeys nobody: erase its "
                "chip and flash it again, as the page about the owner's key says"
            )
        return int(status["owner"]) == link_layout().owner["OPEN"]

    def require_unowned(self) -> None:
        """Raise LinkError if this host has a key of the robot, which says that it has none."""
        file = self.key_file or auth.default_key_file()
        if self.place and file.exists() and any(key.place == self.place for key in auth.read_keys(file)):
            raise LinkError(
                f"the robot at {self.place} says that it has no owner's key, and {str(file)!r} holds one for "
                "it: it has lost its key, or it is another device; give it a new key with 'frogkick own "
                "--again', or let anybody command it with 'frogkick own --release'"
            )

    def handshake(self, tables: Tables) -> dict[str, Value]:
        """Answer to HELLO of a robot with these tables.

        Raises:
            LinkError: no answer, or another protocol or table.
            TableError: another robot.
        """
        answer = self.hello()
        tables.require_robot(str(answer["robot_id"]))
        if answer["table_crc"] != tables.crc32:
            theirs_s, ours_s = (int(us) * 1e-6 for us in (answer["period_us"], tables.period_us))
            periods = f" and a period of {theirs_s:.3f} s, ours {ours_s:.3f} s"
            raise LinkError(
                f"the robot's table has CRC-32 {answer['table_crc']:08x}, ours {tables.crc32:08x}"
                f"{periods if theirs_s != ours_s else ''}: "
                "give the robot's own table (--tables), send this one ('frogkick push'), "
                "or build the firmware with it"
            )
        return answer

    def _hello(self) -> dict[str, Value]:
        # A robot that has just been switched on does not receive until it has checked its table.
        values = hello()
        for _ in range(HELLO_TRIES - 1):
            try:
                return self.ask("HELLO", values, timeout_s=HELLO_TIMEOUT_S)
            except LinkError:
                continue
        return self.ask("HELLO", values, timeout_s=HELLO_TIMEOUT_S)

    def rest(self, tell: Callable[[str], None], most_s: float = math.inf) -> None:
        """Wait until a robot that started without knowing its limbs' heat counts them as cool.

        Args:
            tell: gets one line if that takes time.
            most_s: longest such time of this robot.

        Raises:
            LinkError: it wants more.
        """
        rest_s = int(self.request("STATUS")["rest_us"]) * 1e-6
        if rest_s > most_s:
            raise LinkError(
                f"the robot lets its limbs rest for {rest_s:.1f} s, its description for {most_s:.1f} s at "
                "most: give its own description, or flash it again"
            )
        if rest_s > 0.0:
            tell(
                "limbs: after a time without supply the robot does not know how hot they are and lets them "
                f"rest for {rest_s:.1f} s"
            )
        until_s = self.time_s + rest_s
        while self.time_s < until_s:
            self.step(until_s)

    def send_path(self, path: Path) -> None:
        """Send the robot its path."""
        for values, rows in path_frames(path_rows(path).T.tolist()):
            self.request("PATH", values, rows)

    def set_parameters(self, values: dict[str, float]) -> None:
        """Send PARAM for each name. LinkError: a value is out of its limits."""
        for name, value in values.items():
            self.request("PARAM", {"parameter": link_layout().parameter[name], "value": value})
