"""The grammar of laws: kinds of formulas that runs are screened for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from itertools import product
from typing import Any

import numpy as np

from frogkick.core.arrays import Float64
from frogkick.effects import Law
from frogkick.identification.segments import Segments
from frogkick.identification.terms import Term, law_term
from frogkick.robot import Robot

Strength = tuple[str, float, float, float]
Numbers = Mapping[str, Strength]
"""Parameter -> unit, low, high, step of a finite difference (0: a share of its range)."""
Grid = Sequence[Mapping[str, float]]

PLACES, MANY = 11, 400
"""Places tried along each side of the area of the runs; half as many from MANY periods on, to save memory."""

PLACE_STEP_M = 0.005
"""Finite-difference step of a place: a longer one would cross the point at which a cable becomes taut."""

MOMENTS = 48  # largest number of moments that are tried for a law that acts from a moment on

INTERVALS = 120
"""Cycle times that are tried for a law at intervals: so close that no interval of a run is missed by one."""


@dataclass(frozen=True, eq=False)
class Kind:
    """A kind of law: formulas that are linear in their strengths, and a grid of shapes."""

    title: str  # its name in reports
    table: Mapping[str, str]  # ``on``, ``limb`` and the formulas
    strengths: Numbers  # parameters that the effect is proportional to; at 0 it vanishes
    shapes: Numbers = field(default_factory=dict)  # all other parameters
    grid: Grid = ({},)  # values of the shapes that are tried

    @cached_property
    def named(self) -> str:
        """The title of its terms, which includes the limb."""
        return self.term(self.grid[0]).title

    @cached_property
    def law(self) -> Law:
        """The law with strength 0 at the first shape of the grid."""
        law = self.term(self.grid[0]).effect()
        assert isinstance(law, Law)
        return law

    def term(self, shape: Mapping[str, float]) -> Term:
        """A term with strength 0 at a shape."""
        declared: dict[str, dict[str, Any]] = {}
        for name, (unit, low, high, step) in {**self.strengths, **self.shapes}.items():
            nominal = 0.0 if name in self.strengths else low
            declared[name] = {"unit": unit, "low": low, "high": high, "nominal": nominal, "step": step}
            if name == "at":  # all moments between two strokes are equivalent
                declared[name]["tolerance"] = 0.5 * step
        return law_term(self.title, self.table, declared, [shape.get(name, 0.0) for name in declared])


@dataclass(frozen=True, eq=False)
class Space:
    """Where and when the runs were, and the shapes that laws are tried with there.

    Of each shape: its parameters, and the grid of their values.
    """

    low: Float64  # (2,) corner of the area of the runs with a margin, m
    high: Float64  # (2,) the opposite corner, m
    side: int  # places along each side of the area
    end_s: float  # end of the longest run
    period_s: float

    @classmethod
    def of(cls, robot: Robot, swims: Sequence[Segments]) -> Space:
        """The space of a robot's runs."""
        reached = np.concatenate([swim.pose[:, :2] for swim in swims])
        side = PLACES if sum(len(swim.start_s) for swim in swims) < MANY else PLACES // 2
        end_s = float(max(swim.end_s[-1] for swim in swims if len(swim.end_s)))
        return cls(reached.min(axis=0) - 0.15, reached.max(axis=0) + 0.15, side, end_s, robot.period_s)

    @cached_property
    def where(self) -> Numbers:
        """A place, in m."""
        low, high = self.low.tolist(), self.high.tolist()
        return {f"at_{axis}": ("m", low[k] - 1.0, high[k] + 1.0, PLACE_STEP_M) for k, axis in enumerate("xy")}

    @cached_property
    def places(self) -> Grid:
        """Evenly over the area."""
        xs, ys = (np.linspace(self.low[k], self.high[k], self.side) for k in (0, 1))
        return [{"at_x": float(x), "at_y": float(y)} for x in xs for y in ys]

    @cached_property
    def when(self) -> Numbers:
        """A moment, in s. A law that acts from the very beginning needs none: the grammar has it without."""
        return {"at": ("s", min(2.0 * self.period_s, 0.5 * self.end_s), self.end_s, self.period_s)}

    @cached_property
    def whens(self) -> Grid:
        """Evenly over the longest run."""
        moments = min(MOMENTS, max(2, int(self.end_s / self.period_s) - 5))
        first, last = 3.0 * self.period_s, self.end_s - 3.0 * self.period_s
        return [{"at": float(at)} for at in np.linspace(first, last, moments)]

    @cached_property
    def cycle(self) -> Numbers:
        """A cycle time, in s."""
        return {"cycle": ("s", 0.5, 2.0 * self.end_s, 0.05)}

    @cached_property
    def cycles(self) -> Grid:
        """From one and a half periods to the longest run."""
        longest = max(self.end_s, 8.0 * self.period_s)
        return [{"cycle": float(c)} for c in np.geomspace(1.5 * self.period_s, longest, 30)]

    @cached_property
    def line(self) -> Numbers:
        """A line across the pool, by the direction and the distance from the origin."""
        return {"way": ("rad", -7.0, 7.0, 0.02), "offset": ("m", -3.0, 3.0, PLACE_STEP_M)}

    @cached_property
    def lines(self) -> Grid:
        """In twelve directions, through the area."""
        middle = 0.5 * (self.low + self.high)
        reach = 0.5 * float(np.hypot(*(self.high - self.low)))
        return [
            {"way": float(way), "offset": float(middle @ [np.cos(way), np.sin(way)] + far * reach)}
            for way in np.linspace(-np.pi, np.pi, 12, endpoint=False)
            for far in (-0.6, -0.4, -0.2, 0.0, 0.2, 0.4, 0.6)
        ]

    @cached_property
    def interval(self) -> Numbers:
        """A share of each cycle, about a time in its middle."""
        return {
            **self.cycle,
            "middle": ("s", -self.end_s, 2.0 * self.end_s, 0.08),
            "share": ("1", 0.02, 0.98, 0.01),
        }

    @cached_property
    def intervals(self) -> Grid:
        """From cycles of two periods to the longest run."""
        longest = max(self.end_s, 4.0 * self.period_s)
        return [
            {"cycle": float(long), "middle": float(long * at), "share": share}
            for long in np.geomspace(2.0 * self.period_s, longest, INTERVALS)
            for at in np.linspace(0.0, 1.0, 16, endpoint=False)
            for share in (0.15, 0.25, 0.33, 0.4, 0.5, 0.67)
        ]


# Parts of formulas, and parameters that several kinds have.
AWAY = "hypot(x_m - at_x, y_m - at_y)"
BEYOND = "x_m * cos(way) + y_m * sin(way) - offset"
LATER = "(time_s > at)"
BETWEEN = "(cos(6.283185307 * (time_s - middle) / cycle) > cos(3.141592654 * share))"
SINE, COSINE = (f"{part}(6.283185307 * time_s / cycle)" for part in ("sin", "cos"))
FORCE: Strength = ("N", -0.05, 0.05, 1e-3)
SPEED: Strength = ("m/s", -0.1, 0.1, 2e-3)
SIZE: Numbers = {"size": ("m", 0.02, 1.0, 0.02)}


def kinds_of(robot: Robot, swims: Sequence[Segments]) -> list[Kind]:
    """The grammar: all kinds of laws that are screened for a robot's runs."""
    space, limbs = Space.of(robot, swims), [limb.name for limb in robot.limbs]
    strokes = [kind for limb in [*limbs, "all"] for kind in _strokes(space, limb)]
    return [*_wrenches(space), *_flows(space), *_fixes(space), *strokes, *_in_pairs(limbs)]


def _both(title: str, on: str, key: str, by: str, size: Strength, *shape: Any) -> Kind:
    """The same formula along both axes of the pool, with a strength for each."""
    formulas = {f"{axis}_{key}": f"to_{axis} * {by}" for axis in "xy"}
    return Kind(title, {"on": on, **formulas}, {f"to_{axis}": size for axis in "xy"}, *shape)


def _swinging(title: str, on: str, key: str, strength: Strength, space: Space) -> Kind:
    """An oscillation along both axes of the pool, each with its own phase."""
    formulas = {f"{axis}_{key}": f"{axis}_sine * {SINE} + {axis}_cosine * {COSINE}" for axis in "xy"}
    strengths = {f"{axis}_{part}": strength for axis in "xy" for part in ("sine", "cosine")}
    return Kind(title, {"on": on, **formulas}, strengths, space.cycle, space.cycles)


def _drags(title: str, by: str, *shape: Any) -> Kind:
    """A drag against the motion and proportional to it, times a formula of the place or the time, if any."""
    times = f"-drag * {by}" if by else "-drag"
    formulas = {f"{axis}_n": f"{times} * {axis}_mps" for axis in ("forward", "left")}
    return Kind(title, {"on": "wrench", **formulas}, {"drag": ("N s/m", -10.0, 10.0, 0.1)}, *shape)


def _wrenches(space: Space) -> list[Kind]:
    """Forces and torques on the body."""
    here = f"max(0, {AWAY} - slack)"
    stiff: Numbers = {"stiffness": ("N/m", -2.0, 2.0, 0.02)}
    return [
        Kind(
            "spring",
            {"on": "wrench", **{f"{a}_n": f"-stiffness * {here} * ({a}_m - at_{a}) / {AWAY}" for a in "xy"}},
            stiff, {**space.where, "slack": ("m", 0.0, 2.0, PLACE_STEP_M)},
            [{**place, "slack": slack} for place in space.places for slack in (0.0, 0.1, 0.2, 0.35)],
        ),
        Kind(
            "attraction",
            {
                "on": "wrench",
                **{
                    f"{a}_n": f"-pull * near ** 2 * ({a}_m - at_{a}) / hypot({AWAY}, near) ** 3" for a in "xy"
                },
            },
            {"pull": ("N", -0.5, 0.5, 2e-3)}, {**space.where, "near": ("m", 0.01, 1.0, 0.02)},
            [{**place, "near": near} for place in space.places for near in (0.05, 0.12, 0.3)],
        ),
        Kind(
            "push beyond a line",
            {
                "on": "wrench",
                "x_n": f"-stiffness * max(0, {BEYOND}) * cos(way)",
                "y_n": f"-stiffness * max(0, {BEYOND}) * sin(way)",
            },
            stiff, space.line, space.lines,
        ),
        _both("push", "wrench", "n", "1", FORCE),
        Kind(
            "push that grows with place",
            {"on": "wrench", **{f"{a}_n": f"{a}_here + {a}_by_x * x_m + {a}_by_y * y_m" for a in "xy"}},
            {
                **{f"{a}_here": FORCE for a in "xy"},
                **{f"{a}_by_{b}": ("N/m", -0.2, 0.2, 2e-3) for a in "xy" for b in "xy"},
            },
        ),
        _drags(
            "patch", f"exp(-({AWAY} / size) ** sharp)",
            {**space.where, **SIZE, "sharp": ("1", 1.0, 20.0, 0.5)},
            [
                {**place, "size": size, "sharp": sharp}
                for place in space.places for size in (0.06, 0.1, 0.16, 0.25, 0.4) for sharp in (2.0, 8.0)
            ],
        ),
        _drags(
            "patch with an end", f"cos(1.5707963 * min(1, {AWAY} / size)) ** sharp",
            {**space.where, **SIZE, "sharp": ("1", 0.3, 8.0, 0.2)},
            [
                {**place, "size": size, "sharp": sharp}
                for place in space.places for size in (0.1, 0.16, 0.25, 0.4) for sharp in (0.5, 1.5)
            ],
        ),
        _drags(
            "drag beyond a line", f"(1 + tanh(({BEYOND}) / edge)) / 2",
            {**space.line, "edge": ("m", 0.005, 1.0, 0.02)},
            [{**each, "edge": edge} for each in space.lines for edge in (0.02, 0.15)],
        ),
        # The same with the line or the patch around all of the runs, which no table could contain.
        _drags("drag by speed", ""),
        Kind(
            "drag power",
            {
                "on": "wrench",
                **{
                    f"{axis}_n": f"-{axis}_drag * (hypot(forward_mps, left_mps) / speed) ** power "
                    f"* {axis}_mps / hypot(forward_mps, left_mps)"
                    for axis in ("forward", "left")
                },
            },
            {f"{axis}_drag": ("N", -0.05, 0.05, 1e-3) for axis in ("forward", "left")},
            {"power": ("1", 0.0, 5.0, 0.1), "speed": ("m/s", 0.03, 0.0301, 0.0)},
            [{"power": power, "speed": 0.03} for power in (0.0, 0.25, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0)],
        ),
        Kind(
            "compass",
            {"on": "wrench", "torque_nm": "east * sin(heading_rad) + north * cos(heading_rad)"},
            {"east": ("N m", -2e-3, 2e-3, 2e-5), "north": ("N m", -2e-3, 2e-3, 2e-5)},
        ),
        _swinging("gusts", "wrench", "n", FORCE, space),
        _both("push from a moment on", "wrench", "n", LATER, FORCE, space.when, space.whens),
        _both("push by time", "wrench", "n", "time_s", ("N/s", -2e-3, 2e-3, 2e-5)),
        _drags("drag from a moment on", LATER, space.when, space.whens),
        Kind(
            "torque by speed",
            {"on": "wrench", "torque_nm": "by_forward * forward_mps + by_left * left_mps"},
            {f"by_{axis}": ("N s", -0.02, 0.02, 2e-4) for axis in ("forward", "left")},
        ),
        _both("push at intervals", "wrench", "n", BETWEEN, FORCE, space.interval, space.intervals),
    ]  # fmt: skip


def _flows(space: Space) -> list[Kind]:
    """Motion of the water."""
    return [
        _swinging("sloshing", "flow", "mps", SPEED, space),
        Kind(
            "flow that grows with place",
            {"on": "flow", **{f"{a}_mps": f"{a}_by_x * x_m + {a}_by_y * y_m" for a in "xy"}},
            {f"{a}_by_{b}": ("1/s", -0.2, 0.2, 0.01) for a in "xy" for b in "xy"},
        ),
        _both(
            "flow that dies down", "flow", "mps", "exp(-time_s / fade)", SPEED,
            {"fade": ("s", 1.0, 200.0, 1.0)}, [{"fade": fade} for fade in (4.0, 10.0, 25.0)],
        ),
        _both("flow by time", "flow", "mps", "time_s", ("m/s^2", -5e-3, 5e-3, 1e-4)),
        _both(
            "flow in a band", "flow", "mps", f"exp(-(({BEYOND}) / width) ** 2)", SPEED,
            {**space.line, "width": ("m", 0.02, 1.0, 0.02)},
            [{**each, "width": width} for each in space.lines for width in (0.06, 0.15)],
        ),
        _both(
            "flow near a place", "flow", "mps", f"exp(-({AWAY} / size) ** 2)", SPEED, {**space.where, **SIZE},
            [{**place, "size": size} for place in space.places for size in (0.08, 0.16, 0.3)],
        ),
        _both("flow from a moment on", "flow", "mps", LATER, SPEED, space.when, space.whens),
        _both("flow at intervals", "flow", "mps", BETWEEN, SPEED, space.interval, space.intervals),
    ]  # fmt: skip


def _fixes(space: Space) -> list[Kind]:
    """Errors of the position fixes."""
    off: Strength = ("m", -0.05, 0.05, 1e-3)
    late: Numbers = {"late": ("s", -0.5, 0.5, 0.02)}
    return [
        _both("fixes off from a moment on", "fix", "m", LATER, off, space.when, space.whens),
        _both("fixes off at intervals", "fix", "m", BETWEEN, off, space.interval, space.intervals),
        Kind(
            "fixes late from a moment on", {"on": "fix", "delay_s": f"late * {LATER}"}, late, space.when,
            space.whens,
        ),
        Kind(
            "fixes late at intervals", {"on": "fix", "delay_s": f"late * {BETWEEN}"}, late, space.interval,
            space.intervals,
        ),
        Kind(
            "fixes bent by place",
            {"on": "fix", **{f"{axis}_m": f"bend * {axis}_m * (x_m ** 2 + y_m ** 2)" for axis in "xy"}},
            {"bend": ("1/m^2", -1.0, 1.0, 0.02)},
        ),
    ]  # fmt: skip


SHARE: Strength = ("1", -1.0, 1.0, 0.1)


def _strokes(space: Space, limb: str) -> list[Kind]:
    """Strokes of a limb, or of all of them, that are weaker or stronger."""
    stroke = partial(_stroke, limb)
    return [
        stroke(
            "by heading", "1 + here + east * cos(heading_rad) + north * sin(heading_rad)",
            {"here": SHARE, "east": SHARE, "north": SHARE},
        ),
        stroke("from a moment on", "1 - loss * (time_s > at)", {"loss": SHARE}, space.when, space.whens),
        stroke(
            "in rhythm", f"1 + here + in_sine * {SINE} + in_cosine * {COSINE}",
            {"here": SHARE, "in_sine": SHARE, "in_cosine": SHARE}, space.cycle, space.cycles,
        ),
        stroke("by time", "1 - rate * time_s", {"rate": ("1/s", -0.05, 0.05, 0.002)}),
        stroke(
            "by place", "1 + by_x * x_m + by_y * y_m",
            {"by_x": ("1/m", -3.0, 3.0, 0.2), "by_y": ("1/m", -3.0, 3.0, 0.2)},
        ),
        stroke(
            "by twice the heading",
            "1 + here + east * cos(2 * heading_rad) + north * sin(2 * heading_rad)",
            {"here": SHARE, "east": SHARE, "north": SHARE},
        ),
        stroke(
            "tires", "1 - loss * (1 - exp(-strokes / fade))", {"loss": SHARE},
            {"fade": ("1", 1.0, 300.0, 1.0)}, [{"fade": fade} for fade in (4.0, 12.0, 40.0)],
        ),
        stroke(
            "settles", "1 + more * exp(-strokes / fade)", {"more": SHARE},
            {"fade": ("1", 1.0, 300.0, 1.0)}, [{"fade": fade} for fade in (4.0, 12.0, 40.0)],
        ),
        stroke(
            "after a rest", "1 - loss * exp(-since_s / fade)", {"loss": SHARE},
            {"fade": ("s", 0.3, 60.0, 0.1)}, [{"fade": fade} for fade in (0.7, 1.5, 3.0, 6.0, 12.0)],
        ),
        stroke("by turning", "1 + by_turn * turn_radps", {"by_turn": ("s/rad", -3.0, 3.0, 0.1)}),
        stroke("by speed", "1 + by_speed * forward_mps", {"by_speed": ("s/m", -20.0, 20.0, 1.0)}),
    ]  # fmt: skip


def _in_pairs(limbs: Sequence[str]) -> list[Kind]:
    """Strokes that are weaker just after those of another limb."""
    return [
        _stroke(
            limb, f"after {other}", f"1 - loss * (since_{other}_s < within)", {"loss": SHARE},
            {"within": ("s", 0.01, 3.0, 0.02)}, [{"within": within} for within in (0.03, 0.2)],
        )
        for limb, other in product(limbs, limbs) if limb != other
    ]  # fmt: skip


def _stroke(limb: str, title: str, gain: str, strengths: Numbers, *shapes: Any) -> Kind:
    return Kind(f"stroke {title}", {"on": "stroke", "limb": limb, "gain": gain}, strengths, *shapes)
