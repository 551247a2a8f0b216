"""Effects of the limbs: wear, memory of the last stroke, warming up, battery, interaction of two groups."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from frogkick.effects.base import Effect, FloatArray, History, Parameter, Stroke, limb_index
from frogkick.robot import Robot

ALL = "all"

DELAYS_S = (0.015, 0.03, 0.045, 0.06, 0.075, 0.09, 0.105, 0.12, 0.135, 0.15, 0.18, 0.22, 0.26)
"""Closer than half a swing of a frame, some 25 ms: a delayed stroke meets another phase of it."""


class LimbWear(Effect):
    """A worn actuator: it straightens less, later, or curls back more slowly."""

    name = "limb_wear"
    about = "a limb, or all, straighten by a share of the measured stroke, later, and curl back more slowly"
    shown_by = "forward and turn of the actions that fire the limb, against those that do not"
    parameters = (
        Parameter("gain", "1", 0.3, 1.5, 1.0, "share of the measured stroke"),
        Parameter("delay_s", "s", 0.0, 0.3, 0.0, "from the pulse to the stroke", 0.005, DELAYS_S),
        Parameter("duration_scale", "1", 0.5, 4.0, 1.0, "how many times as long it takes to curl back"),
    )
    options = {"limb": ALL}

    limb: str
    gain: float
    delay_s: float
    duration_scale: float

    def check(self, robot: Robot) -> None:
        if self.limb != ALL:
            limb_index(robot, self, self.limb)

    def stroke(self, stroke: Stroke, history: History, rng: np.random.Generator) -> Stroke:
        if self.limb in (ALL, stroke.limb):
            stroke.gain *= self.gain
            stroke.delay_s += self.delay_s
            stroke.duration_scale *= self.duration_scale
        return stroke


class LimbMemory(Effect):
    """A limb that fired lately is still warm: its next stroke has less way to go."""

    name = "limb_memory"
    about = "a stroke loses a share that fades with the time since the same limb's last one"
    shown_by = "an action after one that fired the same limbs, against the same action after others"
    parameters = (
        Parameter("loss", "1", -0.3, 0.8, 0.0, "share lost right after a stroke"),
        Parameter("fade_s", "s", 0.2, 10.0, 1.5, "time in which what is lost falls to 37 %"),
    )

    loss: float
    fade_s: float

    def stroke(self, stroke: Stroke, history: History, rng: np.random.Generator) -> Stroke:
        stroke.gain *= 1.0 - self.loss * math.exp(-history.since_s(stroke.index, stroke.time_s) / self.fade_s)
        return stroke


class WarmUp(Effect):
    """The first strokes of a run are weaker: wires and water are cold."""

    name = "warm_up"
    about = "strokes lose a share that fades with the number of strokes since the start"
    shown_by = "the first periods of each run against its later ones"
    parameters = (
        Parameter("loss", "1", -0.5, 0.9, 0.0, "share lost at the first stroke"),
        Parameter("fade_strokes", "1", 0.5, 20.0, 2.0, "strokes in which it falls to 37 %"),
    )

    loss: float
    fade_strokes: float

    def stroke(self, stroke: Stroke, history: History, rng: np.random.Generator) -> Stroke:
        stroke.gain *= 1.0 - self.loss * math.exp(-history.pulses / self.fade_strokes)
        return stroke


class BatterySag(Effect):
    """The batteries run down within a run: strokes weaken with time."""

    name = "battery_sag"
    about = "strokes lose a share that grows evenly with time"
    shown_by = "long runs: the same action early and late"
    parameters = (Parameter("loss_per_min", "1/min", 0.0, 0.5, 0.0, "share lost each minute"),)

    loss_per_min: float

    def stroke(self, stroke: Stroke, history: History, rng: np.random.Generator) -> Stroke:
        start_s = history.strokes[0][0] if history.strokes else stroke.time_s
        stroke.gain *= max(0.0, 1.0 - self.loss_per_min * (stroke.time_s - start_s) / 60.0)
        return stroke


class GroupLoss(Effect):
    """Limbs that fire right after others stroke in water that these have set in motion."""

    name = "group_loss"
    about = "a stroke loses a share that fades with the time since other limbs fired"
    shown_by = "actions of both groups against those of one; open-loop swims over the phase"
    parameters = (
        Parameter("loss", "1", -0.3, 0.8, 0.0, "share lost by limbs that fire at once after others"),
        Parameter("fade_s", "s", 0.02, 1.0, 0.15, "time in which what is lost falls to 37 %"),
    )

    loss: float
    fade_s: float

    def starts(self, low_m: FloatArray, high_m: FloatArray) -> Sequence[Mapping[str, float]]:
        """One: groups mostly fire at one distance in time, and then any fading does for a start."""
        return ({"fade_s": 0.15},)

    def stroke(self, stroke: Stroke, history: History, rng: np.random.Generator) -> Stroke:
        # Limbs that fire at the same time disturb each other as little as when their profile was measured.
        earlier = [then for then, limb in history.strokes if limb != stroke.index and then < stroke.time_s]
        since_s = stroke.time_s - max(earlier, default=-math.inf)
        stroke.gain *= 1.0 - self.loss * math.exp(-since_s / self.fade_s)
        return stroke
