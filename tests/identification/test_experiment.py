"""What to record next: sequences that discriminate two models in the pool, and pairs that none does."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from made import make_swim, robot, term
from tests.conftest import from_ci

from frogkick.identification.experiment import (
    DECISIVE_SIGMA,
    POOL_M,
    WIDE,
    ActionSequence,
    Experiment,
    ModelPair,
    Side,
    experiment_of,
    extend,
    open_pairs,
    plan,
    pool_of,
    segments_of_sequence,
    separation,
)
from frogkick.identification.filter import Noise
from frogkick.identification.fit import Fitted, Model, fit, residuals_of, rollouts_of
from frogkick.identification.search import Found
from frogkick.identification.segments import Data, Segments
from frogkick.identification.steps import whitener
from frogkick.identification.terms import Interval, Term
from frogkick.identification.verdict import intervals
from frogkick.robot import load_robot

NOISE = Noise((2e-4, 3.5e-3), (1e-4, 1e-3), (1e-4, 1e-3))
START = np.array([0.1, -0.05, 0.4])
POOL = np.array([[-0.2, -0.35], [0.4, 0.25]])
ONE_LIMB = {"name": "limb_wear", "limb": "rear_left", "gain": 0.75}
BOTH = {"name": "group_gain", "group": "rear", "gain": 0.87}


def model(*terms: Term) -> Model:
    return Model(robot(), terms, NOISE, leg_s=0.06)


def pair(one: Term, other: Term) -> ModelPair:
    return ModelPair((one.title, other.title), (model(one), model(other)))


@cache
def white() -> np.ndarray:
    """Whitening matrix of the residuals of a true model."""
    swims = [make_swim([], 3, 14), make_swim([], 4, 14)]
    return whitener(residuals_of(rollouts_of([model()], swims)[0]))


def indices(row: str) -> list[int]:
    return [[action.name for action in robot().actions].index(name) for name in row]


def separation_of(models: ModelPair, row: str) -> float:
    """Separation of both models on a given sequence, as ``plan`` computes it for the best one."""
    sides = [Side(each) for each in models.models]
    sequence = ActionSequence((), 0.0, tuple(side.at_rest(START) for side in sides), ())
    for action in indices(row):
        (sequence,) = extend([sequence], sides, white(), robot(), [action])
    return separation(models, white(), segments_of_sequence(robot(), sequence, START))


@from_ci
def test_a_planned_row_tells_a_planted_pair_apart_and_a_bad_one_does_not() -> None:
    """In the simulated pool, with its noise, the true model is far more likely after the planned sequence."""
    asked = pair(term("limb_wear rear_left", 0.75), term("group_gain rear", 0.87))
    planned = plan(asked, white(), START, POOL, periods=5)
    assert planned.decisive and planned.separation_sigma > 10.0
    assert planned.text.startswith(
        "to distinguish limb_wear rear_left from group_gain rear, record from rest: "
    )
    bad = "A" * 5  # fires front limbs only
    assert separation_of(asked, bad) < 1.0
    for row, reported in ((planned.sequence, True), (bad, False)):
        for seed, (planted, which) in enumerate(((ONE_LIMB, 0), (BOTH, 1))):
            swims = [make_swim([planted], 20 + seed, 0, row)]
            squares = [
                float((np.clip(residuals_of(rollouts) @ white(), -8.0, 8.0) ** 2).sum())
                for rollouts in rollouts_of(asked.models, swims)
            ]
            gain = squares[1 - which] - squares[which]
            assert gain > 0.3 * planned.separation_sigma**2 if reported else abs(gain) < 8.0


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (term("fix_latency", 0.1), term("limb_wear all", 1.0, 0.1)),
        (term("group_loss", 0.4, 0.2), term("group_gain rear", 1.0 - 0.4 * np.exp(-0.07 / 0.2))),
    ],
)
def test_what_no_row_from_rest_tells_apart_is_said(one: Term, other: Term) -> None:
    """Late fixes look like late limbs; and rear limbs never fire without front ones."""
    after_s = robot().second_delay_s
    if one.name == "group_loss":
        other = other.at((1.0 - 0.4 * np.exp(-after_s / 0.2), 1.0))
    planned = plan(pair(one, other), white(), START, POOL, periods=4)
    assert planned.separation_sigma < 1.0 and not planned.decisive
    assert planned.text.startswith(
        f"no sequence of these actions from rest distinguishes {one.title} from {other.title}"
    )
    assert planned.as_json()["tells"] is False


def test_a_row_stays_in_its_pool_and_beats_one_action_all_the_time() -> None:
    asked = pair(term("limb_memory", 0.4, 1.5), term("limb_wear all", 0.84))
    planned = plan(asked, white(), START, POOL, periods=7)
    assert 4 <= len(planned.actions) <= 7
    assert len(set(planned.actions)) > 1  # the same limbs all the time are worn or warm alike
    steady = separation_of(asked, "A" * len(planned.actions))
    assert planned.separation_sigma > 1.5 * steady > 0.0
    side = [Side(each) for each in asked.models]
    row = ActionSequence((), 0.0, tuple(each.at_rest(START) for each in side), ())
    for action in indices(planned.sequence):
        (row,) = extend([row], side, white(), robot(), [action])
        assert (row.shown[-1][:, :2] >= POOL[0]).all() and (row.shown[-1][:, :2] <= POOL[1]).all()
    swim = segments_of_sequence(robot(), row, START)
    assert swim.pose[0] == pytest.approx(START) and len(swim.start_s) == len(planned.actions)


def test_a_robot_s_way_is_the_one_of_the_pool() -> None:
    """The trajectory that planning simulates is that of the simulated pool, within the noise of its fixes."""
    reported = [
        term("limb_wear rear_left", 0.75),
        term("fix_latency", 0.1),
        term("steady_current", 0.004, 0.0),
    ]
    tables = [
        ONE_LIMB,
        {"name": "fix_latency", "delay_s": 0.1},
        {"name": "steady_current", "x_mps": 0.004},
    ]
    pooled = make_swim(tables, 5, 0, "BEG")
    side = Side(model(*reported))
    at = pooled.pose_at(float(pooled.start_s[0]) - 0.05)
    robots = [side.at_rest(at)]
    for action in indices("BEG"):
        ((robots[0], shown),) = side.advanced([(robots[0], action)])
    gap = shown[-1] - pooled.pose_at(float(pooled.end_s[-1]) - 0.03)
    assert np.hypot(*gap[:2]) < 1.5e-3
    assert abs(gap[2]) < 0.02


def found_of(fitted: Fitted, rivals: list[list[Term]]) -> Found:
    data = Data((), np.ones(len(fitted.residuals), dtype=bool))
    return Found(data, fitted, fitted, [], [[each.title for each in row] for row in rivals], [], rivals)


def interval(name: str, low: float, high: float) -> Interval:
    return Interval(name, (low + high) / 2.0, low, high, "1")


def test_what_is_open_is_asked_effects_first_then_the_widest() -> None:
    memory, yaw = term("limb_memory", 0.4, 1.5), term("yaw_drag", 0.0, 5e-4)
    swims = [make_swim([], 3, 5)]
    (rollouts,) = rollouts_of([model(memory, yaw)], swims)
    residuals = residuals_of(rollouts)
    rng = np.random.default_rng(0)
    jacobian = rng.normal(size=(len(residuals), 9, 4))
    fitted = Fitted(model(memory, yaw), rollouts, residuals, jacobian, 0.0)
    narrow = [
        [interval("loss", 0.35, 0.45), interval("fade_s", 1.0, 2.0)],
        [interval("quadratic_nms2", 0.0, 1e-3), interval("linear_nms", 4e-4, 6e-4)],
    ]
    assert not open_pairs(found_of(fitted, [[], []]), narrow)
    assert experiment_of(found_of(fitted, [[], []]), narrow, swims) is None
    wide = [
        [interval("loss", 0.0, 0.8), interval("fade_s", 0.3, 9.9)],
        narrow[1],
    ]
    asked = open_pairs(found_of(fitted, [[], [term("centre_mass", 0.3)]]), wide)
    assert [each.between for each in asked] == [
        ("yaw_drag", "centre_mass"),
        ("limb_memory fade_s 0.3", "limb_memory fade_s 9.9"),
        ("limb_memory loss 0", "limb_memory loss 0.8"),
    ]
    assert [each.title for each in asked[0].models[1].terms] == ["limb_memory", "centre_mass"]
    assert [float(each.values[1]) for each in asked[1].models] == pytest.approx([0.3, 9.9])
    assert pool_of(swims)[1] - pool_of(swims)[0] == pytest.approx([POOL_M, POOL_M])


@from_ci
def test_a_planned_row_narrows_what_runs_left_wide(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs of one action leave the fading time of limb memory open; a planned sequence narrows its interval.

    It is halved for the robot with all its segments, and shrinks less for the one with few.
    """
    for place in ("made", __name__):
        monkeypatch.setattr(f"{place}.robot", lambda: load_robot("frog2022"))
    planted = [{"name": "limb_memory", "loss": 0.35, "fade_s": 2.5}]
    swims = [make_swim(planted, seed, 0, "A" * 8) for seed in (31, 32)]

    def data_of(runs: list[Segments]) -> Data:
        return Data(runs, np.ones(sum(len(swim.start_s) for swim in runs), dtype=bool))

    def fitted_to(data: Data) -> Fitted:
        return fit(model(term("limb_memory", 0.34, 2.7)), data, steps_max=3)

    data = data_of(swims)
    before = fitted_to(data)
    ((_, fade),) = intervals(before, data)
    assert fade.high - fade.low > WIDE * 9.8
    planned = experiment_of(found_of(before, [[]]), intervals(before, data), swims, periods=6)
    assert planned is not None and planned.between[0].startswith("limb_memory ")
    more = data_of(
        [*swims, make_swim(planted, 33, 0, planned.sequence), make_swim(planted, 34, 0, planned.sequence)]
    )
    after = fitted_to(more)
    ((_, narrower),) = intervals(after, more)
    assert narrower.high - narrower.low < 0.5 * (fade.high - fade.low)
    assert narrower.low <= 2.5 <= narrower.high


def test_what_to_do_is_said_by_how_far_apart_models_are() -> None:
    def with_sigma(sigma: float, names: tuple[str, ...] = ("A", "B")) -> Experiment:
        return Experiment(("x", "y"), names, (0.0, 0.0, 0.0), sigma)

    assert with_sigma(DECISIVE_SIGMA).text.startswith(
        "to distinguish x from y, record from rest: AB (2 periods"
    )
    assert with_sigma(DECISIVE_SIGMA / 1.9).text.startswith(
        "to distinguish x from y, record 4 times from rest: AB"
    )
    assert with_sigma(0.1).text.startswith("no sequence of these actions from rest distinguishes x from y")
    assert with_sigma(9.0, ("left", "right")).as_json()["actions"] == "left right"
    assert with_sigma(9.0).as_json()["periods"] == 2
