"""Effects of where the body's mass is."""

from __future__ import annotations

from dataclasses import replace

from frogkick.effects.base import Effect, Parameter
from frogkick.robot import Robot


class CentreMass(Effect):
    """A body whose mass is not on its outline: a filled frame turns more easily than a hoop."""

    name = "centre_mass"
    about = "a share of the frame's mass in motion sits at its centre, where it resists no turn"
    shown_by = "how far single strokes of one side turn the robot, against how far they push it"
    parameters = (Parameter("share", "1", 0.0, 0.95, 0.0, "of the mass that the model has on the outline"),)

    share: float

    def robot(self, robot: Robot) -> Robot:
        on_outline = (1.0 - robot.frame.centre_mass_share) * (1.0 - self.share)
        return replace(robot, frame=replace(robot.frame, centre_mass_share=1.0 - on_outline))
