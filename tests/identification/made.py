"""Runs made in the simulated pool with random actions and hidden effects."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from tests.conftest import FULL

from frogkick.effects import World, make_effects
from frogkick.identification.diagnostics import residual_diagnostics
from frogkick.identification.filter import Noise
from frogkick.identification.fit import derivatives, rollouts_of
from frogkick.identification.outcome import Outcome
from frogkick.identification.search import Found, nominal_fit
from frogkick.identification.segments import Segments, segments_of
from frogkick.identification.terms import Term, catalogue
from frogkick.identification.verdict import FOUND, intervals, scored
from frogkick.paths import wrap_angle
from frogkick.pool.pool import Camera, Pool
from frogkick.robot import Robot, load_robot, parse_robot
from frogkick.robot.toml_text import to_toml
from frogkick.runs.runlog import Decisions, Fixes, RunLog, Strokes, Truth

START_S = 1.0
WORN = {"name": "limb_wear", "limb": "rear_left", "gain": 0.7}


def term(title: str, *values: float) -> Term:
    """A candidate by its title; the first of its parameters at these values."""
    found = next(each for each in catalogue(robot()) if each.title == title)
    return found.at([*values, *found.values[len(values) :]])


def robot(name: str = "frog2022", side: int = 3, limb: int = 3) -> Robot:
    """The paper's robot with few segments, which swims much the same at a quarter of the cost.

    In make test-full it has its own segments. Tests of its swimming load it by its name instead.
    """
    return _robot(name, side, limb, not FULL)


@cache
def _robot(name: str, side: int, limb: int, is_of_few: bool) -> Robot:
    plain = load_robot(name)
    if not is_of_few:
        return plain
    table = tomllib.loads(plain.toml)
    table["frame"]["segments"] = [side] * len(table["frame"]["segments"])
    for each in table["limb"]:
        each["segments"] = limb
    return parse_robot(to_toml(table), f"{name} of few pieces")


def robot_option(folder: Path, name: str = "frog2022") -> str:
    """The same robot as an option of a command: a file, or in make test-full its name."""
    if robot(name) == load_robot(name):
        return name
    robot(name).save(folder / f"{name}.toml")
    return str(folder / f"{name}.toml")


def make_run(effects: Sequence[Mapping[str, Any]], seed: int, periods: int, row: str | None = None) -> RunLog:
    """A run of random actions, or of those that ``row`` names, in a pool where ``effects`` are true."""
    swimmer, rng = robot(), np.random.default_rng(seed)
    world = World(make_effects(effects, Path()))
    start = (float(rng.uniform(-0.5, 0.5)), float(rng.uniform(-0.5, 0.5)), float(rng.uniform(-3.0, 3.0)))
    pool = Pool(swimmer, start, Camera(), np.random.default_rng([seed, 1]), world)
    period_s = swimmer.period_s
    actions = rng.integers(0, len(swimmer.actions) - 1, periods)
    if row is not None:
        actions = np.array([[action.name for action in swimmer.actions].index(name) for name in row])
        periods = len(row)
    decided_s = START_S + period_s * np.arange(periods)
    fixes, strokes = pool.advance(START_S), []
    for at_s, index in zip(decided_s.tolist(), actions.tolist(), strict=True):
        action = swimmer.actions[index]
        for fired_s, mask in (
            (at_s, action.first_mask),
            (at_s + swimmer.second_delay_s, action.second_mask),
        ):
            if mask:
                fixes += pool.advance(fired_s)
                for limb in range(len(swimmer.limbs)):
                    if mask >> limb & 1:
                        pool.actuate(limb, fired_s)
                strokes.append((fired_s, mask))
        fixes += pool.advance(at_s + period_s - 1e-9)
    fixes += pool.advance(float(decided_s[-1]) + period_s + 0.3)
    poses = np.array([fix.pose_world for fix in fixes], dtype=np.float64)
    count = len(fixes)
    return RunLog(
        robot_id=swimmer.id,
        source="made",
        period_s=period_s,
        pulse_s=swimmer.pulse_s,
        action_names=tuple(action.name for action in swimmer.actions),
        fixes=Fixes(
            time_s=np.array([fix.arrival_s for fix in fixes]),
            capture_time_s=np.array([fix.capture_s for fix in fixes]),
            x_m=poses[:, 0],
            y_m=poses[:, 1],
            heading_rad=wrap_angle(poses[:, 2]),
            quality=np.ones(count, dtype=np.uint8),
            flags=np.zeros(count, dtype=np.uint16),
        ),
        decisions=Decisions(
            time_s=decided_s,
            action=actions,
            fix_sequence=np.full(periods, -1),
            flags=np.zeros(periods, dtype=np.uint16),
        ),
        strokes=Strokes(
            time_s=np.array([time_s for time_s, _ in strokes]),
            limb_mask=np.array([mask for _, mask in strokes]),
            pulse_s=np.full(len(strokes), swimmer.pulse_s),
        ),
        truth=Truth(
            time_s=np.array(pool.truth.time_s),
            pose_world=np.array(pool.truth.pose_world),
            velocity_body=np.array(pool.truth.velocity_body),
        ),
    )


def make_swim(
    effects: Sequence[Mapping[str, Any]], seed: int, periods: int, row: str | None = None
) -> Segments:
    return segments_of(make_run(effects, seed, periods, row), f"made{seed}", robot())


def known_outcome(
    train: Sequence[Segments], test: Sequence[Segments], title: str, values: Sequence[float]
) -> Outcome:
    """The outcome of an identification that has found this effect with these values, without the search."""
    plain = next(each for each in catalogue(robot()) if each.title == title)
    data, nominal = nominal_fit(train, robot())
    known = replace(
        nominal.model, terms=(plain.at(values),), noise=Noise((2e-4, 3.5e-3), (1e-4, 1e-3), (1e-4, 1e-3))
    )
    free = replace(
        known, fixed=frozenset(k for k, p in enumerate(plain.parameters) if values[k] == p.nominal)
    )
    (fitted,) = derivatives([free], data)
    rollouts = rollouts_of([nominal.model, known], test)
    found = Found(data, nominal, fitted, confounded_with=[[]], stability=[1.0])
    return Outcome(
        verdict=FOUND,
        robot=robot(),
        train=train,
        test=test,
        found=found,
        parameters=intervals(fitted, data),
        trained=scored(found, train, nominal.rollouts, fitted.rollouts),
        tested=scored(found, test, *rollouts),
        nominal_rollouts=rollouts[0],
        rollouts=rollouts[1],
        diagnostics=residual_diagnostics(fitted, data),
    )
