"""A decision: what the robot on board reports, and the same made on the host by the twins."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from frogkick.estimator.estimator import LOST_US, Estimates, Estimator
from frogkick.estimator.follow import End, Follow
from frogkick.estimator.track import resting_action_of
from frogkick.link.frames import Frame
from frogkick.link.layout import Value, link_layout
from frogkick.paths import Path
from frogkick.planner.plan import PathLike, PlanConfig, PlanError, plan
from frogkick.tables.image import Tables

STATE_FIELDS = ("x_m", "y_m", "heading_rad", "vx_mps", "vy_mps", "omega_rad_s")
LIMB_USE_FIELDS = tuple(f"limb_use_{limb}" for limb in range(8))
STALE = link_layout().status["STALE"]
SUPPLY = link_layout().status["SUPPLY"]
VALUE = link_layout().status["VALUE"]
RESTING = -1


@dataclass(frozen=True, eq=False)
class Decision:
    """One decision, the same fields wherever it was made.

    Attributes:
        status: 0, or why the action is the resting one (``frames.toml``).
        action: index in the table's actions.
        scheduled_us: decision time on the robot's clock.
        fix_sequence, fixes: newest fix in the estimate and number of fixes in it.
        path_index: nearest path point of the estimate.
        nearest_state: row of the table.
        cost: float32 of the best branch.
        depth_reached, transitions: levels that were finished, transitions evaluated.
        distance_m, along_points: float32 of the estimate from the path, and where along it, in points.
        estimate, predicted: (6,) float32; pose world, velocity body; now and after the action.
        limb_use: (8,) how much each limb was used before the action.
        plan_us: computing time, where it was measured.
    """

    status: int
    action: int
    scheduled_us: int
    fix_sequence: int
    fixes: int
    path_index: int
    nearest_state: int
    cost: np.float32
    estimate: npt.NDArray[np.float32]
    predicted: npt.NDArray[np.float32]
    plan_us: int = 0
    limb_use: tuple[int, ...] = (0,) * 8
    depth_reached: int = 0
    transitions: int = 0
    distance_m: np.float32 = np.float32(0.0)  # noqa: RUF009 - immutable
    along_points: np.float32 = np.float32(0.0)  # noqa: RUF009

    def differences(self, other: Decision) -> list[str]:
        """Names of the fields that differ in any bit; computing time does not count."""
        names = [
            "status", "action", "scheduled_us", "fix_sequence", "fixes", "path_index", "nearest_state",
            "limb_use", "depth_reached", "transitions",
        ]  # fmt: skip
        differing = [name for name in names if getattr(self, name) != getattr(other, name)]
        for name in ("cost", "distance_m", "along_points", "estimate", "predicted"):
            mine, theirs = np.float32(getattr(self, name)), np.float32(getattr(other, name))
            if mine.tobytes() != theirs.tobytes():
                differing.append(name)
        return differing


@dataclass(frozen=True)
class RobotEvent:
    """What the robot met, in its order: a fix (with pose), an action, a run lost, or a decision (none).

    Attributes:
        time_us: capture time, time at which the action begins, or decision time, robot's clock; 0 if lost.
        pose_world: (3,) float32 of a fix.
        sequence: number of the fix.
        action: what began by command, or RESTING where the guard refused what was to begin.
        lost: the run ended for want of fixes or of supply. No decision shows that; other ends follow from one
            or a fix.
    """

    time_us: int
    pose_world: npt.NDArray[np.float32] | None = None
    sequence: int = 0
    action: int | None = None
    lost: bool = False


def events_of_frame(frame: Frame, poses: Mapping[int, npt.NDArray[np.float32]]) -> list[RobotEvent]:
    """What a frame from the robot tells of what its estimator met.

    Args:
        frame: any; an answer to FIX, REFUSED, DECISION and an ENDED without fixes tell something.
        poses: of the fixes on their way, by the sequence of their frame.
    """
    values = frame.values
    if frame.name == "FIX" and values["status"] != VALUE:
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
    """The decision that a DECISION event carries."""

    def state(prefix: str) -> npt.NDArray[np.float32]:
        return np.array([values[prefix + name] for name in STATE_FIELDS], dtype=np.float32)

    return Decision(
        status=int(values["status"]),
        action=int(values["action"]),
        scheduled_us=int(values["scheduled_us"]),
        fix_sequence=int(values["fix_sequence"]),
        fixes=int(values["fixes_in_estimate"]),
        path_index=int(values["path_index"]),
        nearest_state=int(values["nearest_state"]),
        cost=np.float32(values["cost"]),
        estimate=state(""),
        predicted=state("predicted_"),
        plan_us=int(values["plan_us"]),
        limb_use=tuple(int(values[name]) for name in LIMB_USE_FIELDS),
        depth_reached=int(values["depth_reached"]),
        transitions=int(values["transitions"]),
        distance_m=np.float32(values["distance_m"]),
        along_points=np.float32(values["along_points"]),
    )


def decide(
    tables: Tables,
    path: PathLike,
    config: PlanConfig,
    estimator: Estimates,
    follow: Follow,
    at_us: int,
) -> tuple[Decision, End | None]:
    """Estimate and plan for a time, as the robot on board does; and why the run is over with it, or None.

    ``follow`` notes the progress; that the action begins is for the caller to tell the estimator.
    """
    nowhere = np.zeros(6, dtype=np.float32)
    resting_action = resting_action_of(tables)
    along = follow.along_points
    estimate = estimator.at(at_us)
    if estimate is None:
        return Decision(
            STALE, resting_action, at_us, 0, 0, 0, 0, np.float32(0.0), nowhere, nowhere, along_points=along
        ), None
    limb_use = tuple(int(use) for use in estimate.limb_use)
    try:
        made = plan(tables, path, config, estimate.state, estimate.limb_use, float(along))
    except PlanError as error:
        return Decision(
            error.status, resting_action, at_us, estimate.fix_sequence, estimate.fixes, 0, 0,
            np.float32(0.0), estimate.state, nowhere, limb_use=limb_use, along_points=along,
        ), None  # fmt: skip
    decision = Decision(
        status=0,
        action=made.action,
        scheduled_us=at_us,
        fix_sequence=estimate.fix_sequence,
        fixes=estimate.fixes,
        path_index=made.path_index,
        nearest_state=made.nearest_state,
        cost=made.cost,
        estimate=estimate.state,
        predicted=made.predicted,
        limb_use=limb_use,
        depth_reached=made.depth_reached,
        transitions=made.transitions,
        distance_m=made.distance_m,
        along_points=made.along_points,
    )
    return decision, follow.decided(made)


class DecisionTwin:
    """Estimator and planner on the host, deciding as the robot on board would.

    Attributes:
        ended: why the run is over, None while it goes on. The next decision begins a new run.
    """

    def __init__(
        self, tables: Tables, path: Path, config: PlanConfig, estimator: Estimates | None = None
    ) -> None:
        """Decide on a path; ``estimator`` is the robot's own where it is None."""
        self._tables = tables
        self._path = path
        self._config = config
        self._estimator = Estimator(tables) if estimator is None else estimator
        self._follow = Follow(tables, path, config)
        self.ended: End | None = None
        self._resting_action = resting_action_of(tables)

    def add_fix(self, capture_us: int, pose_world: npt.NDArray[np.float32], sequence: int) -> int:
        """Take a fix; 0, or why it is refused (see ``Estimator.add``)."""
        status = self._estimator.add(capture_us, pose_world, sequence)
        if status == 0 and self.ended is None:
            self.ended = self._follow.fixed(pose_world[0], pose_world[1])
        return status

    def act(self, at_us: int, action: int) -> None:
        """An action begins that ``decide`` did not ask for; RESTING: the one it asked for does not."""
        self._estimator.act(at_us, self._resting_action if action == RESTING else action)

    def lose(self) -> None:
        """The run ends for want of fixes: the next decision begins a new one, at the path's start."""
        self._follow.begin()
        self.ended = None

    def apply(self, event: RobotEvent) -> Decision | None:
        """Apply an event of the robot; a decision is computed again and returned."""
        if event.pose_world is not None:
            self.add_fix(event.time_us, event.pose_world, event.sequence)
        elif event.action is not None:
            self.act(event.time_us, event.action)
        elif event.lost:
            self.lose()
        else:
            return self.decide(event.time_us)
        return None

    def is_lost(self, at_us: int) -> bool:
        """No fix for so long that the robot on board would disarm."""
        newest_us = self._estimator.newest_capture_us
        return newest_us is None or at_us - newest_us > LOST_US

    def decide(self, at_us: int) -> Decision:
        """Estimate and plan for a time on the clock of the fixes; the estimator takes the action as begun."""
        if self.ended is not None:
            self._follow.begin()
            self.ended = None
        decision, self.ended = decide(
            self._tables, self._path, self._config, self._estimator, self._follow, at_us
        )
        if self.ended is None:
            self._estimator.act(at_us, decision.action)
        return decision
