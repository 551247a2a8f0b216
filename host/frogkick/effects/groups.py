"""Effects of limbs by where they sit: all front ones, all on the left."""

from __future__ import annotations

import numpy as np

from frogkick.core.errors import InputError
from frogkick.effects.base import Effect, History, Parameter, Stroke
from frogkick.robot import Robot


def require_group(effect: Effect, group: str, robot: Robot) -> None:
    """Refuse a word that is in no limb's name.

    Raises:
        InputError: it names the words that are.
    """
    words = sorted({word for limb in robot.limbs for word in limb.name.split("_")})
    if group not in words:
        raise InputError(
            f"effect {effect.title!r}: robot {robot.id!r} has no limb with {group!r} in its name: "
            f"choose from {', '.join(words)}"
        )


class GroupGain(Effect):
    """Limbs of one group differ from the model: in another limb's wake, or built differently."""

    name = "group_gain"
    about = "limbs whose name has a word in it (front, rear, left, right) straighten by a share of the stroke"
    shown_by = "actions of that group against those of the others"
    parameters = (
        Parameter("gain", "1", 0.3, 1.7, 1.0, "share of the measured stroke"),
        Parameter(
            "duration_scale", "1", 0.5, 4.0, 1.0, "how many times as long as measured it takes to curl back"
        ),
    )
    options = {"group": None}

    group: str
    gain: float
    duration_scale: float

    def check(self, robot: Robot) -> None:
        require_group(self, self.group, robot)

    def stroke(self, stroke: Stroke, history: History, rng: np.random.Generator) -> Stroke:
        if self.group in stroke.limb.split("_"):
            stroke.gain *= self.gain
            stroke.duration_scale *= self.duration_scale
        return stroke
