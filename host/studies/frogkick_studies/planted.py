"""Worlds with planted effects: none, one of the catalogue, two, one from outside the catalogue, or laws."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from frogkick_studies.draws import LIMBS, Table, between, sign
from frogkick_studies.planted_laws import DRAWN, drawn, misfire

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
    """A way to plant something.

    Attributes:
        name: for reports.
        group: NULL, ONE, TWO, OUTSIDE or LAWS.
        draw: tables of a world, from a random generator.
        alike: titles of effects that are the same thing under another name.
    """

    name: str
    group: str
    draw: Callable[[np.random.Generator], list[Table]]
    alike: tuple[str, ...] = ()


def _wear(rng: np.random.Generator) -> Table:
    return {"name": "limb_wear", "limb": str(rng.choice(LIMBS)), "gain": between(rng, 0.6, 0.9)}


def _slow(rng: np.random.Generator) -> Table:
    limb, slow = str(rng.choice(LIMBS)), between(rng, 1.5, 2.5)
    return {"name": "limb_wear", "limb": limb, "gain": between(rng, 0.75, 0.95), "duration_scale": slow}


def _current(rng: np.random.Generator) -> Table:
    speed, way = rng.uniform(0.003, 0.01), rng.uniform(-np.pi, np.pi)
    x, y = float(np.round(speed * np.cos(way), 5)), float(np.round(speed * np.sin(way), 5))
    return {"name": "steady_current", "x_mps": x, "y_mps": y}


def _latency(rng: np.random.Generator) -> Table:
    return {"name": "fix_latency", "delay_s": between(rng, 0.06, 0.15)}


def _tag(rng: np.random.Generator) -> Table:
    ahead, left, turn = (sign(rng) * between(rng, *ends) for ends in ((0, 0.02), (0, 0.02), (0.06, 0.2)))
    return {"name": "tag_offset", "forward_m": ahead, "left_m": left, "turn_rad": turn}


def _yaw(rng: np.random.Generator) -> Table:
    return {"name": "yaw_drag", "linear_nms": between(rng, 2e-4, 1e-3)}


def _warm(rng: np.random.Generator) -> Table:
    return {"name": "warm_up", "loss": between(rng, 0.3, 0.6), "fade_strokes": between(rng, 2.0, 5.0)}


def _memory(rng: np.random.Generator) -> Table:
    return {"name": "limb_memory", "loss": between(rng, 0.2, 0.5), "fade_s": between(rng, 1.0, 3.0)}


def _sag(rng: np.random.Generator) -> Table:
    return {"name": "battery_sag", "loss_per_min": between(rng, 0.2, 0.4)}


def _centre(rng: np.random.Generator) -> Table:
    return {"name": "centre_mass", "share": between(rng, 0.2, 0.6)}


def _drag(rng: np.random.Generator) -> Table:
    return {"name": "drag_scale", "frame": between(rng, 1.3, 2.0)}


def _scale(rng: np.random.Generator) -> Table:
    return {"name": "camera_scale", "scale": 1.0 + sign(rng) * between(rng, 0.03, 0.08)}


def _late(rng: np.random.Generator) -> Table:
    return {"name": "limb_wear", "limb": str(rng.choice(LIMBS)), "delay_s": between(rng, 0.06, 0.15)}


def _mass(rng: np.random.Generator) -> Table:
    return {"name": "mass_scale", "frame": between(rng, 1.3, 2.0)}


def _off_centre(rng: np.random.Generator) -> Table:
    ahead, left = (sign(rng) * between(rng, 0.003, 0.01) for _ in range(2))
    return {"name": "off_centre_mass", "forward_m": ahead, "left_m": left}


def _shear(rng: np.random.Generator) -> Table:
    return {"name": "shear_current", "x_per_s": sign(rng) * between(rng, 0.02, 0.06)}


def _vortex(rng: np.random.Generator) -> Table:
    turning = sign(rng) * between(rng, 0.003, 0.008)
    at = {"x_m": between(rng, 0.05, 0.3), "y_m": between(rng, -0.1, 0.1)}
    return {"name": "vortex", "circulation_m2ps": turning, **at, "core_m": between(rng, 0.1, 0.25)}


def _wall(rng: np.random.Generator) -> Table:
    """Where the paper's paths come near: beside the ellipse, or before the end of the line."""
    side = str(rng.choice(["x_high", "y_low", "y_high"]))
    at_m = between(rng, 0.42, 0.47) if side == "x_high" else between(rng, 0.13, 0.16)
    drag, hardness = between(rng, 0.5, 1.5), between(rng, 0.5, 0.7)
    return {
        "name": "wall",
        "side": side,
        "at_m": at_m,
        "drag_ns_per_m": drag,
        "hardness": hardness,
    }


def _group_loss(rng: np.random.Generator) -> Table:
    return {"name": "group_loss", "loss": between(rng, 0.3, 0.6), "fade_s": between(rng, 0.1, 0.3)}


def _mine(kind: str, **values: float | str) -> list[Table]:
    return [{"file": OUTSIDE_FILE, "class": kind, **values}]


def _misfire(low: float, high: float, rng: np.random.Generator) -> list[Table]:
    return [misfire(rng, low, high)]


ONES: Mapping[str, Callable[[np.random.Generator], Table]] = {
    "wear": _wear,
    "slow limb": _slow,
    "current": _current,
    "latency": _latency,
    "tag": _tag,
    "yaw drag": _yaw,
    "warm-up": _warm,
    "memory": _memory,
    "sag": _sag,
    "centre mass": _centre,
    "drag": _drag,
    "scale": _scale,
    "late limb": _late,
    "mass": _mass,
    "off-centre": _off_centre,
    "shear": _shear,
    "vortex": _vortex,
    "wall": _wall,
    "group loss": _group_loss,
}
SAME: Mapping[str, tuple[str, ...]] = {
    # Where rear limbs never fire without front ones, what these take from them is always the same share.
    "group loss": ("group_gain", "group_loss"),
}
"""Kinds that are another effect as well for a robot with the paper's nine actions."""

PAIRS = (
    ("wear", "current"),
    ("wear", "latency"),
    ("current", "tag"),
    ("yaw drag", "wear"),
    ("memory", "current"),
    ("drag", "wear"),
)


def _drawn(names: Sequence[str], rng: np.random.Generator) -> list[Table]:
    return [ONES[name](rng) for name in names]


def kinds() -> dict[str, Kind]:
    """All ways to plant something, by name."""
    every = [Kind("null", NULL, lambda _rng: [])]
    every += [Kind(name, ONE, partial(_drawn, (name,)), SAME.get(name, ())) for name in ONES]
    every += [Kind(" + ".join(pair), TWO, partial(_drawn, pair)) for pair in PAIRS]
    every += [
        Kind(
            "heading gain",
            OUTSIDE,
            lambda rng: _mine(
                "HeadingGain", depth=between(rng, 0.2, 0.5), towards_rad=between(rng, -3.0, 3.0)
            ),
        ),
        Kind(
            "clock gain",
            OUTSIDE,
            lambda rng: _mine("ClockGain", depth=between(rng, 0.2, 0.5), period_s=between(rng, 8.0, 20.0)),
        ),
        Kind(
            "weeds",
            OUTSIDE,
            lambda rng: _mine("Weeds", drag=between(rng, 0.1, 0.5), pitch_m=between(rng, 0.2, 0.4)),
        ),
        Kind(
            "waves",
            OUTSIDE,
            lambda rng: _mine("Waves", speed_mps=between(rng, 0.005, 0.02), period_s=between(rng, 6.0, 15.0)),
        ),
        Kind(
            "whirl",
            OUTSIDE,
            lambda rng: _mine("Whirl", turns_per_s=sign(rng) * between(rng, 0.01, 0.05)),
            ("shear_current", "vortex"),
        ),
        *(
            Kind(
                f"misfire {low} to {high} %",
                OUTSIDE,
                partial(_misfire, 0.01 * low, 0.01 * high),
            )
            for low, high in ((10, 20), (20, 30), (30, 40))
        ),
        Kind("lens", OUTSIDE, lambda rng: _mine("SlowLens", bend_per_m=between(rng, 0.1, 0.3))),
    ]
    every += [Kind(name, LAWS, partial(drawn, draws)) for name, draws in DRAWN.items()]
    return {kind.name: kind for kind in every}
