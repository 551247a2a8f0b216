"""Decisions as the robot reports them, and the same decisions by the host's twins."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from frogkick.core.arrays import Float32
from frogkick.core.errors import CheckError
from frogkick.estimator.estimator import LOST_US, Estimates, Estimator
from frogkick.estimator.follow import End, Follow
from frogkick.estimator.track import resting_action_of
from frogkick.estimator.wear import WearFilter
from frogkick.link.frames import Frame
from frogkick.link.layout import Value, link_layout
from frogkick.paths import Path
from frogkick.planner.plan import PathLike, PlanConfig, PlanError, on_robot, plan
from frogkick.tables.image import Tables
from frogkick.tables.layout import LIMB_GONE, LIMBS_MAX, LOST_MAX

STATE_FIELDS = ("x_m", "y_m", "heading_rad", "vx_mps", "vy_mps", "omega_rad_s")
LIMB_USE_FIELDS = tuple(f"limb_use_{limb}" for limb in range(LIMBS_MAX))
LOST_FIELDS = tuple(f"lost_{limb}" for limb in range(LIMBS_MAX))
STALE = link_layout().status["STALE"]
SUPPLY = link_layout().status["SUPPLY"]
NOTHING_LOST = (0,) * LIMBS_MAX
RESTING = -1
"""``RobotEvent.action`` if the guard refused a stroke, so that the robot rests."""

_INTEGERS = (
    "status", "action", "scheduled_us", "fix_sequence", "path_index", "nearest_state", "depth_reached",
    "transitions", "plan_us",
)  # fmt: skip
_FLOATS = ("cost", "distance_m", "along_points")


def _no_state() -> Float32:
    return np.zeros(6, dtype=np.float32)


@dataclass(frozen=True, eq=False)
class Decision:
    """A decision of the robot or of the host. Fields without a comment are those of ``Plan``."""

    status: int  # 0, or why the action is the resting one (``frames.toml``)
    action: int  # index in the table's actions
    scheduled_us: int  # decision time on the robot's clock
    # fix_sequence, fixes: newest fix in the estimate, and number of fixes in it
    fix_sequence: int = 0
    fixes: int = 0
    path_index: int = 0
    nearest_state: int = 0
    limb_use: tuple[int, ...] = (0,) * LIMBS_MAX  # (8,) recent use of each limb before the action
    # (8,) estimated share of its contribution that each limb has lost, 0 to 32767
    lost: tuple[int, ...] = NOTHING_LOST
    depth_reached: int = 0
    transitions: int = 0
    cost: np.float32 = np.float32(0.0)  # noqa: RUF009 - immutable
    distance_m: np.float32 = np.float32(0.0)  # noqa: RUF009
    along_points: np.float32 = np.float32(0.0)  # noqa: RUF009
    # estimate, predicted: (6,) float32, pose world and velocity body, before and after the action
    estimate: Float32 = field(default_factory=_no_state)
    predicted: Float32 = field(default_factory=_no_state)
    plan_us: int = 0  # computing time; 0 where it was not measured

    def differences(self, other: Decision) -> list[str]:
        """Names of the fields that differ in any bit; ``plan_us`` is not compared."""
        differing = []
        for name in (name for name in self.__dataclass_fields__ if name != "plan_us"):
            mine, theirs = getattr(self, name), getattr(other, name)
            if isinstance(mine, np.ndarray | np.floating):
                mine, theirs = (np.float32(value).tobytes() for value in (mine, theirs))
            if mine != theirs:
                differing.append(name)
        return differing


@dataclass(frozen=True)
class RobotEvent:
    """An input of the robot's estimator and planner: a fix, action, aborted run, path, or decision."""

    time_us: int  # capture time of the fix, start of the action, or time of the decision, robot's clock
    pose_world: Float32 | None = None  # (3,) float32, of a fix only
    sequence: int = 0  # number of the fix
    action: int | None = None  # of an action only: index of the one that a command began, or RESTING
    # the run ended because fixes or supply failed. Neither a fix nor a decision implies that end.
    lost: bool = False
    path: Path | None = None  # a path that takes over during the run; the robot has received it whole


def lost_text(lost: Sequence[int], limbs: Sequence[str]) -> str:
    """The estimated wear in words: "front_left has lost 67 %"; "" for none."""
    shares = [(name, 100.0 * code / LOST_MAX) for name, code in zip(limbs, lost, strict=False) if code]
    return ", ".join(f"{name} has lost {share:.0f} %" for name, share in shares)


def events_of_frame(frame: Frame, poses: Mapping[int, Float32]) -> list[RobotEvent]:
    """Inputs of the robot's estimator and planner that a frame reports.

    ``poses`` are those of fixes without an answer so far, by the sequence number of their frame.
    """
    values = frame.values
    # Without a capture time the estimator did not receive it.
    if frame.name == "FIX" and (values["status"] == 0 or values["capture_us"]):
        number = int(values["fix_sequence"])
        return [RobotEvent(int(values["capture_us"]), poses[frame.sequence], number)]
    if frame.name == "REFUSED":
        return [RobotEvent(int(values["begin_us"]), action=RESTING)]
    if frame.name == "DECISION":
        return [RobotEvent(int(values["scheduled_us"]))]
    if frame.name == "ENDED" and values["status"] in (STALE, SUPPLY):
        return [RobotEvent(0, lost=True)]
    return []


def decision_of_event(values: dict[str, Value]) -> Decision:
    """The decision of a DECISION event."""
    numbers: dict[str, Any] = {name: int(values[name]) for name in _INTEGERS}
    numbers |= {name: np.float32(values[name]) for name in _FLOATS}
    return Decision(
        **numbers,
        fixes=int(values["fixes_in_estimate"]),
        estimate=np.array([values[name] for name in STATE_FIELDS], dtype=np.float32),
        predicted=np.array([values[f"predicted_{name}"] for name in STATE_FIELDS], dtype=np.float32),
        limb_use=tuple(int(values[name]) for name in LIMB_USE_FIELDS),
        lost=tuple(int(values[name]) for name in LOST_FIELDS),
    )


class DecisionTwin:
    """Estimator and planner on the host, which decide as the robot does.

    Attributes:
        tables: the robot's table, without wear.
        ended: why the run has ended; None while it goes on. The next decision starts a new run.
    """

    def __init__(
        self,
        tables: Tables,
        path: PathLike,
        config: PlanConfig,
        estimator: Estimates | None = None,
        learn: bool = False,
        lost: Sequence[int] = NOTHING_LOST,
    ) -> None:
        """Start at the beginning of the path.

        Without ``estimator`` the twin of the robot's own is used. With ``learn`` it estimates the wear of the
        limbs, starting from the shares ``lost``, and plans with it.
        """
        self.tables = tables
        self._config = config
        own = estimator if isinstance(estimator, Estimator) else Estimator(tables)
        if learn:
            own.track.resume(lost)
        self._track = own.track
        self._estimator: Estimates = own if estimator is None else estimator
        self._resting_action = resting_action_of(tables)
        self._follow = Follow(tables, path, config)
        self.ended: End | None = None

    @property
    def wear(self) -> WearFilter | None:
        """Its estimate of the limbs' wear; None without one."""
        return self._track.wear

    def add_fix(self, capture_us: int, pose_world: Float32, sequence: int) -> int:
        """Add a fix; return 0 or the status of its refusal (see ``Estimator.add``)."""
        status = self._estimator.add(capture_us, pose_world, sequence)
        if status == 0 and self.ended is None:
            self.ended = self._follow.fixed(pose_world[0], pose_world[1])
        return status

    def act(self, at_us: int, action: int) -> None:
        """Replace the action that ``decide`` chose; RESTING: the robot does not start it."""
        self._estimator.act(at_us, self._resting_action if action == RESTING else action)

    def change_path(self, path: Path) -> None:
        """Follow another path from the next decision that has an estimate."""
        self._follow.coming = path

    def restart(self) -> None:
        """Start a new run at the beginning of the newest path."""
        self._follow.begin()
        self.ended = None

    def apply(self, event: RobotEvent) -> Decision | None:
        """Apply an event of the robot; return the decision if the event is one."""
        if event.pose_world is not None:
            self.add_fix(event.time_us, event.pose_world, event.sequence)
        elif event.action is not None:
            self.act(event.time_us, event.action)
        elif event.path is not None:
            self.change_path(event.path)
        elif event.lost:
            self.restart()
        else:
            return self.decide(event.time_us)
        return None

    def is_lost(self, at_us: int) -> bool:
        """Whether the newest fix is so old that the robot would end its run."""
        newest_us = self._estimator.newest_capture_us
        return newest_us is None or at_us - newest_us > LOST_US

    def decide(self, at_us: int) -> Decision:
        """Decide for a time on the clock of the fixes; the estimator takes the action as started.

        A new path takes over if there is an estimate.
        """
        if self.ended is not None:
            self.restart()
        decision = self._decision_at(at_us)
        if self.ended is None:
            self._estimator.act(at_us, decision.action)
        return decision

    def _decision_at(self, at_us: int) -> Decision:
        """Estimate and plan as the robot does; the run ends at the end of the path."""
        follow = self._follow
        estimate = self._estimator.at(at_us)
        if estimate is not None:
            self._track.end_period(at_us)
        tables = self._track.tables
        lost = (*tables.lost.tolist(), *(0,) * (LIMBS_MAX - len(tables.lost)))
        resting = Decision(STALE, self._resting_action, at_us, along_points=follow.along_points, lost=lost)
        if estimate is None:
            return resting
        state = estimate.state
        follow.take_over(state[0], state[1])
        resting = replace(
            resting,
            along_points=follow.along_points,
            fix_sequence=estimate.fix_sequence,
            fixes=estimate.fixes,
            estimate=state,
            limb_use=tuple(int(use) for use in estimate.limb_use),
        )
        along = float(follow.along_points)
        try:
            config = on_robot(self._config, tables)
            made = plan(tables, follow.path, config, state, estimate.limb_use, along)
        except PlanError as error:
            return replace(resting, status=error.status)
        planned = {
            entry.name: getattr(made, entry.name) for entry in fields(made) if hasattr(resting, entry.name)
        }
        self.ended = follow.decided(made, bool(np.any(tables.lost >= LIMB_GONE)))
        return replace(resting, status=0, **planned)


def warm_up(tables: Tables, path: Path, config: PlanConfig) -> Decision:
    """Compile the twin's kernels by a short artificial run, so that no fix waits for them.

    The run has fixes before and after a decision, a stroke, and another decision. Without it the first fix
    after a stroke takes a second of compiling. Its last decision is returned.
    """
    twin = DecisionTwin(tables, path, config)
    pose = np.array([path.x_m[0], path.y_m[0], path.tangent_rad[0]], dtype=np.float32)
    for sequence in range(12):
        twin.add_fix(200_000 * sequence, pose, sequence)
        if sequence in (3, 10):
            decision = twin.decide(200_000 * sequence + 50_000)
            twin.act(200_000 * sequence + 50_000, decision.action)
    return decision


@dataclass(eq=False)
class LiveCheck:
    """Compares a robot's decisions with the host's bit by bit while the run goes on.

    The twin gets the inputs that the robot reports, in its order and on its clock. Once frames from the robot
    may have been lost, the twin's inputs are incomplete. No further decision is compared then.
    """

    agreed: int = 0  # decisions that are the same on the host
    unchecked: int = 0  # decisions after a possible loss of frames
    _twin: DecisionTwin | None = None

    def begin(self, twin: DecisionTwin) -> None:
        """Start a run of a robot with its twin, which has the robot's wear estimate."""
        self.agreed, self.unchecked, self._twin = 0, 0, twin

    def compare(self, events: Sequence[RobotEvent], decision: Decision | None, gaps: int) -> None:
        """Apply the events of one frame, and compare its decision if it is one.

        ``gaps``: how often frames from the robot may have been lost so far.

        Raises:
            CheckError: the host's decision differs.
        """
        if self._twin is None or gaps or self.unchecked:
            self.unchecked += decision is not None
            return
        ours = None
        for event in events:
            ours = self._twin.apply(event) or ours
        if decision is None:
            return
        assert ours is not None
        differing = decision.differences(ours)
        if differing:
            names = dict(enumerate(row.name for row in self._twin.tables.actions))
            theirs, mine = (names.get(made.action, "no action") for made in (decision, ours))
            raise CheckError(
                f"decision {self.agreed + 1} is {theirs} on the robot and {mine} on the host (different: "
                f"{', '.join(differing)}), where every bit must be the same: the run is ended; send "
                "the robot its table again ('frogkick push') or flash it"
            )
        self.agreed += 1

    @property
    def text(self) -> str:
        """The result so far, for people."""
        agreed = f"host agrees with {self.agreed} decisions"
        return f"{agreed}, {self.unchecked} not compared after a gap" if self.unchecked else agreed

    def as_json(self) -> dict[str, int]:
        """Keys of the command ``run``; a mismatch would have ended it."""
        return {"decisions_checked": self.agreed, "decisions_unchecked": self.unchecked, "mismatches": 0}
