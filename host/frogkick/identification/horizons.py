"""Several periods ahead: from where a period began, the actions really done, no further look at the fixes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from frogkick.core.poses import PredictionError
from frogkick.der import WIDTH
from frogkick.identification.fit import Model
from frogkick.identification.gentle import Amid, gentle
from frogkick.identification.predict import Course, Lane, Party, parties
from frogkick.identification.segments import Segments
from frogkick.paths import wrap_angle
from frogkick.robot import Robot

FloatArray = NDArray[np.float64]

HORIZONS = (1, 2, 3, 5)
"""Periods ahead."""

STARTS_MOST = 60
"""Starts in all runs together; of more, evenly spread ones are taken: each costs as much as its periods."""


@dataclass(frozen=True)
class Horizon:
    """Errors so many periods ahead, over the same starts without and with what was found."""

    periods: int
    before: PredictionError
    after: PredictionError

    def as_json(self) -> dict[str, Any]:
        """One of ``test.horizons``."""
        return {
            "periods": self.periods,
            "before": self.before.as_json(),
            "after": self.after.as_json(),
            "count": self.before.count,
        }


def horizons_of(
    nominal: Model, fitted: Model, swims: Sequence[Segments], ahead: Sequence[int] = HORIZONS
) -> list[Horizon]:
    """How far both models are off by horizon, without those that no run is long enough for.

    Args:
        nominal, fitted: models.
        swims: the runs.
        ahead: periods.
    """
    every = -(-sum(len(swim.start_s) for swim in swims) // STARTS_MOST)
    models = (nominal, fitted)
    ends = follow_ahead([model.lane(swim) for model in models for swim in swims], ahead, every)
    found = []
    for row, periods in enumerate(ahead):
        gaps = []
        for which in range(len(models)):
            parts = [_gap(swim, ends[which * len(swims) + k][row], periods) for k, swim in enumerate(swims)]
            gaps.append(np.concatenate(parts) if parts else np.empty((0, 3)))
        known = np.isfinite(gaps[0]).all(axis=1) & np.isfinite(gaps[1]).all(axis=1)
        if known.any():
            found.append(Horizon(periods, *(PredictionError.of(gap[known]) for gap in gaps)))
    return found


def _gap(swim: Segments, predicted: FloatArray, periods: int) -> FloatArray:
    """(m, 3) measured minus predicted pose so many periods after each start; NaN where one is not known."""
    gap = np.full((len(swim.start_s), 3), np.nan)
    whole = len(gap) - periods + 1
    if whole > 0:
        gap[:whole] = swim.measured[periods - 1 :] - predicted[:whole]
        gap[:, 2] = wrap_angle(gap[:, 2])
    return gap


def follow_ahead(lanes: Sequence[Lane], ahead: Sequence[int], every: int = 1) -> list[FloatArray]:
    """Predict runs several periods ahead from the starts of their periods.

    Args:
        lanes: runs, by robots with effects.
        ahead: periods, increasing.
        every: only each so manieth start of a run.

    Returns:
        For each lane (len(ahead), m, 3): the pose that the camera would show so many periods after each
        start; NaN where the run has not so many in a row, or the start was left out.
    """
    found = [np.full((len(ahead), len(lane.swim.start_s), 3), np.nan) for lane in lanes]
    for indices, robot in parties(lanes):
        party = _Leaving([lanes[index] for index in indices], robot, ahead[-1], every)
        party.go()
        # Longest first: a batch goes on as long as its longest.
        departures = sorted(party.departures, key=lambda each: -len(each.ends_s))
        for first in range(0, len(departures), WIDTH):
            some = departures[first : first + WIDTH]
            flight = _Flight(some, robot)
            for step, poses in enumerate(flight.poses(), 1):
                if step in ahead:
                    for each, pose in zip(some, poses, strict=True):
                        found[indices[each.index]][ahead.index(step), each.period] = pose
    return found


@dataclass(frozen=True, eq=False)
class _Departure:
    """Where a lane stood when a period began.

    Attributes:
        index: of the lane in its party.
        period: which.
        amid: its robot.
        course: its way, with an effect's history of its own.
        ends_s: of this period and of those that follow on it.
    """

    index: int
    period: int
    amid: Amid
    course: Course
    ends_s: FloatArray


class _Leaving(Party):
    """Notes where lanes stand when periods begin."""

    def __init__(self, lanes: Sequence[Lane], robot: Robot, longest: int, every: int) -> None:
        super().__init__(lanes, robot)
        self.departures: list[_Departure] = []
        self._longest, self._every = longest, every

    def began(self, seat: int, period: int) -> None:
        if period % self._every:
            return
        index = self.seats[seat]
        course, swim = self.courses[index], self.lanes[index].swim
        last = period
        while (
            last + 1 < min(len(swim.start_s), period + self._longest)
            and abs(swim.start_s[last + 1] - swim.end_s[last]) < 1e-6
        ):
            last += 1
        apart = replace(course, acting=course.acting.copy())
        self.departures.append(
            _Departure(index, period, self.batch.leave(seat), apart, swim.end_s[period : last + 1])
        )


class _Flight(Party):
    """Lanes that go on from their departures without any fix."""

    def __init__(self, departures: Sequence[_Departure], robot: Robot) -> None:
        self.lanes = [each.course.lane for each in departures]
        self.courses = [each.course for each in departures]
        self.seats = list(range(len(departures)))
        self.batch = gentle(robot, np.zeros((len(departures), 3)), self.lanes[0].step_s)
        for lane, each in enumerate(departures):
            self.batch.enter(lane, each.amid)
        self.leg_s = min(course.acting.leg_s for course in self.courses)
        self._departures = departures

    def poses(self) -> Iterator[list[FloatArray]]:
        """Period by period each lane's pose as the camera would show it; NaN where it has ended or failed."""
        for step in range(max(len(each.ends_s) for each in self._departures)):
            ends_s = [float(each.ends_s[min(step, len(each.ends_s) - 1)]) for each in self._departures]
            self.advance(np.array(ends_s))
            told = []
            for lane, (each, end_s) in enumerate(zip(self._departures, ends_s, strict=True)):
                lost = step >= len(each.ends_s) or each.amid.failed or lane in self.batch.failures
                told.append(np.full(3, np.nan) if lost else self.shown_at(self.courses[lane], end_s)[1])
            yield told
