"""Progress of a robot along its path, and the end of its run: the twin of firmware/core/fk_follow.c."""

from __future__ import annotations

import enum

import numpy as np

from frogkick.core.arrays import Float32
from frogkick.planner import costs
from frogkick.planner.plan import BestBranch, Cost, PathLike, PlanConfig, path_rows
from frogkick.tables.image import Tables

IDLE_DECISIONS_MAX = 40
IDLE_LACKING_MAX = 20
_GAIN = np.float32(0.25)


class End(enum.Enum):
    """Why a run ends."""

    COMPLETED = "completed"
    PASSED = "passed the end"
    STALLED = "no progress"


class Follow:
    """Progress of one run along a path.

    A decision makes progress if the robot is a quarter of its longest stroke further along the path, or that
    much nearer to it, than at the last decision that made progress. After IDLE_DECISIONS_MAX decisions
    without progress the run has stalled, after IDLE_LACKING_MAX where the robot lacks a limb.

    Attributes:
        path: the path that is followed.
        coming: a path that takes its place at the next decision with an estimate; None: there is none.
        along_points: float32, place along the path at the last decision, in points; 0 at the start.
    """

    def __init__(self, tables: Tables, path: PathLike, config: PlanConfig) -> None:
        self.coming: PathLike | None = None
        self._use(path)
        self._reach_m = np.float32(tables.stroke_max_m)
        self._is_route = config.cost == Cost.ROUTE
        self.begin()

    def _use(self, path: PathLike) -> None:
        self.path = path
        self._path = path_rows(path)

    def begin(self) -> None:
        """Start a run, on the newest path."""
        if self.coming is not None:
            self._use(self.coming)
        self.coming = None
        self.along_points = np.float32(0.0)
        self._mark: tuple[np.float32, tuple[np.float32, np.float32], np.float32] | None = None
        self._idle = 0

    def take_over(self, x_m: np.float32, y_m: np.float32) -> None:
        """Follow the coming path, if there is one, from where the robot is nearest to it.

        Where several of its stretches are as near, it is the first of these: a path that closes or crosses
        itself is not cut short. As near: the squares of the distances differ by that of a stroke at most.

        Args:
            x_m, y_m: the robot's place, world.
        """
        if self.coming is None:
            return
        self.begin()
        parts, distances2 = self._nearest_parts(x_m, y_m)
        near = distances2 <= distances2.min() + self._reach_m * self._reach_m
        first = int(np.argmax(near))
        beyond = np.flatnonzero(~near[first:])
        stretch = distances2[first : first + int(beyond[0])] if len(beyond) else distances2[first:]
        segment = first + int(np.argmin(stretch))
        self.along_points = np.float32(segment) + parts[segment]

    def _nearest_parts(self, x_m: np.float32, y_m: np.float32) -> tuple[Float32, Float32]:
        """(n - 1,) nearest place on each segment, a share of it, and its squared distance from a position."""
        here, along = self._path[:2, :-1], np.diff(self._path[:2], axis=1)
        away = np.array([[x_m], [y_m]], dtype=np.float32) - here
        length2 = along[0] * along[0] + along[1] * along[1]
        done2 = away[0] * along[0] + away[1] * along[1]
        at_end = done2 >= length2
        parts = np.where(done2 > 0.0, done2 / np.where(at_end, np.float32(1.0), length2), np.float32(0.0))
        parts = np.where(at_end, np.float32(1.0), parts)
        across = away - parts * along
        return parts, across[0] * across[0] + across[1] * across[1]

    def decided(self, plan: BestBranch, lacks_a_limb: bool = False) -> End | None:
        """Note a decision; return why the run ends with it, or None.

        Args:
            plan: what was decided.
            lacks_a_limb: one of the robot's limbs is believed to be lost.
        """
        self.along_points = plan.along_points
        self._note_progress(plan.distance_m)
        if plan.path_index + 1 >= self._path.shape[1]:
            return self._end(plan.distance_m) if self._is_route else End.COMPLETED
        idle_max = IDLE_LACKING_MAX if lacks_a_limb else IDLE_DECISIONS_MAX
        return End.STALLED if self._idle >= idle_max else None

    def fixed(self, x_m: np.float32, y_m: np.float32) -> End | None:
        """Note a fix; return why the run ends with it, or None.

        With the route cost a run ends as soon as it crosses the path's end.
        """
        if self.coming is not None or self._mark is None or not self._is_route:
            return None
        stroke_max = costs.stroke_scale(self._reach_m)
        segment, part, distance2, _ = costs.project(self._path, stroke_max, self.along_points, x_m, y_m)
        if np.float32(segment) + part < self._path.shape[1] - 1:
            return None
        return self._end(np.sqrt(distance2))

    def _end(self, distance_m: np.float32) -> End:
        return End.COMPLETED if distance_m <= self._reach_m else End.PASSED

    def _place(self) -> tuple[np.float32, np.float32]:
        segment = min(int(self.along_points), self._path.shape[1] - 2)
        part = self.along_points - np.float32(segment)
        here, following = self._path[:2, segment], self._path[:2, segment + 1]
        x_m, y_m = here + part * (following - here)
        return x_m, y_m

    def _note_progress(self, distance_m: np.float32) -> None:
        x_m, y_m = self._place()
        if self._mark is not None:
            points, (mark_x_m, mark_y_m), mark_distance_m = self._mark
            dx_m, dy_m = x_m - mark_x_m, y_m - mark_y_m
            gain_m = _GAIN * self._reach_m
            is_further = self.along_points > points and dx_m * dx_m + dy_m * dy_m >= gain_m * gain_m
            if not is_further and not distance_m <= mark_distance_m - gain_m:
                self._idle += 1
                return
        self._mark = (self.along_points, (x_m, y_m), distance_m)
        self._idle = 0
