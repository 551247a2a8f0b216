"""A search leaves local minima, fits what few periods show, and judges calibrated starts."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from made import make_swim, robot, term
from tests.conftest import count, from_ci, some

from frogkick.core.poses import PredictionError
from frogkick.der import WIDTH
from frogkick.identification import choice
from frogkick.identification.backward import resolve_equivalent
from frogkick.identification.filter import Noise
from frogkick.identification.fit import (
    Fitted,
    Model,
    derivatives,
    fit_many,
    fit_on,
    refresh_jacobian,
    residuals_of,
    rollouts_of,
)
from frogkick.identification.refine import noise_reestimated, refined, with_fewer_free
from frogkick.identification.screening import Column, held_out_gain
from frogkick.identification.search import (
    Found,
    _ForwardSelection,
    nominal_fit,
    search,
)
from frogkick.identification.segments import Data, Segments
from frogkick.identification.steps import _shrunk, deviance_of, linearised_optimum, log_density, scale_of
from frogkick.identification.verdict import (
    FOUND,
    NOTHING,
    PARTLY,
    UNEXPLAINED,
    Scored,
    grid_intervals,
    intervals,
)

NOISE = Noise((2e-4, 3.5e-3), (1e-4, 1e-3), (1e-4, 1e-3))


@pytest.fixture(scope="module")
def worn() -> list[Segments]:
    planted = {"name": "limb_wear", "limb": "rear_left", "gain": 0.7}
    return [make_swim([planted], seed, 14) for seed in (1, 2)]


def data_of(swims: list[Segments]) -> Data:
    (rollouts,) = rollouts_of([Model(robot(), (), NOISE)], swims)
    rows = np.isfinite(np.concatenate([rollout.residuals for rollout in rollouts])).all(axis=1)
    return Data(swims, rows)


@from_ci
def test_lanes_that_wait_for_a_place_swim_as_they_would_at_once(worn: list[Segments]) -> None:
    models = [
        Model(robot(), (term("limb_wear rear_left").at((gain, 0.0, 1.0)),), NOISE)
        for gain in np.linspace(0.5, 1.0, WIDTH // 2 + 1)
    ]
    cut = replace(worn[1], **{k: getattr(worn[1], k)[:3] for k in ("start_s", "end_s", "action")})
    swims = [worn[0], cut]
    assert len(models) * len(swims) > WIDTH
    for model, together in zip(models, rollouts_of(models, swims), strict=True):
        for rollout, swim in zip(together, swims, strict=True):
            ((alone,),) = rollouts_of([model], [swim])
            assert np.array_equal(rollout.residuals, alone.residuals, equal_nan=True)
            assert np.array_equal(rollout.difference, alone.difference)


def test_a_step_explains_what_few_periods_show() -> None:
    """The periods of a limb that seldom fires are outliers at first and have little weight until the step."""
    rng = np.random.default_rng(7)
    residuals, jacobian = rng.normal(0.0, 1e-3, (60, 9)), np.zeros((60, 9, 1))
    jacobian[:6, :, 0] = rng.normal(0.0, 0.1, (6, 9))
    residuals -= 0.4 * jacobian[:, :, 0]
    ends = np.array([1.0])
    step, deviance = linearised_optimum(residuals, jacobian, -ends, ends, np.full(1, 1e-9))
    assert step[0] == pytest.approx(0.4, abs=0.01)
    assert deviance == pytest.approx(deviance_of(residuals + jacobian[:, :, 0] * step[0]))


def test_what_is_held_is_not_simulated_in_a_fit(worn: list[Segments]) -> None:
    model = Model(robot(), (term("limb_wear rear_left"),), NOISE, fixed=frozenset({1, 2}))
    data = data_of(worn)
    (fitted,) = fit_many([model], data, 4)
    assert fitted.model.values[0] == pytest.approx(0.7, abs=0.02)
    assert not fitted.jacobian[:, :, 1:].any()
    (whole,) = derivatives([fitted.model], data)
    assert whole.jacobian.any(axis=(0, 1)).all()


@from_ci
def test_derivatives_that_mislead_are_simulated_anew(worn: list[Segments]) -> None:
    """A Jacobian a third as large makes the first step three times too long; the fit then refreshes it."""
    model = Model(robot(), (term("limb_wear rear_left").at((0.9, 0.0, 1.0)),), NOISE, fixed=frozenset({1, 2}))
    data = data_of(worn)
    (right,) = derivatives([model], data, fixed=False)
    stale = replace(right, jacobian=right.jacobian / 3.0, fresh=False)
    (fitted,) = fit_on([stale], data, 6)
    (straight,) = fit_on([right], data, 6)
    assert fitted.model.values[0] == pytest.approx(straight.model.values[0], abs=2e-3)
    assert abs(fitted.deviance - straight.deviance) < 0.5
    (whole,) = refresh_jacobian([fitted], data)
    (exact,) = derivatives([fitted.model], data)
    assert np.array_equal(whole.residuals, exact.residuals)
    assert whole.fresh and np.allclose(whole.jacobian[:, :, 1:], exact.jacobian[:, :, 1:], rtol=0.0)


@from_ci
def test_a_delay_that_settled_in_a_dip_is_put_back(worn: list[Segments]) -> None:
    """The frame oscillates at 40 Hz, so a delay of half a period is a local minimum."""
    data = data_of(worn)
    dip = Model(robot(), (term("limb_wear rear_left").at((0.71, 0.0125, 1.0)),), NOISE, fixed=frozenset({2}))
    (taken,) = fit_many([dip], data, 1)
    fine = refined(taken, data)
    assert fine.model.values[1] == 0.0
    (row,) = intervals(fine, data)
    assert row[0].low <= 0.7 <= row[0].high and row[0].high - row[0].low < 0.05


def test_a_late_limb_is_found_with_its_delay() -> None:
    late = {"name": "limb_wear", "limb": "front_left", "delay_s": 0.12}
    swims = [make_swim([late], seed, 14) for seed in (31, 32)]
    found = search(*nominal_fit(swims, robot()), [term("limb_wear front_left"), term("fix_latency")])
    assert [each.title for each in found.fitted.model.terms] == ["limb_wear front_left"]
    (row,) = intervals(found.fitted, found.data)
    for each, true in zip(row, (1.0, 0.12, 1.0), strict=True):
        assert abs(true - each.value) <= each.high - each.low, each
    assert row[1].low <= 0.12 <= row[1].high and row[1].high - row[1].low < count(30, 30, 40) * 1e-3
    assert row[0].high - row[0].low < 0.1, "what is held has an interval too"


@from_ci
@pytest.mark.parametrize(("periods", "released"), [(24, True), (16, False)])
def test_the_delay_of_a_limb_that_is_also_weak_lies_in_its_interval(periods: int, released: bool) -> None:
    """The gain alone leaves little more than noise, and the derivative at no delay does not show 60 ms.

    In few periods the best of many delays may be chance. None is taken then, but the interval contains it.
    """
    planted = {"name": "limb_wear", "limb": "front_left", "gain": 0.7, "delay_s": 0.06}
    data, nominal = nominal_fit([make_swim([planted], seed, periods) for seed in (33, 34)], robot())
    weak = Model(robot(), (term("limb_wear front_left", 0.7),), nominal.model.noise, fixed=frozenset({1, 2}))
    (fitted,) = refresh_jacobian([refined(*fit_many([weak], data, 1), data)], data)
    gain, delay, _ = intervals(fitted, data)[0]
    assert (1 not in fitted.model.fixed) == released
    assert gain.low <= 0.7 <= gain.high, gain
    delay = delay.reaching(*grid_intervals(fitted, data)[1])
    assert delay.low <= 0.06 <= delay.high < 0.3, delay
    assert not released or delay.high - delay.low < 0.03, delay


@from_ci
def test_effects_that_do_the_same_are_named_together() -> None:
    """Rear limbs always fire at one time after front ones, so the runs cannot show which loss acts."""
    swims = [
        make_swim([{"name": "group_loss", "loss": 0.55, "fade_s": 0.2}], seed, 11, row)
        for seed, row in ((41, "ABCDEFABCDE"), (42, "FEDCBAFEDCB"))
    ]
    rivals = [term("group_loss"), term("group_gain rear")]
    said = list[str]()
    found = search(*nominal_fit(swims, robot()), rivals, lambda *stage: said.extend(stage[3:]))
    assert said[0] in ("trying group_gain rear, group_loss", "trying group_loss, group_gain rear")
    assert said[1].removeprefix("refining ") in ("group_gain rear", "group_loss")
    named = [found.fitted.model.terms[0].title, *found.confounded_with[0]]
    assert sorted(named) == ["group_gain rear", "group_loss"]


@pytest.mark.parametrize(
    ("searched", "calibrated", "far", "many", "taken"),
    [
        (FOUND, FOUND, False, False, "search"),
        (NOTHING, FOUND, False, False, "search"),
        (UNEXPLAINED, FOUND, False, False, "calibrated"),
        (PARTLY, FOUND, False, False, "calibrated"),
        (FOUND, PARTLY, True, False, "part"),
        (PARTLY, PARTLY, True, False, "calibrated"),
        (FOUND, FOUND, True, False, "calibrated"),
        (FOUND, UNEXPLAINED, True, False, "part"),
        (UNEXPLAINED, UNEXPLAINED, True, False, "calibrated"),
        (FOUND, FOUND, False, True, "calibrated"),
        (FOUND, UNEXPLAINED, False, True, "part"),
        (UNEXPLAINED, UNEXPLAINED, False, True, "calibrated"),
    ],
)
def test_a_calibrated_start_that_does_not_explain_all_is_held_against_a_search(
    monkeypatch: pytest.MonkeyPatch, searched: str, calibrated: str, far: bool, many: bool, taken: str
) -> None:
    """A wall causes errors as large as those of a hull that differs from its drawing."""
    rows = np.ones(choice.SEARCHED_MOST + many, dtype=bool)
    verdicts = {"search": searched, "part": searched, "calibrated": calibrated}
    off = PredictionError(*(2.0 * np.array(choice.FAR) if far else 0.5 * np.array(choice.FAR)).tolist(), 10)
    near = PredictionError(0.5 * off.position_rmse_m, 0.5 * off.heading_rmse_rad, 10)

    def named(name: str) -> Any:
        return lambda *_args, **_more: name

    monkeypatch.setattr(choice, "calibrated_starts", lambda _robot: {"measured": ()})
    monkeypatch.setattr(choice, "nominal_fit", lambda *_args: (Data((), rows), None))
    monkeypatch.setattr(choice, "search", named("search"))
    monkeypatch.setattr(choice, "_search_in_part", named("part"))
    monkeypatch.setattr(choice, "_calibrated", named("calibrated"))
    monkeypatch.setattr(choice, "_verdict", lambda found: verdicts[found])
    monkeypatch.setattr(choice, "_scored", lambda _found: Scored(off, near, near))
    given: Any = choice.found_in([], robot(), [], lambda *_args: None)
    assert given == taken


@pytest.mark.parametrize("limbs_misfire", [True, False])
def test_the_candidates_given_are_searched_also_beside_misfires_and_laws(
    monkeypatch: pytest.MonkeyPatch, limbs_misfire: bool
) -> None:
    """A user's effects are among them, and in no catalogue that is made again."""
    given, tried = [term("drag_scale")], list[list[str]]()
    fitted: Any = SimpleNamespace(model=SimpleNamespace(terms=()))
    begun = Found(Data((), np.ones(0, dtype=bool)), fitted, fitted)

    def searched(_data: Data, _nominal: Fitted, candidates: Any, *_args: Any, **_more: Any) -> Found:
        tried.append([each.title for each in candidates])
        return begun

    def derived(_model: Model, candidates: Any, *_args: Any) -> list[Column]:
        tried.append([each.title for each in candidates])
        return [Column(each, np.zeros((0, 9, 1))) for each in candidates]

    misfires = SimpleNamespace(patterned=lambda _fired: not limbs_misfire, deviance=-1.0)
    for name, stub in (
        ("search", searched), ("sensitivities", derived), ("Laws", lambda *_args: None),
        ("misfires_of", lambda *_args: misfires), ("without_failed", lambda *_args: ()),
        ("nominal_fit", lambda *_args: (begun.data, fitted)), ("derivatives", lambda *_args: [fitted]),
        ("responses_of", lambda *_args: SimpleNamespace(idle=None, fired=None)),
        ("_verdict", lambda _found: PARTLY), ("_penalised", lambda _found: 0.0),
    ):  # fmt: skip
        monkeypatch.setattr(choice, name, stub)
    choice.discovered(begun, given, robot(), lambda *_args: None)
    assert tried == [["drag_scale"]] * (3 if limbs_misfire else 2)


@from_ci
def test_a_search_in_part_is_fitted_to_all_runs(
    worn: list[Segments], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(choice, "PART", 20)
    data, nominal = nominal_fit(worn, robot())
    begun = Found(data, nominal, nominal)
    seen: list[int] = []

    def searched(data: Data, nominal: Fitted, *_args: Any, most: int) -> Found:
        seen.extend(len(swim.start_s) for swim in data.swims)
        return search(data, nominal, [term("limb_wear rear_left")], most=most)

    monkeypatch.setattr(choice, "search", searched)
    found = choice._search_in_part(begun, robot(), [], lambda *_args: None)
    assert seen == [10, 10] and len(found.fitted.residuals) == len(data.rows) == 28
    assert found.fitted.model.values[0] == pytest.approx(0.7, abs=0.02)


@from_ci
@pytest.mark.parametrize("title", some(["limb_wear rear_left", "drag_scale"], 1))
def test_held_out_gains_are_those_of_fits_that_never_saw_the_fold(worn: list[Segments], title: str) -> None:
    """Gains by derivatives are compared with fits by simulation without each fold.

    For the true effect and for a false one, whose gain would show if a fold took part in its own fit.
    """
    data = data_of(worn)
    folds = data.folds
    start = Model(robot(), (term(title),), NOISE)
    (current,) = derivatives([replace(start, terms=())], data)
    (fitted,) = fit_many([start], data, 4)
    shown = held_out_gain(current, fitted, folds)[0]
    places, falls = np.flatnonzero(data.rows), []
    for label in np.unique(folds):
        seen, left = np.zeros_like(data.rows), np.zeros_like(data.rows)
        seen[places[folds != label]], left[places[folds == label]] = True, True
        (alone,) = fit_many([start], Data(worn, seen), 4)
        (kept,) = rollouts_of([alone.model], worn)
        scores = []
        for rollouts in (current.rollouts, kept):
            train, test = residuals_of(rollouts, seen), residuals_of(rollouts, left)
            scores.append(log_density(test, _shrunk(scale_of(train), len(train))))
        falls.append(2.0 * (scores[1] - scores[0]))
    refitted = float(np.concatenate(falls).mean())
    assert shown == pytest.approx(refitted, rel=0.1, abs=0.3)


@from_ci
def test_a_rival_is_not_judged_in_a_dip() -> None:
    """Late fixes and late strokes of all limbs fit equally well: the effect with fewer parameters is named.

    In the rival's fit the worn limb is in a local minimum, half an oscillation of the frame late. Two steps
    of a fit do not leave it, so the rival must also be tried with the worn limb of the refined model.
    """
    worn = {"name": "limb_wear", "limb": "front_left", "gain": 0.88}
    swims = [make_swim([worn, {"name": "fix_latency", "delay_s": 0.062}], seed, 14) for seed in (1, 2)]
    limb, every, fixes = (term(name) for name in ("limb_wear front_left", "limb_wear all", "fix_latency"))
    data = data_of(swims)
    late = (limb.at((0.882, 0.003, 1.0)), every.at((1.0, 0.0625, 1.0)))
    dip = (limb.at((0.8817, 0.0457, 1.0)), fixes.at((0.0562,)))
    fixed = frozenset({2, 3, 5})
    (taken,) = fit_many([Model(robot(), late, NOISE, fixed=fixed)], data, 6)
    (rival,) = derivatives([Model(robot(), dip, NOISE, fixed=frozenset({2}))], data)
    selection = _ForwardSelection(data, [])
    settled, alike = selection.simplest_of(noise_reestimated(taken, data), [rival])
    assert [each.title for each in settled.model.terms] == ["limb_wear front_left", "fix_latency"]
    assert [each.title for each in alike] == ["limb_wear all"]
    assert settled.model.values[-1] == pytest.approx(0.062, abs=0.006)
    # Also if the rival was not tried before; but not if the limbs are weaker as well.
    named, alike = resolve_equivalent(data, noise_reestimated(taken, data), [[], []], [limb, every, fixes])
    assert [each.title for each in named.model.terms] == ["limb_wear front_left", "fix_latency"]
    assert [[each.title for each in others] for others in alike] == [[], ["limb_wear all"]]
    assert resolve_equivalent(data, taken, [[], []], [limb, every])[0] is taken, "nobody looks for late fixes"


@from_ci
def test_a_delay_that_is_none_does_not_stay_in_a_dip() -> None:
    """The deviance oscillates with a delay: derivatives in one local minimum say nothing of the others.

    Fixing the delay at nominal is therefore judged by simulation, in every term and not only the last. The
    derivative by the delay is made eight times too large here.
    """
    worn = {"name": "limb_wear", "limb": "front_left", "gain": 0.76}
    swims = [make_swim([worn, {"name": "fix_latency", "delay_s": 0.091}], seed, 14) for seed in (1, 2)]
    data = data_of(swims)
    dip = (term("limb_wear front_left").at((0.76, 0.06, 1.0)), term("fix_latency").at((0.083,)))
    quiet = Noise(NOISE.fix, (8e-6, 2e-4), (8e-6, 2e-4))
    # Whether a fit stops in a local minimum depends on last digits, so the delay is fixed there at first.
    (settled,) = fit_many([Model(robot(), dip, quiet, fixed=frozenset({1, 2}))], data, 6)
    (taken,) = derivatives([replace(settled.model, fixed=frozenset({2}))], data)
    steep = replace(taken, jacobian=taken.jacobian * np.array([1.0, 8.0, 1.0, 1.0]))
    spared = with_fewer_free(steep, data)
    assert spared.model.values[1] == 0.0 and spared.deviance < taken.deviance


@from_ci
def test_a_clock_that_drifts_is_found_beside_a_latency_that_stands_for_both() -> None:
    """A latency is fitted to both at first. Because the frame oscillates, derivatives show no drift there."""
    both = [{"name": "clock_drift", "drift": 0.006}, {"name": "fix_latency", "delay_s": 0.09}]
    swims = [make_swim(both, seed, 16) for seed in (1, 2)]
    rivals = [term(name) for name in ("limb_wear all", "fix_latency", "clock_drift", "limb_wear front_left")]
    found = search(*nominal_fit(swims, robot()), rivals)
    values = {each.title: each.values[0] for each in found.fitted.model.terms}
    assert set(values) == {"clock_drift", "fix_latency"}
    assert values["clock_drift"] == pytest.approx(0.006, abs=6e-4)
    assert values["fix_latency"] == pytest.approx(0.09, abs=0.01)


@from_ci
def test_limbs_that_are_late_and_weak_are_no_late_fixes() -> None:
    weak = {"name": "limb_wear", "limb": "all", "gain": 0.8, "delay_s": 0.06}
    swims = [make_swim([weak], seed, 14) for seed in (1, 2)]
    every, fixes = term("limb_wear all"), term("fix_latency")
    data = data_of(swims)
    model = Model(robot(), (every.at((0.8, 0.06, 1.0)),), NOISE, fixed=frozenset({2}))
    (taken,) = fit_many([model], data, 6)
    named, alike = resolve_equivalent(data, taken, [[]], [every, fixes])
    assert named is taken and alike == [[]]
