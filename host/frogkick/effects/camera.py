"""Effects of the camera: a fix differs from the robot's pose."""

from __future__ import annotations

import numpy as np

from frogkick.core.poses import Fix, rotate
from frogkick.effects.base import Effect, parameter


class CameraScale(Effect):
    """A wrong calibration: distances from the origin are too long or too short."""

    name = "camera_scale"
    about = "fixes are scaled about the world's origin"
    shown_by = "every motion too long by one factor, whatever the action; sizes of things of known length"
    scale = parameter("1", 0.8, 1.25, 1.0, "what is measured over what is true")

    def fix(self, fix: Fix, rng: np.random.Generator) -> Fix:
        fix.x_m *= self.scale
        fix.y_m *= self.scale
        return fix


class TagOffset(Effect):
    """The tag is beside the body's centre, or turned on it.

    A camera that is turned about its axis turns positions and headings equally, which no run shows and which
    does no harm. A difference between the two is a turned tag. Likewise a displaced camera moves all
    positions equally, and only a tag beside the centre shows.
    """

    name = "tag_offset"
    about = "the tag sits beside the body's centre and turned against its forward axis"
    shown_by = "sideways motion in proportion to turning (place); drift to one side of the heading (angle)"
    forward_m = parameter("m", -0.05, 0.05, 0.0, "tag in front of the centre")
    left_m = parameter("m", -0.05, 0.05, 0.0, "tag left of the centre")
    turn_rad = parameter("rad", -0.4, 0.4, 0.0, "tag's heading over the body's")

    def fix(self, fix: Fix, rng: np.random.Generator) -> Fix:
        x_m, y_m = rotate(fix.heading_rad, self.forward_m, self.left_m)
        fix.x_m += x_m
        fix.y_m += y_m
        fix.heading_rad += self.turn_rad
        return fix


class FixLatency(Effect):
    """Fixes are older than their capture times."""

    name = "fix_latency"
    about = "a fix shows the robot as it was earlier than the fix says"
    shown_by = "the lag between a command and the motion that answers it"
    delay_s = parameter("s", 0.0, 0.5, 0.0, "from the picture to the capture time that the fix claims")

    def fix(self, fix: Fix, rng: np.random.Generator) -> Fix:
        fix.capture_s += self.delay_s
        return fix


class ClockDrift(Effect):
    """The camera stamps its pictures by a clock of its own, which is not kept in step with the robot's."""

    name = "clock_drift"
    about = "the camera's clock gains or loses time against the robot's"
    shown_by = "a lag between command and motion that grows through a run, or turns into a lead"
    drift = parameter("1", -0.02, 0.02, 0.0, "time gained per time since the run began")

    def fix(self, fix: Fix, rng: np.random.Generator) -> Fix:
        gained_s = self.drift * fix.capture_s
        fix.capture_s += gained_s
        fix.delay_s -= gained_s  # it arrives when it would
        return fix
