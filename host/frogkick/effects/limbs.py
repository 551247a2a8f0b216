"""Effects of limbs and groups of limbs: wear, memory of earlier strokes, warming up, battery, interaction."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from frogkick.core.arrays import Float64
from frogkick.core.errors import InputError
from frogkick.effects.base import Effect, History, Stroke, limb_index, parameter
from frogkick.robot import Robot

ALL = "all"

DELAYS_S = (0.015, 0.03, 0.045, 0.06, 0.075, 0.09, 0.105, 0.12, 0.135, 0.15, 0.18, 0.22, 0.26)
"""Starting values of a delay. A delay shifts the stroke against the frame's oscillation of some 25 ms, so the
fit has local minima. The spacing is some half of that period, and more beyond 150 ms."""


class GroupEffect(Effect):
    """An effect on the limbs whose name has a word in it: front, rear, left, right."""

    options = {"group": None}

    group: str

    def check(self, robot: Robot) -> None:
        words = sorted({word for limb in robot.limbs for word in limb.name.split("_")})
        if self.group not in words:
            raise InputError(
                f"effect {self.title!r}: robot {robot.id!r} has no limb with {self.group!r} in its name: "
                f"choose from {', '.join(words)}"
            )

    def acts_on(self, limb: str) -> bool:
        """Return whether the name of a limb has the word."""
        return self.group in limb.split("_")


class LimbWear(Effect):
    """A worn actuator: it straightens less or later, or returns more slowly."""

    name = "limb_wear"
    about = (
        "one limb or all limbs straighten by a share of the measured stroke, later, and return more slowly"
    )
    shown_by = "forward and turn of the actions that fire the limb, against those that do not"
    gain = parameter("1", 0.3, 1.5, 1.0, "share of the measured stroke")
    delay_s = parameter("s", 0.0, 0.3, 0.0, "from the pulse to the stroke", step=0.005, grid=DELAYS_S)
    duration_scale = parameter("1", 0.5, 4.0, 1.0, "how many times as long it takes to curl back")
    options = {"limb": ALL}

    limb: str

    def check(self, robot: Robot) -> None:
        if self.limb != ALL:
            limb_index(robot, self, self.limb)

    def stroke(self, stroke: Stroke, history: History, rng: np.random.Generator) -> Stroke:
        if self.limb in (ALL, stroke.limb):
            stroke.gain *= self.gain
            stroke.delay_s += self.delay_s
            stroke.duration_scale *= self.duration_scale
        return stroke


class WeakenedLimb(Effect):
    """One limb straightens by a share of its stroke, down to none: for simulations, in no robot's file."""

    def __init__(self, limb: int, gain: float) -> None:
        """``limb`` is an index; ``gain`` is not limited as that of ``LimbWear`` is."""
        self.limb, self.gain = limb, gain

    def stroke(self, stroke: Stroke, history: History, rng: np.random.Generator) -> Stroke:
        if stroke.index == self.limb:
            stroke.gain *= self.gain
        return stroke


class LimbMemory(Effect):
    """A limb that fired recently is still warm, so its next stroke is smaller."""

    name = "limb_memory"
    about = "a stroke loses a share that fades with the time since the same limb's last one"
    shown_by = "an action after one that fired the same limbs, against the same action after others"
    loss = parameter("1", -0.3, 0.8, 0.0, "share lost right after a stroke")
    fade_s = parameter("s", 0.2, 10.0, 1.5, "time in which what is lost falls to 37 %")

    def stroke(self, stroke: Stroke, history: History, rng: np.random.Generator) -> Stroke:
        stroke.gain *= 1.0 - self.loss * math.exp(-history.since_s(stroke.index, stroke.time_s) / self.fade_s)
        return stroke


class WarmUp(Effect):
    """The first strokes of a run are weaker, because wires and water are cold."""

    name = "warm_up"
    about = "strokes lose a share that fades with the number of strokes since the start"
    shown_by = "the first periods of each run against its later ones"
    loss = parameter("1", -0.5, 0.9, 0.0, "share lost at the first stroke")
    fade_strokes = parameter("1", 0.5, 20.0, 2.0, "strokes in which it falls to 37 %")

    def stroke(self, stroke: Stroke, history: History, rng: np.random.Generator) -> Stroke:
        stroke.gain *= 1.0 - self.loss * math.exp(-history.pulses / self.fade_strokes)
        return stroke


class BatterySag(Effect):
    """The batteries discharge during a run: strokes weaken with time."""

    name = "battery_sag"
    in_tables = False
    about = "strokes lose a share that grows evenly with time"
    shown_by = "long runs: the same action early and late"
    loss_per_min = parameter("1/min", 0.0, 0.5, 0.0, "share lost each minute")

    def stroke(self, stroke: Stroke, history: History, rng: np.random.Generator) -> Stroke:
        start_s = history.strokes[0][0] if history.strokes else stroke.time_s
        stroke.gain *= max(0.0, 1.0 - self.loss_per_min * (stroke.time_s - start_s) / 60.0)
        return stroke


class GroupLoss(Effect):
    """Limbs that fire right after others push on water that already moves."""

    name = "group_loss"
    about = "a stroke loses a share that fades with the time since other limbs fired"
    shown_by = "actions of both groups against those of one; open-loop swims over the phase"
    loss = parameter("1", -0.3, 0.8, 0.0, "share lost by limbs that fire at once after others")
    fade_s = parameter("s", 0.02, 1.0, 0.15, "time in which what is lost falls to 37 %")

    def starts(self, low_m: Float64, high_m: Float64) -> Sequence[Mapping[str, float]]:
        """Return one start: the delay between groups is nearly constant, so any fading will do."""
        return ({"fade_s": 0.15},)

    def stroke(self, stroke: Stroke, history: History, rng: np.random.Generator) -> Stroke:
        # Limbs that fire at the same time disturb each other as little as when their profile was measured.
        earlier = [then for then, limb in history.strokes if limb != stroke.index and then < stroke.time_s]
        since_s = stroke.time_s - max(earlier, default=-math.inf)
        stroke.gain *= 1.0 - self.loss * math.exp(-since_s / self.fade_s)
        return stroke


class GroupGain(GroupEffect):
    """Limbs of one group differ from the model: in the wake of other limbs, or built differently."""

    name = "group_gain"
    about = "limbs whose name has a word in it (front, rear, left, right) straighten by a share of the stroke"
    shown_by = "actions of that group against those of the others"
    gain = parameter("1", 0.3, 1.7, 1.0, "share of the measured stroke")
    duration_scale = parameter("1", 0.5, 4.0, 1.0, "how many times as long as measured it takes to curl back")

    def stroke(self, stroke: Stroke, history: History, rng: np.random.Generator) -> Stroke:
        if self.acts_on(stroke.limb):
            stroke.gain *= self.gain
            stroke.duration_scale *= self.duration_scale
        return stroke
