"""Paths that take over during a run: when each is sent to the robot, and which decision first follows it.

Also ``run --hold``: the paths that hold a robot at the end of the path that it follows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from frogkick.core.arrays import Float64
from frogkick.core.poses import Fix
from frogkick.link.frames import Frame, path_frames
from frogkick.link.layout import link_layout
from frogkick.paths import Path
from frogkick.paths.hold import LAP_POINTS, LEAD, Hold, hold_at_end, hold_from_pose
from frogkick.planner.plan import path_rows
from frogkick.runs.decision import STALE, Decision
from frogkick.runs.runlog import PathChange, RunLog
from frogkick.runs.session import LinkError, Session

TRIES = 3
ANSWER_S = 2.0  # after which a part without an answer counts as refused
HOLD_LIMIT_M = 0.1
"""Largest distance from the end of a path for a robot that holds there."""
AGAIN_POINTS = 2
"""After this many points of its second lap the robot is sent new laps, and continues in their first one."""
OFF, ANEW_AFTER = 0.65, 2
"""A robot that is OFF radii of the circle away from its entry onto the circle gets another one from where it
is, ANEW_AFTER decisions later at the earliest. If it cannot follow that one either, it gets no third, and
follows the circle from beside it."""
MOVING_MPS = 0.005
"""At a lower speed the robot's heading is its course."""
SHIFT_GAIN = 0.7
"""Gain of the integral controller: share of the last lap's offset by which the next laps are moved."""
SHIFT_MAX_M = 0.08
"""Largest distance of a circle's centre from the end."""


@dataclass(frozen=True, eq=False)
class NextPath:
    """A path that takes over during a run."""

    path: Path  # the path, world frame
    at_s: float  # time since the first decision
    # the path is moved, so that it begins where the robot then is, and leads where it points
    here: bool = False


class PathSender:
    """Sends a running robot a path, part by part, while its other frames are handled in their order."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._path: Path | None = None
        self._sent = self._tries = 0
        self._sequence = -1
        self._sent_s = 0.0

    def begin(self, path: Path) -> None:
        """Send the first part; a path that is still being sent is abandoned."""
        self._path = path
        self._parts = path_frames(path_rows(path).T.tolist())
        self._sent = self._tries = 0
        self._send()

    def _send(self) -> None:
        values, rows = self._parts[self._sent]
        self._sequence = self._session.post("PATH", values, rows)
        self._sent_s = self._session.link_s
        self._sent += 1

    def send_again(self) -> None:
        """Begin anew if an answer does not come. LinkError: again and again."""
        if self._path is not None and self._session.link_s - self._sent_s > ANSWER_S:
            self._session.forget(self._sequence)
            self._begin_again(self._path, "does not answer")
            self._send()

    def _begin_again(self, path: Path, what: str, why: str = "") -> None:
        self._tries += 1
        if self._tries >= TRIES:
            raise LinkError(f"the robot {what} the path {path.name!r} that was to take over{why}; run again")
        self._sent = 0

    def answered(self, frame: Frame) -> Path | None:
        """Process an answer to PATH and send the next part; return the path once all of it has arrived.

        Raises:
            LinkError: the robot refuses it again and again.
        """
        if self._path is None or frame.sequence != self._sequence:
            return None
        status = int(frame.values["status"])
        if status != 0:
            self._begin_again(self._path, "refuses", f": {link_layout().status_name(status)}")
        if self._sent < len(self._parts):
            self._send()
            return None
        path, self._path = self._path, None
        return path


class Holding:
    """Sends an approach and laps before a path ends, and new laps after each lap.

    A robot that is far from the approach, as it could not follow its path, gets another one from where it is.
    A current or a worn limb carries the robot away from its circle. The laps are therefore moved against the
    mean offset of the previous lap (an integral controller).

    Attributes:
        began: the robot has reached the circle around the end of its path.
    """

    def __init__(self, path: Path, radius_m: float, area_m: Float64) -> None:
        """Begin with a run's first path.

        Args:
            path: world frame.
            radius_m: of the circle, m.
            area_m: (2, 2) least and largest x and y of the robot's centre, world, m.
        """
        self._radius_m, self._area_m = radius_m, area_m
        self._shift_m = np.zeros(2)
        self._follow(path)

    def _follow(self, path: Path) -> None:
        """An ordinary path is followed from now on, which ends a hold."""
        self._hold: Hold = hold_at_end(path, self._radius_m)
        along_m = path.along_m
        # Early enough to arrive in time, and late enough that the robot continues at its position.
        early_m = self._hold.leave_m - (LEAD - 0.5) * self._radius_m
        is_short = self._hold.leave_m > along_m[-1]
        self._send_at = 0 if is_short else int(np.searchsorted(along_m, early_m))
        self._circle_point: int | None = None
        self._laps = self._hold.laps
        self._beside_m: list[Float64] = []  # the robot's offset from its place on the path, in a lap
        self._off_m = 0.0  # the length of that offset at the last decision, on an entry or in a lap
        self._followed_for = 0  # decisions since the last path took over
        self._is_anew = False  # another entry was sent
        self._is_sent = self.began = False

    def due(self, decisions: Sequence[Decision]) -> Path | None:
        """The path to send now, or None."""
        if self._is_sent or not decisions or decisions[-1].status != 0:
            return None
        if self._circle_point and not self.began and (anew := self._entry_from(decisions[-1])):
            self._hold = anew
            self._is_sent = self._is_anew = True
            return anew.entry
        if decisions[-1].path_index < self._send_at:
            return None
        self._is_sent = True
        if self._circle_point is None:
            return self._hold.entry
        if self._beside_m:
            shift_m = self._shift_m - SHIFT_GAIN * (self._shift_m + np.mean(self._beside_m, axis=0))
            self._shift_m = shift_m * SHIFT_MAX_M / max(float(np.hypot(*shift_m)), SHIFT_MAX_M)
        self._laps = self._hold.laps.place((*self._shift_m.tolist(), 0.0))
        return self._laps

    def _entry_from(self, decision: Decision) -> Hold | None:
        """Another way onto the circle, if the robot is too far from the one that it follows."""
        is_far = self._off_m > OFF * self._radius_m
        if self._is_anew or not is_far or self._followed_for < ANEW_AFTER:
            return None
        x, y, heading, ahead_mps, left_mps, _ = decision.predicted.tolist()
        is_moving = math.hypot(ahead_mps, left_mps) > MOVING_MPS
        course = heading + (math.atan2(left_mps, ahead_mps) if is_moving else 0.0)
        return hold_from_pose(self._hold, self._radius_m, np.array([x, y, course]), self._area_m)

    def followed(self, path: Path) -> tuple[float, float, int] | None:
        """Record that a path has taken over; return its entry in the log if it holds, else None."""
        if path is self._hold.entry:
            self._circle_point = self._hold.circle_point
        elif path is self._laps:
            self._circle_point = 0
        else:
            self._follow(path)
            return None
        self._send_at = self._circle_point + LAP_POINTS + AGAIN_POINTS
        self._along, self._circle, self._beside_m = np.arange(len(path)), path.points_m, []
        self._is_sent, self._followed_for = False, 0
        return (*self._hold.end_m, self._circle_point)

    def decided(self, decision: Decision) -> None:
        """Record a decision; the hold begins when the robot reaches the circle."""
        if self._circle_point is None or decision.status == STALE:
            return
        place = [np.interp(decision.along_points, self._along, column) for column in self._circle.T]
        beside_m = decision.estimate[:2] - place
        self._off_m = math.hypot(*beside_m)
        self._followed_for += 1
        if decision.path_index >= self._circle_point:
            self.began = True
            self._beside_m.append(beside_m)


@dataclass
class PathChanges:
    """The paths that follow a run's first one."""

    planned: Sequence[NextPath]  # in the order of their times
    made: list[PathChange] = field(default_factory=list)  # the paths that have taken over
    holding: Holding | None = None  # holds at the end of the path that is followed; None: the run ends there
    _begun: int = 0
    _arrived: Path | None = None

    def due(self, since_s: float, fixes: Sequence[Fix], decisions: Sequence[Decision]) -> Path | None:
        """Return the path to send now, ``since_s`` after the first decision, or None.

        The newest fix gives the robot's position, and the last decision its progress along the path.
        """
        if self._begun < len(self.planned) and since_s >= self.planned[self._begun].at_s:
            following = self.planned[self._begun]
            if not following.here or fixes:
                self._begun += 1
                if not following.here:
                    return following.path
                return following.path.place(following.path.motion_to(fixes[-1].pose_world.tolist()))
        return None if self.holding is None else self.holding.due(decisions)

    def arrived(self, path: Path) -> None:
        """Record that the planner, on the robot or the host, has received a path."""
        self._arrived = path

    def decided(self, decisions: Sequence[Decision]) -> None:
        """Record the last decision; if it had no estimate, a new path waits for the next one."""
        if self._arrived is not None and decisions[-1].status != STALE:
            hold = None if self.holding is None else self.holding.followed(self._arrived)
            self.made.append(PathChange(len(decisions) - 1, self._arrived, hold))
            self._arrived = None
        if self.holding is not None:
            self.holding.decided(decisions[-1])

    @property
    def holds(self) -> bool:
        """Whether the robot has begun to circle the end of its path."""
        return self.holding is not None and self.holding.began


def hold_spans(
    time_s: Float64, path_index: Sequence[int], changes: Sequence[PathChange]
) -> list[tuple[float, float, tuple[float, float]]]:
    """Begin and end (s) of each hold and the point circled, by each decision's time and place on the path."""
    index = np.asarray(path_index)
    spans: list[tuple[float, float, tuple[float, float]]] = []
    goes_on = False
    for change, following in zip(changes, (*changes[1:], None), strict=False):
        if change.hold is None:
            goes_on = False
            continue
        last = len(time_s) if following is None else following.decision
        there = np.arange(change.decision, last)
        on = there if goes_on else there[index[there] >= change.hold[2]]
        if len(on):
            until_s = math.inf if following is None else float(time_s[last])
            spans.append((float(time_s[on[0]]), until_s, change.hold[:2]))
            goes_on = True
    return spans


def spans_of(run: RunLog) -> list[tuple[float, float, tuple[float, float]]]:
    """``hold_spans`` of a run; a log without places on its path has none."""
    index = run.decisions.extra.get("path_index")
    return [] if index is None else hold_spans(run.decisions.time_s, index.tolist(), run.then)
