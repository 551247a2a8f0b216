"""Marks errors of single frames: time stamps of a backlog, gaps, tag misdetections, repeats.

Thresholds come from the published runs: the noise at rest is 0.2 mm and 0.2 degrees, the fastest stroke moves
the robot at 0.13 m/s and 1.6 rad/s. NOISE_POSITION_M was chosen on these seven runs so that an error of 3.9
mm in ellipse6 is found; it has not been tested on other runs.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from frogkick.runs.runlog import FixFlag

Float64 = NDArray[np.float64]
Bool = NDArray[np.bool_]

SPACING_MIN_S = 0.020
"""Every second frame of a 30 Hz camera is logged, so true spacings are longer."""
SETTLED_ROWS = 5
"""Successive rows with a credible spacing that end the backlog at the start."""
GAP_S = 0.150
"""The usual spacing is 67 ms, 133 ms with one lost frame: a longer one means at least two."""
# Six times the noise between frames, and more acceleration and speed than in any stroke.
NOISE_POSITION_M, NOISE_HEADING_RAD = 1.5e-3, np.radians(2.0)
ACCELERATION_MPS2, ACCELERATION_RADPS2 = 1.0, np.radians(1000.0)
SPEED_MAX_MPS, TURN_MAX_RADPS = 0.2, 2.5
MISDETECTED_ROWS_MAX = 3
"""Largest number of successive wrong frames."""


def untrusted_times(time_s: Float64) -> Bool:
    """(n,) rows whose time stamp is not the time of their frame.

    These are the leading rows up to the first with five credible spacings after it (a backlog that the logger
    wrote at once), and any later row within 20 ms of the row before.
    """
    spacing = np.diff(time_s)
    untrusted = np.concatenate([[False], spacing < SPACING_MIN_S])
    if not untrusted[: SETTLED_ROWS + 1].any():
        return untrusted
    close = np.flatnonzero(spacing < SPACING_MIN_S)
    # The backlog ends at the first row after which the next spacings are all credible.
    end = next(
        (
            int(row) + 1
            for row in close
            if not (spacing[row + 1 : row + 1 + SETTLED_ROWS] < SPACING_MIN_S).any()
        ),
        len(time_s),
    )
    untrusted[:end] = True
    return untrusted


def misdetections(time_s: Float64, pose: Float64, trusted: Bool) -> Bool:
    """(n,) rows where the tag jumped away and back.

    A group of up to three successive frames is wrong if all of them are off the straight line in time between
    the frames before and after, by more than noise + a/2 (t - t_before)(t_after - t) in position or heading
    (1.5 mm and 1 m/s^2; 2 degrees and 1000 degrees/s^2), while these two frames agree within 0.2 m/s and 2.5
    rad/s. The worst group is removed first, then the search is repeated.

    Args:
        time_s: (n,) s.
        pose: (n, 3) x m, y m, heading rad (any wrapping).
        trusted: (n,) rows with a usable time; others are left out.
    """
    unwrapped = np.column_stack([pose[:, :2], np.unwrap(pose[:, 2])])
    kept = np.flatnonzero(trusted)
    wrong = np.zeros(len(time_s), dtype=bool)
    while True:
        worst, group = 0.0, None
        for width in range(1, MISDETECTED_ROWS_MAX + 1):
            found = _worst_group(time_s[kept], unwrapped[kept], width)
            if found is not None and found[0] > worst:
                worst, group = found[0], kept[found[1] : found[1] + width]
        if group is None:
            return wrong
        wrong[group] = True
        kept = kept[~wrong[kept]]


def _worst_group(time_s: Float64, pose: Float64, width: int) -> tuple[float, int] | None:
    """(distance in units of noise, first row) of the worst group of ``width`` rows; distance 0: none.

    Groups are ranked by distance, not by excess over the limit: a good frame beside a wrong group is off by
        half
    the distance, but its limit is narrower.
    """
    count = len(time_s) - width - 1
    if count < 1:
        return None
    first = np.arange(1, count + 1)
    before, after = first - 1, first + width
    span = time_s[after] - time_s[before]
    step = pose[after] - pose[before]
    returns = (np.hypot(step[:, 0], step[:, 1]) <= SPEED_MAX_MPS * span + NOISE_POSITION_M) & (
        np.abs(step[:, 2]) <= TURN_MAX_RADPS * span + NOISE_HEADING_RAD
    )
    excess, size = np.full(count, np.inf), np.full(count, np.inf)
    for offset in range(width):
        row = first + offset
        ahead, behind = time_s[row] - time_s[before], time_s[after] - time_s[row]
        off = pose[row] - pose[before] - step * (ahead / span)[:, None]
        bend = 0.5 * ahead * behind
        position, heading = np.hypot(off[:, 0], off[:, 1]), np.abs(off[:, 2])
        beyond = np.maximum(
            position / (NOISE_POSITION_M + ACCELERATION_MPS2 * bend),
            heading / (NOISE_HEADING_RAD + ACCELERATION_RADPS2 * bend),
        )
        excess = np.minimum(excess, beyond)
        size = np.minimum(size, np.maximum(position / NOISE_POSITION_M, heading / NOISE_HEADING_RAD))
    size[~returns | (excess <= 1.0)] = 0.0
    worst = int(size.argmax())
    return float(size[worst]), int(first[worst])


def jumps(time_s: Float64, pose: Float64, usable: Bool) -> Bool:
    """(n,) usable rows farther from the usable row before than the robot can go."""
    rows = np.flatnonzero(usable)
    span = np.diff(time_s[rows])
    step = np.diff(np.column_stack([pose[rows, :2], np.unwrap(pose[rows, 2])]), axis=0)
    far = (np.hypot(step[:, 0], step[:, 1]) > SPEED_MAX_MPS * span + NOISE_POSITION_M) | (
        np.abs(step[:, 2]) > TURN_MAX_RADPS * span + NOISE_HEADING_RAD
    )
    marked = np.zeros(len(time_s), dtype=bool)
    marked[rows[1:][far]] = True
    return marked


def mark_frames(time_s: Float64, pose: Float64, carried: Bool) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Quality (n,) and FixFlag bits (n,) of each row, without AT_REST."""
    repeat = np.concatenate([[False], (np.diff(pose, axis=0) == 0.0).all(axis=1)])
    # The stamp of a repeated row does not count against its neighbours.
    twice = repeat & np.concatenate([[False], np.diff(time_s) < SPACING_MIN_S])
    untrusted = np.zeros(len(time_s), dtype=bool)
    untrusted[~twice] = untrusted_times(time_s[~twice])
    wrong = misdetections(time_s, pose, ~untrusted & ~repeat)
    jumped = jumps(time_s, pose, ~untrusted & ~repeat & ~wrong)
    # No frame after it can confirm a jump in the last row.
    unconfirmed = jumped & (np.arange(len(time_s)) == len(time_s) - 1)
    gap = np.concatenate([[False], np.diff(time_s) > GAP_S])
    flags = np.zeros(len(time_s), dtype=np.int64)
    for rows, flag in (
        (untrusted, FixFlag.UNTRUSTED_TIME),
        (gap, FixFlag.AFTER_GAP),
        (wrong, FixFlag.MISDETECTION),
        (jumped, FixFlag.JUMP),
        (repeat, FixFlag.DUPLICATE),
        (carried, FixFlag.REPAIRED_STAMP),
    ):
        flags[rows] |= int(flag)
    quality = np.where(wrong | repeat | unconfirmed, 0, 1)
    return quality, flags
