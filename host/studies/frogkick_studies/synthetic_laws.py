"""Effects of the group *laws*, which the catalogue does not contain, and the right law for each.

They are classes in a user's file, in plain Python and not in the language of laws, so that the count does not
favour the forms of that language: a patch of weeds has another edge than the patch of a law, and a spring may
be a cable.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from frogkick.identification.segments import Segments
from frogkick.identification.terms import Term

Table = dict[str, Any]
"""An ``[[effect]]`` table of a world."""

Random = np.random.Generator
Draw = Callable[[Random], Table]
LIMBS = ("front_left", "front_right", "rear_left", "rear_right")


def effect(kind: str, file: str = "", **values: Any) -> Draw:
    """A built-in effect, or with ``file`` a class of that file, whose values are drawn in order."""
    head = {"file": file, "class": kind} if file else {"name": kind}

    def draw(rng: Random) -> Table:
        return head | {name: value(rng) if callable(value) else value for name, value in values.items()}

    return draw


def any_limb(rng: Random) -> str:
    """One of LIMBS."""
    return str(rng.choice(LIMBS))


def between(low: float, high: float) -> Callable[[Random], float]:
    """Uniform, rounded to the digits that a table shows."""
    return lambda rng: float(np.round(rng.uniform(low, high), 5))


def signed(low: float, high: float) -> Callable[[Random], float]:
    """The same, of either sign."""
    return lambda rng: float(rng.choice([-1.0, 1.0])) * between(low, high)(rng)


def spread(low: float, high: float) -> Callable[[Random], float]:
    """Log-uniform, for strengths."""
    return lambda rng: float(f"{np.exp(rng.uniform(np.log(low), np.log(high))):.4g}")


LAWS_FILE = "synthetic_laws.py"
LAWS_TEXT = '''"""Effects that the catalogue does not have."""

import math


class Cable:
    """Pulls to a point as soon as it is taut; a spring where its length is nought."""

    def __init__(self, stiffness, x, y, length):
        self.stiffness, self.x, self.y, self.length = stiffness, x, y, length

    def wrench(self, time_s, body):
        px, py, heading = body.pose_world
        dx, dy = self.x - px, self.y - py
        away = math.sqrt(dx * dx + dy * dy)
        if away <= self.length:
            return 0.0, 0.0, 0.0
        pull = self.stiffness * (away - self.length) / away
        c, s = math.cos(heading), math.sin(heading)
        return pull * (c * dx + s * dy), pull * (c * dy - s * dx), 0.0


class Sloshing:
    """All the water swings to and fro along one line."""

    def __init__(self, speed, cycle, way, phase):
        self.speed, self.cycle, self.way, self.phase = speed, cycle, way, phase

    def flow(self, time_s, position_world_m):
        now = self.speed * math.cos(math.tau * time_s / self.cycle + self.phase)
        return now * math.cos(self.way), now * math.sin(self.way)


class Misfire:
    """A limb that does nothing in some of its strokes, at random."""

    def __init__(self, limb, share):
        self.limb, self.share = limb, share

    def stroke(self, stroke, history, rng):
        if stroke.limb == self.limb and rng.random() < self.share:
            stroke.gain = 0.0


class Break:
    """A limb that breaks midway."""

    def __init__(self, limb, at, rest):
        self.limb, self.at, self.rest = limb, at, rest

    def stroke(self, stroke, history, rng):
        if stroke.limb == self.limb and stroke.time_s >= self.at:
            stroke.gain *= self.rest


class SharedBattery:
    """Each of two limbs is weaker where the other one fired just before."""

    def __init__(self, limb, other, loss, within):
        self.pair, self.loss, self.within = (limb, other), loss, within
        self.last = {}

    def stroke(self, stroke, history, rng):
        if stroke.limb not in self.pair:
            return
        other = self.pair[1 - self.pair.index(stroke.limb)]
        if 0.0 <= stroke.time_s - self.last.get(other, -1e9) < self.within:
            stroke.gain *= 1.0 - self.loss
        self.last[stroke.limb] = stroke.time_s


class Slime:
    """Resists along the motion with a power of the speed; ``drag`` is the force at 3 cm/s."""

    def __init__(self, drag, power):
        self.drag, self.power = drag, power

    def wrench(self, time_s, body):
        forward, left, _ = body.velocity_body
        speed = math.hypot(forward, left)
        if speed < 1e-9:
            return 0.0, 0.0, 0.0
        force = self.drag * (speed / 0.03) ** self.power
        return -force * forward / speed, -force * left / speed, 0.0


class ByHeading:
    """Strokes are weaker the more the robot points to one side."""

    def __init__(self, depth, towards):
        self.depth, self.towards, self.heading = depth, towards, 0.0

    def wrench(self, time_s, body):
        self.heading = body.pose_world[2]
        return 0.0, 0.0, 0.0

    def stroke(self, stroke, history, rng):
        stroke.gain *= 1.0 - self.depth * math.cos(0.5 * (self.heading - self.towards)) ** 2


class Patch:
    """A round patch of weeds, densest in its middle, with an end."""

    def __init__(self, drag, x, y, radius):
        self.drag, self.x, self.y, self.radius = drag, x, y, radius

    def wrench(self, time_s, body):
        x, y, _ = body.pose_world
        away = math.hypot(x - self.x, y - self.y) / self.radius
        here = self.drag * (1.0 - away * away) ** 2 if away < 1.0 else 0.0
        forward, left, _ = body.velocity_body
        return -here * forward, -here * left, 0.0


class LaggingClock:
    """The camera's clock is behind for a part of each cycle: fixes are older than they say."""

    def __init__(self, late, cycle, share, begin):
        self.late, self.cycle, self.share, self.begin = late, cycle, share, begin

    def fix(self, fix, rng):
        if (fix.capture_s - self.begin) % self.cycle < self.share * self.cycle:
            fix.capture_s += self.late
            fix.delay_s -= self.late
        return fix


class Jumps:
    """Some fixes are far off, at random."""

    def __init__(self, share, size):
        self.share, self.size = share, size

    def fix(self, fix, rng):
        if rng.random() < self.share:
            way = math.tau * rng.random()
            fix.x_m += self.size * math.cos(way)
            fix.y_m += self.size * math.sin(way)
        return fix


class Magnet:
    """Turns the robot towards one heading, as a compass needle."""

    def __init__(self, torque, towards):
        self.torque, self.towards = torque, towards

    def wrench(self, time_s, body):
        return 0.0, 0.0, -self.torque * math.sin(body.pose_world[2] - self.towards)


class Fan:
    """Is switched on midway and pushes one way from then on."""

    def __init__(self, x, y, at):
        self.x, self.y, self.at = x, y, at

    def wrench(self, time_s, body):
        if time_s < self.at:
            return 0.0, 0.0, 0.0
        c, s = math.cos(body.pose_world[2]), math.sin(body.pose_world[2])
        return c * self.x + s * self.y, c * self.y - s * self.x, 0.0
'''


HEADING = between(-math.pi, math.pi)
PAIRS = (
    ("front_left", "front_right"),
    ("rear_left", "rear_right"),
    ("front_right", "rear_left"),
    ("front_left", "rear_right"),
)
"""Limbs that fire both together and apart in the paper's nine actions.

The later one is weaker; where both fire at once, the later one in the robot's order."""


def _made(kind: str, **values: Any) -> Draw:
    return effect(kind, LAWS_FILE, **values)


def _cable(rng: Random) -> Table:
    """A cable or, with the same probability, a spring, which is taut everywhere."""
    at = {"x": between(-0.1, 0.5)(rng), "y": between(-0.3, 0.3)(rng)}
    length = between(0.1, 0.25)(rng) if rng.random() < 0.5 else 0.0
    return _made("Cable", stiffness=spread(0.003, 0.05), **at, length=length)(rng)


def _sloshing(rng: Random) -> Table:
    way, phase = HEADING(rng), HEADING(rng)
    return _made("Sloshing", speed=spread(0.003, 0.03), cycle=between(5.0, 10.0), way=way, phase=phase)(rng)


def misfire(low: float = 0.1, high: float = 0.4) -> Draw:
    """A limb that does nothing in a share of its strokes, from ``low`` to ``high``."""
    return _made("Misfire", limb=any_limb, share=between(low, high))


def _shared_battery(rng: Random) -> Table:
    limb, other = PAIRS[rng.integers(len(PAIRS))]
    battery = _made(
        "SharedBattery", limb=limb, other=other, loss=between(0.25, 0.8), within=between(0.3, 0.6)
    )
    return battery(rng)


def _patch(rng: Random) -> Table:
    """Where the paper's paths lead through."""
    at = {"x": between(0.1, 0.35)(rng), "y": between(-0.08, 0.08)(rng)}
    return _made("Patch", drag=spread(0.2, 1.5), **at, radius=between(0.1, 0.2))(rng)


def _clock(rng: Random) -> Table:
    cycle = between(5.0, 9.0)(rng)
    late, share = between(0.08, 0.25), between(0.3, 0.6)
    return _made("LaggingClock", late=late, cycle=cycle, share=share, begin=between(0.0, cycle))(rng)


def _fan(rng: Random) -> Table:
    force, way = spread(2e-4, 3e-3)(rng), rng.uniform(-math.pi, math.pi)
    x, y = float(np.round(force * np.cos(way), 6)), float(np.round(force * np.sin(way), 6))
    return _made("Fan", x=x, y=y, at=between(7.0, 13.0))(rng)


def _power(rng: Random) -> float:
    return float(rng.choice([0.5, 1.0, 3.0]))


_BREAK = _made("Break", limb=any_limb, at=between(7.0, 13.0), rest=between(0.0, 0.6))
_BY_HEADING = _made("ByHeading", depth=between(0.1, 0.4), towards=HEADING)

DRAWN: Mapping[str, Sequence[Draw]] = {
    "spring to a point": (_cable,),
    "sloshing": (_sloshing,),
    "misfire": (misfire(),),
    "break": (_BREAK,),
    "spring to a point + break": (_cable, _BREAK),
    "shared battery": (_shared_battery,),
    "other drag": (_made("Slime", drag=spread(2e-4, 2e-3), power=_power),),
    "thrust by heading": (_BY_HEADING,),
    "patch of weeds": (_patch,),
    "sloshing + patch of weeds": (_sloshing, _patch),
    "lagging clock": (_clock,),
    "jumping fixes": (_made("Jumps", share=between(0.02, 0.1), size=spread(0.003, 0.02)),),
    "magnet": (_made("Magnet", torque=spread(1e-5, 1e-4), towards=HEADING),),
    "fan from a moment on": (_fan,),
    "spring to a point + thrust by heading": (_cable, _BY_HEADING),
}
"""Kind -> its effects, which act at once. Every fifth kind has two."""


def drawn(draws: Sequence[Draw], rng: Random) -> list[Table]:
    """The tables of a world of a kind."""
    return [draw(rng) for draw in draws]


TAUT_LEAST, FIRED_LEAST, EACH_SIDE = 10, 20, 5
"""What training runs must contain, at least.

Periods with a cable taut, strokes of a limb that misfires, and strokes before and after a break, or with
another limb's and alone."""


def enough_of(tables: Sequence[Table], swims: Sequence[Segments], limbs: Sequence[str]) -> bool:
    """Whether runs contain enough of the true effects to identify them.

    Args:
        tables: the true effects.
        swims: the training runs.
        limbs: names in the robot's order.
    """
    return all(_enough_of(table, swims, limbs) for table in tables)


def _enough_of(table: Table, swims: Sequence[Segments], limbs: Sequence[str]) -> bool:
    kind = table["class"]
    if kind == "Cable":
        taut = 0
        for swim in swims:
            x, y = (np.interp(swim.start_s, swim.time_s, swim.pose[:, axis]) for axis in range(2))
            taut += int((np.hypot(x - table["x"], y - table["y"]) > table["length"]).sum())
        return taut >= TAUT_LEAST
    if kind not in ("Misfire", "Break", "SharedBattery"):
        return True
    fired = _fired(swims, limbs.index(table["limb"]))
    count = sum(map(len, fired))
    if kind == "Misfire":
        return count >= FIRED_LEAST
    if kind == "Break":
        late = sum(at >= float(table["at"]) for run in fired for at in run)
        return bool(EACH_SIDE <= late <= count - EACH_SIDE)
    others = _fired(swims, limbs.index(table["other"]))
    beside = [np.abs(np.subtract.outer(*pair)) < table["within"] for pair in zip(fired, others, strict=True)]
    return all(
        EACH_SIDE
        <= sum(int(pairs.any(axis=axis).sum()) for pairs in beside)
        <= sum(map(len, runs)) - EACH_SIDE
        for axis, runs in ((1, fired), (0, others))
    )


def _fired(swims: Sequence[Segments], limb: int) -> list[list[float]]:
    return [[at for at, which in swim.strokes if which == limb] for swim in swims]


@dataclass(frozen=True)
class Right:
    """The right law for a true effect.

    Attributes:
        titles: of equivalent laws, each of which is right.
        near: parameter -> true value and tolerance; parameters that a law lacks do not count.
        chance: ("stroke" | "fix", limb or ""): any law on that whose formula has ``chance`` is right.
    """

    titles: tuple[str, ...] = ()
    near: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    chance: tuple[str, str] | None = None

    def holds(self, term: Term) -> bool:
        """Whether an identified effect is this law."""
        keys = dict(term.table)
        values = dict(zip((p.name for p in term.parameters), term.values, strict=True))
        if self.chance is not None:
            on, limb = self.chance
            formulas = " ".join(str(value) for value in keys.values())
            same = term.name == "law" and keys["on"] == on and "chance" in formulas
            return same and keys.get("limb", "") == limb
        return term.title in self.titles and all(
            abs(values[name] - value) <= far for name, (value, far) in self.near.items() if name in values
        )


MOMENT_S, PLACE_M, CYCLE, POWER = 3.0, 0.12, 0.1, 1.0
"""Tolerances of a moment (two periods), of a position, of a cycle (relative), and of a power."""


def _cycle(table: Table) -> dict[str, tuple[float, float]]:
    return {"cycle": (table["cycle"], CYCLE * table["cycle"])}


def _place(table: Table) -> dict[str, tuple[float, float]]:
    return {f"at_{axis}": (table[axis], PLACE_M) for axis in "xy"}


def _right_cable(table: Table) -> Right:
    # A spring without slack is a force that falls in proportion to both coordinates.
    same = ("push that grows with place",) if not table["length"] else ()
    return Right(("spring", *same), _place(table))


def _right_slime(table: Table) -> Right:
    # A drag in proportion to the speed has the power 1.
    same = ("drag by speed",) if abs(table["power"] - 1.0) <= POWER else ()
    return Right(("drag power", *same), {"power": (table["power"], POWER)})


RIGHT: Mapping[str, Callable[[Table], Right]] = {
    "Cable": _right_cable,
    "Sloshing": lambda table: Right(("sloshing",), _cycle(table)),
    "Misfire": lambda table: Right(chance=("stroke", table["limb"])),
    "Break": lambda table: Right(
        (f"stroke from a moment on {table['limb']}",), {"at": (table["at"], MOMENT_S)}
    ),
    "SharedBattery": lambda table: Right((f"stroke after {table['limb']} {table['other']}",)),
    "Slime": _right_slime,
    "ByHeading": lambda _table: Right(("stroke by heading all",)),
    "HeadingGain": lambda _table: Right(("stroke by heading all",)),
    "Patch": lambda table: Right(("patch", "patch with an end"), _place(table)),
    "LaggingClock": lambda table: Right(("fixes late at intervals",), _cycle(table)),
    "Jumps": lambda _table: Right(chance=("fix", "")),
    "Magnet": lambda _table: Right(("compass",)),
    "Fan": lambda table: Right(("push from a moment on",), {"at": (table["at"], MOMENT_S)}),
    "ClockGain": lambda table: Right(
        ("stroke in rhythm all",), {"cycle": (table["period_s"], CYCLE * table["period_s"])}
    ),
    "Waves": lambda table: Right(("sloshing",), {"cycle": (table["period_s"], CYCLE * table["period_s"])}),
    "Whirl": lambda _table: Right(("flow that grows with place",)),
}
"""Class of a true effect -> the right law; also for those of *outside* that a law can describe."""


def rights(tables: Sequence[Table]) -> list[Right]:
    """The right laws for the true effects; empty if no law is."""
    found = [RIGHT[str(table["class"])](table) for table in tables if table.get("class") in RIGHT]
    return found if len(found) == len(tables) else []
