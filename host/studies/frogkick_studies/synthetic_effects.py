"""Worlds with synthetic effects: none, one of the catalogue, two, one from outside the catalogue, or laws."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from frogkick_studies.synthetic_laws import (
    DRAWN,
    Draw,
    Random,
    Table,
    any_limb,
    between,
    drawn,
    effect,
    misfire,
    signed,
)

NULL, ONE, TWO, OUTSIDE, LAWS = "nothing", "one", "two", "outside", "laws"

OUTSIDE_FILE = "outside.py"
OUTSIDE_TEXT = '''"""Effects that the catalogue does not have."""

import math


class HeadingGain:
    def __init__(self, depth, towards_rad):
        self.depth, self.towards_rad, self.heading_rad = depth, towards_rad, 0.0

    def wrench(self, time_s, body):
        self.heading_rad = body.pose_world[2]
        return 0.0, 0.0, 0.0

    def stroke(self, stroke, history, rng):
        stroke.gain *= 1.0 - self.depth * 0.5 * (1.0 + math.cos(self.heading_rad - self.towards_rad))


class ClockGain:
    def __init__(self, depth, period_s):
        self.depth, self.period_s = depth, period_s

    def stroke(self, stroke, history, rng):
        stroke.gain *= 1.0 - self.depth * 0.5 * (1.0 + math.sin(math.tau * stroke.time_s / self.period_s))


class Weeds:
    """Water that resists here and there."""

    def __init__(self, drag, pitch_m):
        self.drag, self.pitch_m = drag, pitch_m

    def wrench(self, time_s, body):
        x, y, _ = body.pose_world
        here = 0.5 * (1.0 + math.sin(math.tau * x / self.pitch_m) * math.cos(math.tau * y / self.pitch_m))
        forward, left, _ = body.velocity_body
        return -self.drag * here * forward, -self.drag * here * left, 0.0


class Waves:
    def __init__(self, speed_mps, period_s):
        self.speed_mps, self.period_s = speed_mps, period_s

    def flow(self, time_s, position_world_m):
        return self.speed_mps * math.sin(math.tau * time_s / self.period_s), 0.0


class Whirl:
    def __init__(self, turns_per_s):
        self.turns_per_s = turns_per_s

    def flow(self, time_s, position_world_m):
        x, y = position_world_m
        return -y * self.turns_per_s, x * self.turns_per_s


class SlowLens:
    """A camera that is off to one side of its picture."""

    def __init__(self, bend_per_m):
        self.bend_per_m = bend_per_m

    def fix(self, fix, rng):
        fix.x_m += self.bend_per_m * fix.x_m * fix.x_m
        fix.heading_rad += 0.5 * self.bend_per_m * fix.y_m
        return fix
'''


@dataclass(frozen=True)
class Kind:
    """A kind of synthetic world.

    Attributes:
        name: for reports.
        group: NULL, ONE, TWO, OUTSIDE or LAWS.
        draw: tables of a world, from a random generator.
        alike: titles of effects that are equivalent to it.
    """

    name: str
    group: str
    draw: Callable[[np.random.Generator], list[Table]]
    alike: tuple[str, ...] = ()


def _slow(rng: Random) -> Table:
    limb, slow = any_limb(rng), between(1.5, 2.5)(rng)
    return {"name": "limb_wear", "limb": limb, "gain": between(0.75, 0.95)(rng), "duration_scale": slow}


def _current(rng: Random) -> Table:
    speed, way = rng.uniform(0.003, 0.01), rng.uniform(-np.pi, np.pi)
    x, y = float(np.round(speed * np.cos(way), 5)), float(np.round(speed * np.sin(way), 5))
    return {"name": "steady_current", "x_mps": x, "y_mps": y}


def _wall(rng: Random) -> Table:
    """A wall close to the paper's paths: beside the ellipse, or before the end of the line."""
    side = str(rng.choice(["x_high", "y_low", "y_high"]))
    at_m = between(0.42, 0.47) if side == "x_high" else between(0.13, 0.16)
    drag, hardness = between(0.5, 1.5), between(0.5, 0.7)
    return effect("wall", side=side, at_m=at_m, drag_ns_per_m=drag, hardness=hardness)(rng)


_OFF_M, _TAG_M, _TURN_M2PS = signed(0.003, 0.01), signed(0, 0.02), signed(0.003, 0.008)

ONES: Mapping[str, Draw] = {
    "wear": effect("limb_wear", limb=any_limb, gain=between(0.6, 0.9)),
    "slow limb": _slow,
    "current": _current,
    "latency": effect("fix_latency", delay_s=between(0.06, 0.15)),
    "tag": effect("tag_offset", forward_m=_TAG_M, left_m=_TAG_M, turn_rad=signed(0.06, 0.2)),
    "yaw drag": effect("yaw_drag", linear_nms=between(2e-4, 1e-3)),
    "warm-up": effect("warm_up", loss=between(0.3, 0.6), fade_strokes=between(2.0, 5.0)),
    "memory": effect("limb_memory", loss=between(0.2, 0.5), fade_s=between(1.0, 3.0)),
    "sag": effect("battery_sag", loss_per_min=between(0.2, 0.4)),
    "centre mass": effect("centre_mass", share=between(0.2, 0.6)),
    "drag": effect("drag_scale", frame=between(1.3, 2.0)),
    "scale": effect("camera_scale", scale=lambda rng: 1.0 + signed(0.03, 0.08)(rng)),
    "late limb": effect("limb_wear", limb=any_limb, delay_s=between(0.06, 0.15)),
    "mass": effect("mass_scale", frame=between(1.3, 2.0)),
    "off-centre": effect("off_centre_mass", forward_m=_OFF_M, left_m=_OFF_M),
    "shear": effect("shear_current", x_per_s=signed(0.02, 0.06)),
    "vortex": effect(
        "vortex", circulation_m2ps=_TURN_M2PS, x_m=between(0.05, 0.3), y_m=between(-0.1, 0.1),
        core_m=between(0.1, 0.25),
    ),
    "wall": _wall,
    "group loss": effect("group_loss", loss=between(0.3, 0.6), fade_s=between(0.1, 0.3)),
}  # fmt: skip
SAME: Mapping[str, tuple[str, ...]] = {
    # If rear limbs never fire without front ones, their loss through these is a constant share.
    "group loss": ("group_gain", "group_loss"),
    "whirl": ("shear_current", "vortex"),
}
"""Kinds that are equivalent to another effect for a robot with the paper's nine actions."""

PAIRS = (
    ("wear", "current"),
    ("wear", "latency"),
    ("current", "tag"),
    ("yaw drag", "wear"),
    ("memory", "current"),
    ("drag", "wear"),
)


OUTSIDES: Mapping[str, Draw] = {
    "heading gain": effect(
        "HeadingGain", OUTSIDE_FILE, depth=between(0.2, 0.5), towards_rad=between(-3.0, 3.0)
    ),
    "clock gain": effect("ClockGain", OUTSIDE_FILE, depth=between(0.2, 0.5), period_s=between(8.0, 20.0)),
    "weeds": effect("Weeds", OUTSIDE_FILE, drag=between(0.1, 0.5), pitch_m=between(0.2, 0.4)),
    "waves": effect("Waves", OUTSIDE_FILE, speed_mps=between(0.005, 0.02), period_s=between(6.0, 15.0)),
    "whirl": effect("Whirl", OUTSIDE_FILE, turns_per_s=signed(0.01, 0.05)),
    "misfire 10 to 20 %": misfire(0.1, 0.2),
    "misfire 20 to 30 %": misfire(0.2, 0.3),
    "misfire 30 to 40 %": misfire(0.3, 0.4),
    "lens": effect("SlowLens", OUTSIDE_FILE, bend_per_m=between(0.1, 0.3)),
}


def kinds() -> dict[str, Kind]:
    """All kinds of synthetic worlds, by name."""
    planted: dict[str, dict[str, Sequence[Draw]]] = {
        NULL: {"null": ()},
        ONE: {name: (draw,) for name, draw in ONES.items()},
        TWO: {" + ".join(pair): [ONES[name] for name in pair] for pair in PAIRS},
        OUTSIDE: {name: (draw,) for name, draw in OUTSIDES.items()},
        LAWS: dict(DRAWN),
    }
    return {
        name: Kind(name, group, partial(drawn, draws), SAME.get(name, ()))
        for group, of in planted.items()
        for name, draws in of.items()
    }
