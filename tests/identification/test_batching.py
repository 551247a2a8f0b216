"""Identifications that run concurrently: each has the result that it would have alone."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made import make_swim, robot
from tests.conftest import from_ci, some

from frogkick.core.errors import InputError
from frogkick.effects import Effect, Fix, History, Stroke, make_effects
from frogkick.identification import batching, predict
from frogkick.identification.batching import all_of, cpu_s, run_concurrently
from frogkick.identification.filter import Noise
from frogkick.identification.fit import LEG_S, Model, rollouts_of
from frogkick.identification.predict import Lane, Rollout
from frogkick.identification.segments import Segments
from frogkick.identification.terms import catalogue

NOISE = Noise((2e-4, 3.5e-3), (1e-4, 1e-3), (1e-4, 1e-3))


@pytest.fixture(scope="module")
def swim() -> Segments:
    return make_swim([{"name": "limb_wear", "limb": "rear_left", "gain": 0.7}], 1, 4)


def worn(gain: float) -> Model:
    term = next(each for each in catalogue(robot()) if each.title == "limb_wear rear_left")
    return Model(robot(), (term.at((gain, 0.0, 1.0)),), NOISE)


def twice(swim: Segments, gain: float) -> list[Rollout]:
    """Two rounds of simulations; the second depends on the result of the first."""
    ((first,),) = rollouts_of([worn(gain)], [swim])
    lag = 0.01 * float(np.nanmean(np.abs(first.residuals[:, 0])))
    ((second,),) = rollouts_of([worn(gain + lag)], [swim])
    return [first, second]


def test_what_goes_at_once_is_what_would_go_alone(swim: Segments, monkeypatch: pytest.MonkeyPatch) -> None:
    gains, request = (0.6, 0.7, 0.8), list[int]()

    def counted(lanes: list[Lane]) -> list[Rollout]:
        request.append(len(lanes))
        return roll_out(lanes)

    roll_out = predict.roll_out
    monkeypatch.setattr(predict, "roll_out", counted)
    found = dict(run_concurrently([partial(twice, swim, gain) for gain in gains]))
    assert request == [3, 3], "all that wait are followed together"
    monkeypatch.undo()
    for index, gain in enumerate(gains):
        for together, alone in zip(found[index], twice(swim, gain), strict=True):
            assert np.array_equal(together.residuals, alone.residuals, equal_nan=True)
            assert np.array_equal(together.difference, alone.difference)


@from_ci
@pytest.mark.parametrize(
    "effect",
    some(
        [
            {"name": "steady_current", "x_mps": 0.008, "y_mps": -0.004},
            {"name": "vortex", "circulation_m2ps": 0.005, "x_m": 0.1, "y_m": 0.0, "core_m": 0.15},
            {"name": "wall", "side": "y_low", "at_m": 0.3, "drag_ns_per_m": 1.0, "hardness": 0.6},
        ],
        1,
    ),
    ids=lambda effect: str(effect["name"]),
)
def test_who_swims_beside_a_lane_makes_no_difference(
    effect: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """More lanes than a batch is wide: some begin while others are in the middle of their runs."""
    # Of 3 pieces a lane that comes in late at a wall differs in its last bits (1e-12 m), of 5 it does not.
    swimmer, true = robot(side=6, limb=5), tuple(make_effects([effect], Path()))
    monkeypatch.setattr("made.robot", lambda: swimmer)
    swims = [make_swim([effect], seed, 3 + seed) for seed in range(3)]
    lanes = [Lane(swim, swimmer, true, NOISE, LEG_S) for swim in swims]
    for lane, together in zip(lanes * 4, predict.roll_out(lanes * 4), strict=True):
        (alone,) = predict.roll_out([lane])
        assert np.isfinite(alone.predicted).any()
        assert np.array_equal(together.predicted, alone.predicted, equal_nan=True)
        assert np.array_equal(together.difference, alone.difference)


class Flickering(Effect):
    """An effect of a user who draws random numbers and has no ``likeliest``."""

    def stroke(self, stroke: Stroke, history: History, rng: np.random.Generator) -> Stroke:
        stroke.gain *= 0.6 + 0.4 * float(rng.random())
        return stroke

    def fix(self, fix: Fix, rng: np.random.Generator) -> Fix:
        fix.x_m += 1e-3 * float(rng.normal())
        return fix


def test_each_lane_draws_its_own_random_numbers(swim: Segments) -> None:
    lane = Lane(swim, robot(), (Flickering(),), NOISE, LEG_S)
    (alone,) = predict.roll_out([lane])
    for together in predict.roll_out([lane] * 2):
        assert np.array_equal(together.predicted, alone.predicted, equal_nan=True)


LAW = {
    "name": "law",
    "on": "wrench",
    "forward_n": "push * x_m / far",
    "parameters": {
        "push": {"value": 1e-3, "unit": "N", "low": -0.1, "high": 0.1},
        "far": {"value": 1.0, "unit": "m", "low": 0.5, "high": 2.0},
    },
}


@from_ci
@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere one process does it all")
def test_parts_on_several_processors_are_what_one_would_make(
    swim: Segments, monkeypatch: pytest.MonkeyPatch
) -> None:
    """More lanes than a batch is wide, of two bodies, one of them with a formula, which cannot be pickled."""
    heavy = {"name": "mass_scale", "frame": 1.3}
    worlds = [[], [heavy], [LAW]] + [[{"name": "steady_current", "x_mps": 1e-3 * k}] for k in range(8)]
    lanes = [Lane(swim, robot(), tuple(make_effects(world, Path())), NOISE, LEG_S) for world in worlds]
    here = predict.roll_out(lanes)
    processes = set[int]()
    whole = batching.run_chunks

    def counted(*args: Any) -> Iterator[Any]:
        for part in whole(*args):
            processes.add(part[0])
            yield part

    monkeypatch.setattr(batching, "_processors", lambda: 3)
    monkeypatch.setattr(batching, "run_chunks", counted)
    there = batching.roll_out(lanes)
    assert processes == {0, 1, 2}
    for one, other in zip(here, there, strict=True):
        assert np.isfinite(one.predicted).any()
        assert np.array_equal(one.residuals, other.residuals, equal_nan=True)
        assert np.array_equal(one.difference, other.difference)


def test_effects_of_the_robot_s_own_file_are_part_of_its_predictions(swim: Segments) -> None:
    own = replace(robot(), effects=({"name": "limb_wear", "limb": "rear_left", "gain": 0.7},))
    ((found,), (wanted,), (plain,)) = rollouts_of(
        [Model(own, (), NOISE), worn(0.7), Model(robot(), (), NOISE)], [swim]
    )
    assert np.array_equal(found.residuals, wanted.residuals, equal_nan=True)
    assert not np.array_equal(found.residuals, plain.residuals, equal_nan=True)


def test_work_that_waits_for_a_thread_is_done_too(swim: Segments) -> None:
    def once(gain: float) -> float:
        ((rollout,),) = rollouts_of([worn(gain)], [swim])
        return float(np.nansum(rollout.residuals))

    gains = (0.5, 0.6, 0.7, 0.8, 0.9)
    found = sorted(run_concurrently([partial(once, gain) for gain in gains], threads_max=2))
    assert [index for index, _ in found] == [0, 1, 2, 3, 4]
    assert len({residuals for _, residuals in found}) == len(gains)


def test_a_thread_may_run_others(swim: Segments, monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent fits within identifications that run concurrently."""
    request = list[int]()

    def counted(lanes: list[Lane]) -> list[Rollout]:
        request.append(len(lanes))
        return roll_out(lanes)

    roll_out = predict.roll_out
    monkeypatch.setattr(predict, "roll_out", counted)

    def pair(gain: float) -> list[list[Rollout]]:
        begun_s = cpu_s()
        found = all_of([partial(twice, swim, gain), partial(twice, swim, gain + 0.1)])
        assert cpu_s() > begun_s, "what the inner threads spent counts"
        return found

    found = dict(run_concurrently([partial(pair, gain) for gain in (0.6, 0.8)]))
    assert request == [4, 4], "all that wait are followed together"
    monkeypatch.undo()
    for index, gain in enumerate((0.6, 0.8)):
        for inner, more in enumerate((0.0, 0.1)):
            for together, alone in zip(found[index][inner], twice(swim, gain + more), strict=True):
                assert np.array_equal(together.residuals, alone.residuals, equal_nan=True)


def test_what_a_piece_raises_is_raised_and_ends_the_others(swim: Segments) -> None:
    def fails() -> None:
        raise InputError("no such run")

    def goes_on() -> None:
        while True:
            rollouts_of(
                [worn(0.7)], [replace(swim, **{k: getattr(swim, k)[:1] for k in ("start_s", "end_s")})]
            )

    work: list[Callable[[], None]] = [goes_on, fails]
    with pytest.raises(InputError, match="no such run"):
        list(run_concurrently(work))


def test_simulations_for_several_are_shared_out(swim: Segments) -> None:
    def measured(models: list[Model]) -> float:
        begun_s = cpu_s()
        rollouts_of(models, [swim])
        return cpu_s() - begun_s

    found = dict(run_concurrently([partial(measured, [worn(0.7)]), partial(measured, [worn(0.7)] * 3)]))
    assert found[1] > 2.0 * found[0] > 0.0
