"""Laws that the catalogue lacks are screened by linear responses, and the right kind is found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made import make_swim, robot
from tests.conftest import FULL, count, from_ci, some

from frogkick.effects import Law
from frogkick.effects.registry import make_effects
from frogkick.identification.choice import _law_of_no_strength
from frogkick.identification.diagnostics import fix_innovations, missing_wrench, stroke_ratios
from frogkick.identification.fit import derivatives, fit
from frogkick.identification.law_kinds import kinds_of
from frogkick.identification.laws import Laws, centred, moment_intervals
from frogkick.identification.outcome import found_toml, identify
from frogkick.identification.refine import refined
from frogkick.identification.responses import responses_of
from frogkick.identification.screening import bent_gain
from frogkick.identification.search import (
    HELD_OUT_GAIN_MIN,
    Found,
    _ForwardSelection,
    nominal_fit,
)
from frogkick.identification.verdict import FOUND_LAW
from frogkick.robot.load import parse_robot

OWN = """
import math


class Cable:
    def __init__(self, stiffness, x, y, slack):
        self.stiffness, self.x, self.y, self.slack = stiffness, x, y, slack

    def wrench(self, time_s, body):
        px, py, heading = body.pose_world
        dx, dy = px - self.x, py - self.y
        away = math.hypot(dx, dy)
        pull = -self.stiffness * max(0.0, away - self.slack) / max(away, 1e-9)
        c, s = math.cos(heading), math.sin(heading)
        return pull * (c * dx + s * dy), pull * (c * dy - s * dx), 0.0


class Sloshing:
    def __init__(self, speed, cycle, way):
        self.speed, self.cycle, self.way = speed, cycle, way

    def flow(self, time_s, position_world_m):
        speed = self.speed * math.sin(math.tau * time_s / self.cycle + 1.0)
        return speed * math.cos(self.way), speed * math.sin(self.way)


class Breaks:
    def __init__(self, limb, at, gain):
        self.limb, self.at, self.gain = limb, at, gain

    def stroke(self, stroke, history, rng):
        if stroke.limb == self.limb and stroke.time_s > self.at:
            stroke.gain *= self.gain


class Weeds:
    def __init__(self, drag, x, y, radius):
        self.drag, self.x, self.y, self.radius = drag, x, y, radius

    def wrench(self, time_s, body):
        x, y, _ = body.pose_world
        forward, left, _ = body.velocity_body
        drag = self.drag if math.hypot(x - self.x, y - self.y) < self.radius else 0.0
        return -drag * forward, -drag * left, 0.0


class DragByPower:
    def __init__(self, force, power):
        self.force, self.power = force, power

    def wrench(self, time_s, body):
        forward, left, _ = body.velocity_body
        speed = max(math.hypot(forward, left), 1e-9)
        force = self.force * (speed / 0.03) ** self.power / speed
        return -force * forward, -force * left, 0.0


class Lags:
    def __init__(self, late, cycle, share):
        self.late, self.cycle, self.share = late, cycle, share

    def fix(self, fix, rng):
        if fix.capture_s % self.cycle < self.share * self.cycle:
            fix.capture_s += self.late
            fix.delay_s -= self.late
        return fix


class Moves:
    def __init__(self, x, y, cycle, share):
        self.x, self.y, self.cycle, self.share = x, y, cycle, share

    def fix(self, fix, rng):
        if fix.capture_s % self.cycle < self.share * self.cycle:
            fix.x_m += self.x
            fix.y_m += self.y
        return fix


class Settles:
    def __init__(self, limb, more, fade):
        self.limb, self.more, self.fade = limb, more, fade

    def stroke(self, stroke, history, rng):
        if stroke.limb == self.limb:
            stroke.gain *= 1.0 + self.more * math.exp(-stroke.time_s / self.fade)
        return stroke


class ByHeading:
    def __init__(self, depth):
        self.depth, self.heading = depth, 0.0

    def wrench(self, time_s, body):
        self.heading = body.pose_world[2]
        return 0.0, 0.0, 0.0

    def stroke(self, stroke, history, rng):
        stroke.gain *= 1.0 - self.depth * 0.5 * (1.0 + math.cos(self.heading - 0.7))
"""

WORLDS: list[tuple[str, dict[str, Any]]] = [
    ("spring", {"class": "Cable", "stiffness": 0.1, "x": 0.1, "y": 0.2, "slack": 0.15}),
    ("sloshing", {"class": "Sloshing", "speed": 0.012, "cycle": 7.3, "way": 0.6}),
    ("stroke from a moment on rear_left", {"class": "Breaks", "limb": "rear_left", "at": 12.0, "gain": 0.3}),
    ("stroke by heading all", {"class": "ByHeading", "depth": 0.5}),
    ("patch", {"class": "Weeds", "drag": 1.0, "x": -0.1, "y": 0.2, "radius": 0.2}),
    ("drag power", {"class": "DragByPower", "force": 0.006, "power": 0.4}),
    ("drag by speed", {"class": "DragByPower", "force": 0.0004, "power": 1.0}),
    ("fixes late at intervals", {"class": "Lags", "late": 0.15, "cycle": 7.0, "share": 0.35}),
    ("fixes off at intervals", {"class": "Moves", "x": 0.006, "y": -0.004, "cycle": 8.0, "share": 0.4}),
    ("stroke settles rear_left", {"class": "Settles", "limb": "rear_left", "more": 0.35, "fade": 8.0}),
]
PERIODS = 18


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("laws")
    (place / "own.py").write_text(OWN)
    return place


def planted(folder: Path, table: dict[str, Any]) -> list[dict[str, Any]]:
    return [{"file": str(folder / "own.py"), **table}]


@from_ci
@pytest.mark.parametrize(("title", "table"), some(WORLDS, 1, 5))
def test_the_right_kind_promises_most(folder: Path, title: str, table: dict[str, Any]) -> None:
    seeds, periods = range(1, 4), PERIODS
    swims = [make_swim(planted(folder, table), seed, periods) for seed in seeds]
    data, nominal = nominal_fit(swims, robot())
    laws = Laws(responses_of(nominal, data), swims, robot())
    columns = laws.best(nominal)
    alike = {"patch": ("patch", "patch with an end")}.get(title, (title,))
    assert columns[0].term.title in alike, [column.term.title for column in columns[:4]]
    assert len(laws.every) > 300
    values = dict(zip((p.name for p in columns[0].term.parameters), columns[0].term.values, strict=True))
    if "cycle" in values:
        assert values["cycle"] == pytest.approx(table["cycle"], abs=0.5)
    if "at" in values:
        assert values["at"] == pytest.approx(12.0, abs=3.0)


TRUE_CABLE = {"stiffness": 0.1, "at_x": 0.1, "at_y": 0.2, "slack": 0.15}
MISPLACED: list[tuple[float, dict[str, float], dict[str, float]]] = [
    (
        0.1 if FULL else 0.4,
        {"stiffness": 0.02, "at_x": -0.4, "at_y": 0.5, "slack": 0.0},
        {"loss": 0.7, "at": 12.0},
    ),
    (0.1, {**TRUE_CABLE, "at_x": 0.12}, {"loss": 0.7, "at": 20.5}),
]
"""True stiffness (N/m), places. A robot of few pieces has the far minimum beside a stiff cable."""


@from_ci
@pytest.mark.parametrize(("stiffness", "cable", "moment"), some(MISPLACED, 1, 1))
def test_laws_are_moved_beside_each_other(
    folder: Path, stiffness: float, cable: dict[str, float], moment: dict[str, float]
) -> None:
    """A cable placed without the broken limb, and a moment chosen beside a misplaced cable.

    A fit stays in its local minimum. A new screening leaves it, or the simulation of every moment.
    """
    world = planted(folder, {**WORLDS[0][1], "stiffness": stiffness}) + planted(folder, WORLDS[2][1])
    swims = [make_swim(world, seed, 20) for seed in (1, 2)]
    data, nominal = nominal_fit(swims, robot())
    laws = Laws(responses_of(nominal, data), swims, robot())
    kinds = {kind.named: kind for kind in kinds_of(robot(), swims)}
    pulls, breaks = kinds["spring"].term(cable), kinds["stroke from a moment on rear_left"].term(moment)
    placed = refined(fit(replace(nominal.model, terms=(pulls, breaks)), data), data)
    selection = _ForwardSelection(data, [], laws)
    reported: list[str] = []
    moved = selection.relocated(placed, reported.append)
    assert moved.deviance < placed.deviance - 100.0 and reported[0].startswith("moving spring")
    assert [each.title for each in moved.model.terms] == [pulls.title, breaks.title]
    values = {
        name: value
        for each in moved.model.terms
        for name, value in zip((p.name for p in each.parameters), each.values, strict=True)
    }
    for name in ("at_x", "at_y", "slack"):
        assert values[name] == pytest.approx(TRUE_CABLE[name], abs=0.03), values
    assert values["at"] == pytest.approx(12.0, abs=1.5), values


@from_ci
def test_a_moment_between_two_strokes_is_told_as_the_gap(folder: Path) -> None:
    swims = [make_swim(planted(folder, WORLDS[2][1]), seed, PERIODS) for seed in (1, 2)]
    data, nominal = nominal_fit(swims, robot())
    kinds = {kind.named: kind for kind in kinds_of(robot(), swims)}
    limb = [each.name for each in robot().limbs].index("rear_left")
    own = sorted(at for swim in swims for at, number in swim.strokes if number == limb)
    low, high = max(at for at in own if at < 12.0), min(at for at in own if at > 12.0)
    term = kinds["stroke from a moment on rear_left"].term({"loss": 0.7, "at": low + 0.1 * (high - low)})
    (fitted,) = derivatives([replace(nominal.model, terms=(term,))], data)
    middle = centred(fitted, data)
    assert middle.deviance == pytest.approx(fitted.deviance, abs=1e-6)
    assert middle.model.terms[0].values == pytest.approx((0.7, 0.5 * (low + high)))
    first, last = moment_intervals(middle, data)[0]
    assert first <= low and last >= high
    with_high = [any(at == high for at, _ in swim.strokes) for swim in swims]
    parts = [(swim.end_s <= high) | (not last) for swim, last in zip(swims, with_high, strict=True)]
    cut = replace(data, rows=data.rows & np.concatenate(parts))  # as where a run ends with that stroke
    (fitted,) = derivatives([replace(nominal.model, terms=(term,))], cut)
    other = swims[with_high.index(False)].strokes
    after = min(at for at, number in other if number == limb and at > high)
    _, moment = centred(fitted, cut).model.terms[0].values
    assert moment == pytest.approx(0.5 * (low + after))
    push = kinds["push from a moment on"].term({"at": 12.0})
    (pushed,) = derivatives([replace(nominal.model, terms=(push,))], data)
    assert centred(pushed, data) is pushed
    assert moment_intervals(pushed, data) == {}


@from_ci
@pytest.mark.parametrize("taut", [True, False])
def test_what_bends_is_held_against_folds_by_simulation(folder: Path, taut: bool) -> None:
    """A cable near its place: derivatives at the edge of its pull do not predict a fit without a fold."""
    swims = [make_swim(planted(folder, WORLDS[0][1]) if taut else [], seed, 14) for seed in (1, 2, 3, 4)]
    data, nominal = nominal_fit(swims, robot())
    kind = next(each for each in kinds_of(robot(), swims) if each.title == "spring")
    near = kind.term({"stiffness": 0.08 if taut else 0.001, "at_x": 0.13, "at_y": 0.17, "slack": 0.13})
    (start,) = derivatives([replace(nominal.model, terms=(near,))], data)
    fitted, (gain, error) = bent_gain(nominal, start, data)
    assert fitted.deviance <= start.deviance and error > 0.0
    assert (gain > max(HELD_OUT_GAIN_MIN, error)) == taut


@from_ci
def test_a_law_that_may_have_no_strength_is_left_out(folder: Path) -> None:
    swims = [make_swim(planted(folder, WORLDS[1][1]), seed, 16) for seed in (1, 2)]
    data, nominal = nominal_fit(swims, robot())
    kinds = {kind.named: kind for kind in kinds_of(robot(), swims)}
    sloshing = kinds["sloshing"].term(dict.fromkeys(kinds["sloshing"].strengths, 0.005) | {"cycle": 7.3})
    compass = kinds["compass"].term({"east": 0.0, "north": 0.0})
    places = []
    for terms in ((sloshing, compass), (compass, sloshing), (sloshing,)):
        fitted = fit(replace(nominal.model, terms=terms), data)
        found = Found(
            data, nominal, derivatives([fitted.model], data)[0], confounded_with=[[] for _ in terms]
        )
        places.append(_law_of_no_strength(found))
    assert places == [1, 0, None]


@from_ci
def test_answers_add_up_to_what_a_simulation_says(folder: Path) -> None:
    """A steady push as a sum over thirds of periods, a worn limb, a broken one, and late fixes."""
    from frogkick.identification.fit import Model, residuals_of, rollouts_of
    from frogkick.identification.terms import catalogue

    swims = [make_swim([], seed, 12) for seed in (1, 2)]
    data, nominal = nominal_fit(swims, robot())
    responses = responses_of(nominal, data)
    terms = {term.title: term for term in catalogue(robot())}
    push = terms["steady_wrench"].at([1e-3, 0.0, 0.0])
    late = terms["fix_latency"].at([0.05])
    weak, broken = (terms["limb_wear rear_left"].at([gain, 0.0, 1.0]) for gain in (0.9, 0.35))
    names = [each.name for each in robot().limbs]

    def response_of(table: dict[str, Any], unit: str = "1", size: float = 1.0) -> Any:
        parameters = {"size": {"value": size, "unit": unit}}
        (law,) = make_effects([{"name": "law", "parameters": parameters, **table}], Path())
        assert isinstance(law, Law)
        return responses.to(law, {}, names)

    for term, reported in (
        (push, response_of({"on": "wrench", "forward_n": "size"}, "N", 1e-3)),
        (weak, response_of({"on": "stroke", "limb": "rear_left", "gain": "size"}, "1", 0.9)),
        (broken, response_of({"on": "stroke", "limb": "rear_left", "gain": "size"}, "1", 0.35)),
        (late, response_of({"on": "fix", "delay_s": "size"}, "s", 0.05)),
    ):
        moved = Model(robot(), (term,), nominal.model.noise)
        true = residuals_of(rollouts_of([moved], swims)[0], data.rows) - nominal.residuals
        assert np.linalg.norm(reported - true) < 0.25 * np.linalg.norm(true), term.title


def test_every_kind_is_a_law_that_a_robot_s_file_can_have() -> None:
    swims = [make_swim([], 1, 8)]
    kinds = kinds_of(robot(), swims)
    assert len({(kind.title, kind.table.get("limb")) for kind in kinds}) == len(kinds)
    assert len(kinds) == 97, "explanation/identification.md says so"
    for kind in kinds:
        term = kind.term(kind.grid[0])
        term.effect().check(robot())
        assert all(p.unit and p.low < p.high for p in term.parameters)
        if "at" in kind.shapes:
            assert kind.shapes["at"][1] == pytest.approx(2.0 * robot().period_s), "not from the beginning on"
        strengths = [p for p in term.parameters if p.name in kind.strengths]
        assert all(
            value == 0.0 for p, value in zip(term.parameters, term.values, strict=True) if p in strengths
        )


@from_ci
def test_a_cable_is_found_and_swims_from_the_file_that_is_written(folder: Path) -> None:
    table = planted(folder, WORLDS[0][1])
    swims = [make_swim(table, seed, count(20, 30)) for seed in (1, 2, 3, 4)]
    outcome = identify(swims[:3], swims[3:], robot(), laws=True)
    assert outcome.verdict == FOUND_LAW
    (effect,) = outcome.as_json()["effects"]
    assert effect["title"] == "spring" and effect["law"]["on"] == "wrench" and "hypot" in effect["law"]["x_n"]
    given = {"stiffness": 0.1, "at_x": 0.1, "at_y": 0.2, "slack": 0.15}
    for name, value in given.items():
        assert effect["parameters"][name]["value"] == pytest.approx(value, abs=0.03), effect
    assert outcome.tested.after.position_rmse_m < 0.3 * outcome.tested.before.position_rmse_m
    again = parse_robot(found_toml(outcome), "found")
    assert values_of(again.effects) == pytest.approx(values_of([outcome.terms[0].effect().table]))  # type: ignore[attr-defined]


def values_of(tables: Sequence[Any]) -> list[float]:
    (law,) = make_effects(tables, Path())
    return [law.value(p.name) for p in law.parameters]


@from_ci
def test_the_missing_wrench_is_read_from_residuals() -> None:
    """A known force in the pool is estimated in each third within its covariance; also strokes and fixes."""
    numbers = {"push": {"value": 1.5e-3, "unit": "N"}, "rate": {"value": 0.7, "unit": "1/s"}}
    law = {"name": "law", "on": "wrench", "x_n": "push * sin(rate * time_s)", "parameters": numbers}
    swims = [make_swim([law], seed, 14) for seed in (1, 2)]
    data, nominal = nominal_fit(swims, robot())
    responses = responses_of(nominal, data)
    found = missing_wrench(nominal, responses, data)
    reported = found.as_json([swim.name for swim in swims])
    true = 1.5e-3 * np.sin(0.7 * found.time_s)
    assert np.corrcoef(reported["x_n"], true)[0, 1] > 0.9
    assert np.sqrt(np.mean(np.square(np.array(reported["x_n"]) - true))) < 6e-4
    assert np.abs(reported["y_n"]).mean() < 4e-4 and len(reported["covariance"][0]) == 9
    assert (np.linalg.eigvalsh(found.covariance) > -1e-12).all()
    strokes = stroke_ratios(nominal, responses, data, [limb.name for limb in robot().limbs])
    ratios = np.array([each["log_ratio"] for each in strokes])
    assert len(ratios) == sum(len(swim.strokes) for swim in swims) and np.median(ratios) > 3.0
    fixes = fix_innovations(nominal, swims)
    assert len(fixes["x"]) == len(fixes["time_s"]) > 300 and max(fixes["outliers"]) < 0.05
