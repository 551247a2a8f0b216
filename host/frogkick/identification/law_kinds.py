"""The grammar of laws: kinds of formulas that runs are screened for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from frogkick.effects import Law
from frogkick.identification.segments import Segments
from frogkick.identification.terms import Term
from frogkick.robot import Robot

Numbers = Mapping[str, tuple[str, float, float, float]]
"""Parameter -> unit, low, high, step of a finite difference (0: a share of its range)."""


@dataclass(frozen=True, eq=False)
class Kind:
    """A kind of law: formulas whose effect is in proportion to some parameters, at shapes that are tried.

    Attributes:
        title: what reports call it.
        table: ``on``, ``limb`` and formulas.
        strengths: parameters that the effect is in proportion to; nought is none.
        shapes: the others.
        grid: values of the shapes that are tried.
    """

    title: str
    table: Mapping[str, str]
    strengths: Numbers
    shapes: Numbers
    grid: Sequence[Mapping[str, float]]

    def term(self, shape: Mapping[str, float]) -> Term:
        """The law without strength, at a shape."""
        declared: dict[str, dict[str, Any]] = {}
        for name, (unit, low, high, step) in {**self.strengths, **self.shapes}.items():
            nominal = 0.0 if name in self.strengths else low
            declared[name] = {"unit": unit, "low": low, "high": high, "nominal": nominal, "step": step}
            if name == "at":  # between two strokes any moment is the same
                declared[name]["tolerance"] = 0.5 * step
        table = {"name": "law", "title": self.title, **self.table, "parameters": declared}
        law = Law(**{key: value for key, value in table.items() if key != "name"})  # type: ignore[arg-type]
        values = tuple(float(shape.get(p.name, 0.0)) for p in law.parameters)
        return Term(tuple(table.items()), Path(), law.parameters, values)


def kinds_of(robot: Robot, swims: Sequence[Segments]) -> list[Kind]:
    """The grammar: every kind of law that is screened for a robot's runs."""
    reached = np.concatenate([swim.pose[:, :2] for swim in swims])
    low, high = reached.min(axis=0) - 0.15, reached.max(axis=0) + 0.15
    end_s = float(max(swim.end_s[-1] for swim in swims if len(swim.end_s)))
    period_s = robot.period_s
    xs, ys = np.linspace(low[0], high[0], 9), np.linspace(low[1], high[1], 9)
    places = [{"at_x": float(x), "at_y": float(y)} for x in xs for y in ys]
    where: Numbers = {
        "at_x": ("m", float(low[0]) - 1.0, float(high[0]) + 1.0, 0.02),
        "at_y": ("m", float(low[1]) - 1.0, float(high[1]) + 1.0, 0.02),
    }
    away = "hypot(x_m - at_x, y_m - at_y)"
    whens = [{"at": float(at)} for at in np.linspace(3.0 * period_s, end_s - 3.0 * period_s, 14)]
    when: Numbers = {"at": ("s", 0.0, end_s, period_s)}
    cycles = [{"cycle": float(c)} for c in np.geomspace(1.5 * period_s, max(end_s, 8.0 * period_s), 30)]
    cycle: Numbers = {"cycle": ("s", 0.5, 2.0 * end_s, 0.05)}
    sine, cosine = (f"{part}(6.283185307 * time_s / cycle)" for part in ("sin", "cos"))

    def swinging(title: str, on: str, key: str, strength: tuple[str, float, float, float]) -> Kind:
        """Along both axes of the pool, each with a phase of its own."""
        formulas = {f"{axis}_{key}": f"{axis}_sine * {sine} + {axis}_cosine * {cosine}" for axis in "xy"}
        strengths = {f"{axis}_{part}": strength for axis in "xy" for part in ("sine", "cosine")}
        return Kind(title, {"on": on, **formulas}, strengths, cycle, cycles)

    kinds = [
        Kind(
            "spring",
            {
                "on": "wrench",
                "x_n": f"-stiffness * max(0, {away} - slack) * (x_m - at_x) / {away}",
                "y_n": f"-stiffness * max(0, {away} - slack) * (y_m - at_y) / {away}",
            },
            {"stiffness": ("N/m", -2.0, 2.0, 0.02)},
            {**where, "slack": ("m", 0.0, 2.0, 0.02)},
            [{**place, "slack": slack} for place in places for slack in (0.0, 0.1, 0.2, 0.35)],
        ),
        Kind(
            "patch",
            {
                "on": "wrench",
                **{
                    f"{axis}_n": f"-drag * exp(-({away} / size) ** 2 / 2) * {axis}_mps"
                    for axis in ("forward", "left")
                },
            },
            {"drag": ("N s/m", -3.0, 3.0, 0.1)},
            {**where, "size": ("m", 0.02, 1.0, 0.02)},
            [{**place, "size": size} for place in places for size in (0.06, 0.12, 0.25)],
        ),
        Kind(
            "drag power",
            {
                "on": "wrench",
                **{
                    f"{axis}_n": f"-drag * sign({axis}_mps) * (abs({axis}_mps) / speed) ** power"
                    for axis in ("forward", "left")
                },
            },
            {"drag": ("N", -0.05, 0.05, 1e-3)},
            {"power": ("1", 0.0, 5.0, 0.1), "speed": ("m/s", 0.03, 0.0301, 0.0)},
            [{"power": power, "speed": 0.03} for power in (0.25, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0)],
        ),
        Kind(
            "compass",
            {"on": "wrench", "torque_nm": "east * sin(heading_rad) + north * cos(heading_rad)"},
            {"east": ("N m", -2e-3, 2e-3, 2e-5), "north": ("N m", -2e-3, 2e-3, 2e-5)},
            {},
            [{}],
        ),
        swinging("gusts", "wrench", "n", ("N", -0.05, 0.05, 1e-3)),
        Kind(
            "push from a moment on",
            {"on": "wrench", "x_n": "push_x * (time_s > at)", "y_n": "push_y * (time_s > at)"},
            {"push_x": ("N", -0.05, 0.05, 1e-3), "push_y": ("N", -0.05, 0.05, 1e-3)},
            when,
            whens,
        ),
        swinging("sloshing", "flow", "mps", ("m/s", -0.1, 0.1, 2e-3)),
        Kind(
            "flow that grows with place",
            {"on": "flow", **{f"{a}_mps": f"{a}_by_x * x_m + {a}_by_y * y_m" for a in ("x", "y")}},
            {f"{a}_by_{b}": ("1/s", -0.2, 0.2, 0.01) for a in ("x", "y") for b in ("x", "y")},
            {},
            [{}],
        ),
        Kind(
            "flow that dies down",
            {
                "on": "flow",
                "x_mps": "x_first * exp(-time_s / fade)",
                "y_mps": "y_first * exp(-time_s / fade)",
            },
            {"x_first": ("m/s", -0.1, 0.1, 2e-3), "y_first": ("m/s", -0.1, 0.1, 2e-3)},
            {"fade": ("s", 1.0, 200.0, 1.0)},
            [{"fade": fade} for fade in (4.0, 10.0, 25.0)],
        ),
    ]
    names = [limb.name for limb in robot.limbs]
    share = ("1", -1.0, 1.0, 0.1)
    for limb in [*names, "all"]:
        stroke = partial(_stroke, limb)
        kinds += [
            stroke(
                "by heading", "1 + east * cos(heading_rad) + north * sin(heading_rad)",
                {"east": share, "north": share},
            ),
            stroke("from a moment on", "1 - loss * (time_s > at)", {"loss": share}, when, whens),
            stroke(
                "in rhythm", f"1 + in_sine * {sine} + in_cosine * {cosine}",
                {"in_sine": share, "in_cosine": share}, cycle, cycles,
            ),
            stroke("by time", "1 - rate * time_s", {"rate": ("1/s", -0.05, 0.05, 0.002)}),
            stroke(
                "by place", "1 + by_x * x_m + by_y * y_m",
                {"by_x": ("1/m", -3.0, 3.0, 0.2), "by_y": ("1/m", -3.0, 3.0, 0.2)},
            ),
            stroke("by speed", "1 + by_speed * forward_mps", {"by_speed": ("s/m", -20.0, 20.0, 1.0)}),
        ]  # fmt: skip
    for limb, other in product(names, names):
        if limb != other:
            kinds.append(
                _stroke(
                    limb, f"after {other}", f"1 - loss * (since_{other}_s < within)", {"loss": share},
                    {"within": ("s", 0.01, 3.0, 0.02)}, [{"within": within} for within in (0.03, 0.2)],
                )
            )  # fmt: skip
    return kinds


def _stroke(
    limb: str,
    title: str,
    gain: str,
    strengths: Numbers,
    shapes: Numbers | None = None,
    grid: Sequence[Mapping[str, float]] = ({},),
) -> Kind:
    table = {"on": "stroke", "limb": limb, "gain": gain}
    return Kind(f"stroke {title}", table, strengths, shapes or {}, grid)
