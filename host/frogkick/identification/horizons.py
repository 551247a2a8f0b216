"""Multi-step prediction: several periods ahead from a period's start, without any further fix."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass
from typing import Any

import numpy as np

from frogkick.core.arrays import Float64
from frogkick.core.poses import PredictionError, wrap_angle
from frogkick.der import WIDTH, Checkpoint
from frogkick.identification.fit import Model
from frogkick.identification.predict import Lane, LaneState, RolloutBatch, lanes_by_body, replay_batch
from frogkick.identification.segments import Segments
from frogkick.robot import Robot

HORIZONS = (1, 2, 3, 5)  # periods ahead

STARTS_MOST = 60
"""Starts in all runs together; of more, evenly spaced ones are taken: each costs as much as its periods."""


@dataclass(frozen=True)
class Horizon:
    """Errors of predictions over a number of periods, over the same starts, without and with effects."""

    periods: int
    before: PredictionError
    after: PredictionError

    def as_json(self) -> dict[str, Any]:
        """One of ``test.horizons`` of the command ``identify``."""
        return {
            "periods": self.periods,
            "before": self.before.as_json(),
            "after": self.after.as_json(),
            "count": self.before.count,
        }


def horizons_of(
    nominal: Model, fitted: Model, swims: Sequence[Segments], ahead: Sequence[int] = HORIZONS
) -> list[Horizon]:
    """Errors of both models some periods ahead, without horizons that no run is long enough for."""
    every = -(-sum(len(swim.start_s) for swim in swims) // STARTS_MOST)
    models = (nominal, fitted)
    ends = roll_out_ahead([model.lane(swim) for model in models for swim in swims], ahead, every)
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


def _gap(swim: Segments, predicted: Float64, periods: int) -> Float64:
    """(m, 3) prediction errors ``periods`` after each start; NaN if unknown."""
    gap = np.full((len(swim.start_s), 3), np.nan)
    whole = len(gap) - periods + 1
    if whole > 0:
        gap[:whole] = swim.measured[periods - 1 :] - predicted[:whole]
        gap[:, 2] = wrap_angle(gap[:, 2])
    return gap


def roll_out_ahead(lanes: Sequence[Lane], ahead: Sequence[int], every: int = 1) -> list[Float64]:
    """Predict runs several periods ahead from the starts of their periods (open loop).

    Args:
        ahead: periods, increasing.
        every: spacing of the starts that are used; 1: all starts of a run.

    Returns:
        For each lane (len(ahead), m, 3): the pose that the camera would show that many periods after each
        start; NaN where the run has fewer consecutive periods, or the start was left out.
    """
    found = [np.full((len(ahead), len(lane.swim.start_s), 3), np.nan) for lane in lanes]
    for indices, robot in lanes_by_body(lanes):
        recorder = _StartRecorder([lanes[index] for index in indices], robot, ahead[-1], every)
        recorder.run()
        # Longest first: a batch takes as long as its longest lane.
        starts = sorted(recorder.starts, key=lambda each: -len(each.ends_s))
        for first in range(0, len(starts), WIDTH):
            some = starts[first : first + WIDTH]
            batch = _OpenLoopBatch(some, robot)
            for step, poses in enumerate(batch.poses(), 1):
                if step in ahead:
                    for each, pose in zip(some, poses, strict=True):
                        found[indices[each.index]][ahead.index(step), each.period] = pose
    return found


@dataclass(frozen=True, eq=False)
class _Start:
    """State of a lane when a period began, with a history of strokes of its own.

    ``ends_s`` are the ends of this period and of those that follow it directly.
    """

    index: int
    period: int
    checkpoint: Checkpoint
    lane_state: LaneState
    ends_s: Float64


class _StartRecorder(RolloutBatch):
    """Rolls out runs and records the states at which periods begin."""

    def __init__(self, lanes: Sequence[Lane], robot: Robot, longest: int, every: int) -> None:
        super().__init__(lanes, robot)
        self.starts: list[_Start] = []
        self._longest, self._every = longest, every

    def began(self, slot: int, period: int) -> None:
        if period % self._every:
            return
        index = self.slots[slot]
        lane_state, swim = self.lane_states[index], self.lanes[index].swim
        last = period
        until = min(len(swim.start_s), period + self._longest)
        while last + 1 < until and abs(swim.start_s[last + 1] - swim.end_s[last]) < 1e-6:
            last += 1
        own_state = copy(lane_state)
        own_state.acting = lane_state.acting.copy()
        self.starts.append(
            _Start(index, period, self.batch.save(slot), own_state, swim.end_s[period : last + 1])
        )


class _OpenLoopBatch(RolloutBatch):
    """Lanes that continue from recorded starts without fixes."""

    def __init__(self, starts: Sequence[_Start], robot: Robot) -> None:
        self.lanes = [each.lane_state.lane for each in starts]
        self.lane_states = [each.lane_state for each in starts]
        self.slots = list(range(len(starts)))
        self.batch = replay_batch(robot, np.zeros((len(starts), 3)), self.lanes[0].step_s)
        for lane, each in enumerate(starts):
            self.batch.restore(lane, each.checkpoint)
        self.leg_s = min(lane_state.acting.leg_s for lane_state in self.lane_states)
        self._starts = starts

    def poses(self) -> Iterator[list[Float64]]:
        """Poses of the lanes as the camera would show them, period by period; NaN after an end or failure."""
        for step in range(max(len(each.ends_s) for each in self._starts)):
            ends_s = [float(each.ends_s[min(step, len(each.ends_s) - 1)]) for each in self._starts]
            self.advance(np.array(ends_s))
            shown = []
            for lane, (each, end_s) in enumerate(zip(self._starts, ends_s, strict=True)):
                lost = step >= len(each.ends_s) or each.checkpoint.failed or lane in self.batch.failures
                shown.append(np.full(3, np.nan) if lost else self.shown_at_end(self.lane_states[lane], end_s))
            yield shown
