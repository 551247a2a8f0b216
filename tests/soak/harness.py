"""A robot's long life in closed loop: a host that always starts it again, and all that goes wrong."""

from __future__ import annotations

import random
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from tests.core.onlooker import Limits
from tests.soak.radio import Faults, Radio
from tests.soak.route import Route
from tests.soak.table_pool import TablePool
from tests.soak.watch import UPDATE_S, Watch
from tests.soak.witness import SeenRobot

from frogkick.core.errors import FrogkickError
from frogkick.link.layout import Arguments, Value, link_layout
from frogkick.link.wire import Edge
from frogkick.planner.plan import config_of
from frogkick.pool.pool import Camera
from frogkick.robot import Robot
from frogkick.runs.closed_loop import SETTLE_S, START_DELAY_S, parameters
from frogkick.runs.pushing import upload
from frogkick.runs.session import STEP_S, LinkError, Session
from frogkick.tables.image import Tables

CAMERA = Camera(rate_hz=10.0, delay_s=0.08, jitter_s=0.32, lost=0.3, outliers=0.01)
"""30 % lost, 80 to 400 ms late, so that they overtake each other, some plainly wrong."""
_AGAIN_S = 0.15
_REST_S = 0.75
_MEMORY_S = 60.0
KINDS = (
    "power cut", "watchdog", "camera dark", "camera blinks", "radio silent", "noise", "update", "update cut",
    "rollback", "restart", "long off",
)  # fmt: skip
RESETS = ("power cut", "watchdog", "update cut", "long off")
WRAP_US = (2**32, 2**32 * 1000, 2**33, 2**40)


class PatientSession(Session):
    """A session that asks again, with the same bytes, where no answer comes: the robot acts once."""

    def _ask_all(self, name: str, many: Sequence[Arguments], timeout_s: float) -> list[dict[str, Value]]:
        assert isinstance(self.port, Radio)
        sent: dict[int, bytes] = {}
        for values, rows in many:
            sequence = self.post(name, values, rows)
            sent[sequence] = self.port.last
        reported: dict[int, dict[str, Value]] = {}
        deadline_s, again_s = self.time_s + timeout_s, self.time_s + _AGAIN_S
        while self.time_s < deadline_s:
            self.step(self.time_s + STEP_S)
            if self._answered(name, list(sent), reported):
                return [reported[sequence] for sequence in sent]
            if self.time_s >= again_s:
                again_s += _AGAIN_S
                for encoded in (sent[sequence] for sequence in sent if sequence not in reported):
                    self.port.send(encoded, self.time_s)
        raise LinkError(f"no answer to {name} within {timeout_s:g} s")


@dataclass(frozen=True)
class Plan:
    """What happens in a life.

    Attributes:
        gap_s: mean time between the end of a disturbance and the next one.
        kinds: of disturbances; each comes once in a round of all, in any order.
        first: kinds that come first, in this order.
        begin_s: when the first one comes.
        resets_until_s: from then on nothing resets the robot: its clock goes on by itself.
        calm_s: from then on nothing disturbs any more.
        wrap_in_s: before a wrap of its clock, after ``long off``: up to this.
    """

    gap_s: float = 120.0
    kinds: tuple[str, ...] = KINDS
    first: tuple[str, ...] = ()
    begin_s: float = 15.0
    resets_until_s: float = float("inf")
    calm_s: float = float("inf")
    wrap_in_s: float = 60.0


class Life:
    """See the module.

    Attributes:
        robot, radio, pool, watch: that take part.
        counts: what the host met.
    """

    def __init__(
        self,
        library: Path,
        robot: Robot,
        tables: Sequence[Tables],
        plan: Plan,
        seed: int,
        truth: Tables,
        warm_s: float = 300.0,
        made: type[SeenRobot] = SeenRobot,
    ) -> None:
        self.dice = random.Random(seed)
        self.route = Route()
        self.robot = made(library, len(robot.limbs), Limits.of(robot))
        self.radio = Radio(self.robot, random.Random(seed + 1), Faults())
        self.pool = TablePool(truth, self.route.start(), CAMERA, np.random.default_rng(seed))
        self.watch = Watch(robot, self.route, warm_s)
        self.plan = plan
        self.counts: Counter[str] = Counter()
        self.silence_s = 3.2  # two periods without a decision: the host asks
        self._tables = {each.crc32: each for each in tables}
        self._built_in = tables[0].crc32
        self._running = self._built_in  # the table that the robot must be using
        self._wanted: int | None = None  # the one that it is to use
        self._wanted_s = 0.0
        self._way = ""
        self._cut_at: float | None = None
        self._settings = parameters(config_of(robot.planner))
        self._places: deque[np.ndarray] = deque(maxlen=7)
        self._dark_s = (0.0, 0.0)
        self._round: list[str] = []
        self._first = list(plan.first)
        self._next_s = plan.begin_s
        self._sampled_s = 0.0
        self._remembered_s = 0.0
        self._decided_s = 0.0
        self._ended = False
        self.session = PatientSession(self.radio, self._on_step)

    @property
    def faults(self) -> list[str]:
        return self.robot.faults + self.watch.faults

    @property
    def time_s(self) -> float:
        return self.session.time_s

    # The world.

    def _on_step(self, until_s: float, edges: Sequence[Edge]) -> None:
        for edge in edges:
            if edge.level:
                self.pool.actuate(edge.limb, edge.time_s)
        self.watch.pins(edges, until_s)
        self.session.edges.clear()
        for fix in self.pool.advance(until_s):
            self.counts["fixes"] += 1
            if not self._dark_s[0] <= fix.capture_s < self._dark_s[1]:
                self.session.post_fix(fix, max(until_s, fix.arrival_s))
                self._places.append(fix.pose_world)
        if until_s >= self._sampled_s:
            self._sampled_s += 1.0
            self._each_second(until_s)
        if until_s >= self._next_s:
            self._disturb(until_s)

    def _each_second(self, time_s: float) -> None:
        pose, _ = self.pool.state()
        self.watch.place(time_s, (float(pose[0]), float(pose[1])))
        truth = self.pool.truth
        for column in (truth.time_s, truth.pose_world, truth.velocity_body):
            column.clear()
        if self._wanted is not None:
            self.watch.still_disturbed(self._way, time_s)
            if time_s - self._wanted_s > UPDATE_S:
                self.watch.faults.append(f"at {time_s:.1f} s: {self._way} not done in {UPDATE_S:g} s")
        if time_s >= self._remembered_s:
            self._remembered_s += _MEMORY_S
            self.watch.memory(time_s)
            try:
                self.robot.ram_bytes()
            except FrogkickError as error:
                self.watch.faults.append(str(error))

    # What goes wrong.

    def _disturb(self, time_s: float) -> None:
        if not self._first and not self._round:
            calm = RESETS if time_s > self.plan.resets_until_s else ()
            self._round = [kind for kind in self.plan.kinds if kind not in calm]
            self.dice.shuffle(self._round)
        kind = self._first.pop(0) if self._first else self._round.pop()
        dice = self.dice
        begin_s = time_s + dice.uniform(0.0, 1.5)
        over_s = begin_s
        if kind == "power cut":
            off_s = dice.choice((0.02, 0.3, 2.0)) * dice.uniform(0.5, 1.5)
            over_s = self._cut(begin_s, off_s)
        elif kind == "long off":
            wrap_s = dice.choice(WRAP_US) * 1e-6
            over_s = self._cut(
                begin_s, dice.uniform(6.0, 12.0), wrap_s - dice.uniform(0.0, self.plan.wrap_in_s)
            )
        elif kind == "watchdog":
            over_s = begin_s + 1.1
            self.radio.at(begin_s, self.robot.hang)
        elif kind in ("camera dark", "camera blinks"):
            over_s = begin_s + (dice.uniform(2.5, 6.0) if kind == "camera dark" else dice.uniform(0.3, 1.5))
            self._dark_s = (begin_s, over_s)
            over_s += CAMERA.delay_s + CAMERA.jitter_s
        elif kind == "radio silent":
            over_s = begin_s + dice.uniform(0.3, 5.0)
            self.radio.be_silent(begin_s, over_s)
        elif kind == "noise":
            over_s = self.radio.noise(dice.randrange(1, 3000), begin_s)
        else:
            self._want(kind, begin_s)
        self.watch.disturb(kind, over_s)
        self._next_s = over_s + 5.0 + dice.expovariate(1.0 / self.plan.gap_s)
        if self._next_s > self.plan.calm_s:
            self._next_s = float("inf")

    def _cut(self, at_s: float, off_s: float, idle_s: float = 0.0) -> float:
        self.radio.at(at_s, lambda: self.robot.cut_power(off_s, idle_s))
        return at_s + off_s + 0.1

    def _want(self, kind: str, time_s: float) -> None:
        """The host is to change the robot's table, or to start it again."""
        self._way = kind
        self._wanted_s = time_s
        others = [crc for crc in self._tables if crc != self._running]
        self._wanted = self._running if kind == "restart" else others[0]
        self._cut_at = self.dice.random() if kind == "update cut" else None

    # The host.

    def live(self, until_s: float) -> None:
        """Let all of them live until a time, or until something is wrong."""
        while self.time_s < until_s and not self.faults:
            try:
                self._connect()
                while self.time_s < until_s and not self.faults:
                    if self._wanted is not None:
                        self._change()
                    self._follow(until_s)
            except FrogkickError:
                self.counts["host began anew"] += 1
                self._pass(0.1)
        if self.time_s >= until_s:
            self.watch.judge_pins(self.time_s)
            self.robot.judge()

    def _pass(self, length_s: float) -> None:
        """Let time pass; see what the robot says by itself."""
        until_s = self.time_s + length_s
        while self.time_s < until_s:
            self.session.step(min(max(self.pool.next_event_s, self.time_s + 1e-6), until_s))
            self._take()

    def _take(self) -> None:
        for arrival in self.session.take(*link_layout().messages):
            frame = arrival.frame
            if frame.name == "DECISION":
                self._decided_s = arrival.time_s
                self.counts["decisions"] += 1
                if frame.values["status"] == 0:
                    self.watch.decided(arrival.time_s)
            elif frame.name == "ENDED":
                self._ended = True
                self.counts[f"ended: {link_layout().status_name(int(frame.values['status']))}"] += 1
            elif frame.name == "REFUSED":
                self.counts["refused"] += 1

    def _connect(self) -> None:
        """Which robot is it, and what does it use now? No run goes on from before."""
        self.session = session = PatientSession(self.radio, self._on_step, self.time_s)
        running = int(session.hello()["table_crc"])
        if running != self._running and running != self._wanted:
            self.watch.faults.append(f"at {self.time_s:.1f} s the robot uses table {running:08x}")
        session.handshake(self._tables[running])
        session.request("STOP")
        session.request("STATUS")  # for the witness: what does it count since it started, and why did it?
        session.set_parameters(self._settings)
        self.counts["connected"] += 1

    def _change(self) -> None:
        """Do to the table what is wanted, as often as it takes."""
        wanted, session = self._wanted, self.session
        assert wanted is not None
        session.request("DISARM")
        self._pass(_REST_S)
        if self._way == "rollback":
            session.request(
                "TABLE_ROLLBACK", {"table_crc": wanted if self._is_here(wanted) else self._built_in}
            )
            wanted = int(session.request("TABLE_STATUS")["running_crc"])
        elif self._way != "restart":
            done = upload(session, self._tables[wanted].image, self._progress)
            self.counts["updates"] += 1
            self.counts["updates resumed"] += 0 < done.resumed_at < len(self._tables[wanted].image)
        self._running = wanted
        self._wanted = None
        session.handshake(self._tables[wanted])
        self.watch.still_disturbed(self._way, self.time_s)

    def _is_here(self, crc: int) -> bool:
        answer = self.session.request("TABLE_STATUS")
        return crc in (answer["previous_crc"], answer["built_in_crc"])

    def _progress(self, done: int, length: int) -> None:
        """In the middle of an update that is to be cut the power fails, or the firmware hangs."""
        if self._cut_at is not None and done >= self._cut_at * length:
            self._cut_at = None
            at_s = self.time_s + self.dice.uniform(0.0, 0.02)
            if self.dice.random() < 0.5:
                self._cut(at_s, self.dice.uniform(0.05, 1.0))
            else:
                self.radio.at(at_s, self.robot.hang)

    def _follow(self, until_s: float) -> None:
        """One part of the route, from where the robot is; until its end, or something is the matter."""
        session = self.session
        if len(self._places) < 5:
            self._pass(SETTLE_S)
        session.send_path(self.route.ahead(self._seen_m()))
        session.request("ARM")
        self._take()  # whatever was said of the run before
        session.request("START", {"delay_us": round(START_DELAY_S * 1e6)})
        self._ended, self._decided_s = False, self.time_s
        asked_s = self.time_s
        while not self._ended and self._wanted is None and self.time_s < until_s and not self.faults:
            self._pass(0.2)
            if self.time_s - self._decided_s > self.silence_s:
                raise LinkError("the robot says nothing")
            if self.time_s - asked_s > 10.0:
                asked_s = self.time_s
                session.request("STATUS")

    def _seen_m(self) -> np.ndarray:
        """Where the robot is, of its last fixes the one that the others are nearest to."""
        places = np.array(self._places)[:, :2]
        apart = np.abs(places[:, None] - places[None]).sum(axis=(1, 2))
        return np.asarray(places[int(np.argmin(apart))])
