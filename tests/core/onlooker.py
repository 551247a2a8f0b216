"""An onlooker with a clock: hears the radio, sees the pins, and knows the limits. Shares nothing with the C.

The limits by their definition, in whole microseconds and without tolerance. Every window of the duty is
looked at: the time on within a window is greatest for one that ends where a pulse ends.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
import numpy.typing as npt

from frogkick.robot import Robot

POWER_ON, RESET, ARM, DISARM, STOP, STARTED, ENDED, FIX, HIGH, LOW, STATE, FAULT = range(12)
SEEN = np.dtype([("time_us", "<i8"), ("kind", "<i4"), ("value", "<i4")])
"""What is seen, in order of time (a FIX: its picture's); the value is a limb's index, or a state.

RESET: pins are released. ARM: the command has reached the robot, not for a second time.
DISARM, STOP: likewise, each time.
STARTED, ENDED: the robot said so. FIX: the robot took one. FAULT: an internal error has happened to it.
"""
LIMITS = ("pulse", "rest", "duty", "together", "armed", "off", "fresh", "lost", "told", "latched")
COUNTS = (*LIMITS, "pulses", "pulses in a run", "runs lost", "at the rest", "at the duty")
_NEVER = np.int64(-(2**62))
_RING = 64


@dataclass(frozen=True)
class Limits:
    """A robot's limits, us. ``late``: what its port may take to switch the pins off."""

    pulse: int
    rest: int
    window: int
    on: int
    together: int
    fresh: int
    lost: int
    late: int = 200

    @classmethod
    def of(cls, robot: Robot) -> Limits:
        """The limits of a robot's TOML."""
        guard = robot.guard
        return cls(
            pulse=round(guard.pulse_max_s * 1e6),
            rest=round(guard.rest_min_s * 1e6),
            window=round(guard.duty_window_s * 1e6),
            on=round(guard.duty_max * guard.duty_window_s * 1e6),
            together=guard.limbs_at_once_max,
            fresh=round(guard.fix_fresh_s * 1e6),
            lost=round(guard.fix_lost_s * 1e6),
        )


def judge(limits: Limits, seen: npt.NDArray[Any]) -> dict[str, int]:
    """How often each limit was broken, and how much there was to see: a number for each of COUNTS."""
    numbers = np.array(
        [limits.pulse, limits.rest, limits.window, limits.on, limits.together, limits.fresh, limits.lost,
         limits.late],
        dtype=np.int64,
    )  # fmt: skip
    counts = np.zeros(len(COUNTS), dtype=np.int64)
    _judge(numbers, seen["time_us"], seen["kind"], seen["value"], counts)
    return dict(zip(COUNTS, counts.tolist(), strict=True))


def broken(counts: dict[str, int]) -> dict[str, int]:
    """The limits that were broken, and how often."""
    return {name: counts[name] for name in LIMITS if counts[name]}


@numba.njit(cache=True)
def _judge(limits, times, kinds, values, counts):
    pulse_max, rest_min, window, on_max, together_max, fresh, lost, late = limits
    starts = np.full((8, _RING), _NEVER)
    ends = np.full((8, _RING), _NEVER)
    many = np.zeros(8, np.int64)  # pulses that each limb has had
    on = np.zeros(8, np.bool_)
    armed = False
    faulty = False
    running = False
    fix_us = _NEVER
    off_by_us = _NEVER  # pins that were on must be low by then; _NEVER: no such wish
    for row in range(len(times)):
        now, kind, value = times[row], kinds[row], values[row]
        if kind == POWER_ON:
            many[:] = 0
            on[:] = False
            armed = faulty = running = False
            fix_us = off_by_us = _NEVER
            continue
        if running and kind != FIX and now - fix_us > lost:
            # Whatever comes next, the robot must have disarmed itself.
            running = armed = False
            counts[12] += 1
        if kind == HIGH:
            counts[10] += 1
            counts[11] += running
            counts[4] += not armed
            counts[9] += faulty
            counts[6] += running and now - fix_us > fresh
            if many[value] > 0:
                rest = now - ends[value, (many[value] - 1) % _RING]
                counts[1] += rest < rest_min
                counts[13] += rest_min <= rest <= rest_min + 1000
            on[value] = True
            starts[value, many[value] % _RING] = now
            counts[3] += on.sum() > together_max
        elif kind == LOW:
            place = many[value] % _RING
            on[value] = False
            ends[value, place] = now
            many[value] += 1
            counts[0] += now - starts[value, place] > pulse_max
            held = np.int64(0)
            for back in range(min(many[value], _RING)):
                other = (many[value] - 1 - back) % _RING
                held += max(np.int64(0), ends[value, other] - max(starts[value, other], now - window))
            counts[2] += held > on_max
            counts[14] += on_max - 5000 <= held <= on_max
            counts[5] += off_by_us != _NEVER and now > off_by_us and starts[value, place] < off_by_us - late
        elif kind == RESET:
            armed = faulty = running = False
            fix_us = off_by_us = _NEVER
        elif kind == ARM:
            armed = not faulty
        elif kind == DISARM:
            armed = running = False
            off_by_us = now + late
        elif kind in (STOP, ENDED):
            running = False
        elif kind == STARTED:
            running = True
        elif kind == FIX:
            fix_us = max(fix_us, now)
        elif kind == STATE:
            counts[7] += (value == 1 or value == 2) and not armed
            counts[8] += (value == 2) != running
        elif kind == FAULT:
            faulty = True
            armed = running = False
            off_by_us = now + late
