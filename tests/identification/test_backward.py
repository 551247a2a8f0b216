"""Effects that were taken one by one are revised together; fits leave local minima of a stroke's delay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made import make_swim, robot, term
from tests.conftest import from_ci

from frogkick.effects.acting import LEG_S
from frogkick.effects.limbs import DELAYS_S
from frogkick.identification.backward import (
    backward_elimination,
    resolve_equivalent,
    revise,
    stability,
    superfluous_term,
)
from frogkick.identification.choice import STABLE, _at_bound, in_all_fixes, pruned
from frogkick.identification.filter import Noise
from frogkick.identification.fit import (
    REFINING_LEG_S,
    STEP_SHARES,
    WRENCH_LEG_S,
    Fitted,
    Model,
    _damped_step,
    derivatives,
    deviances_of,
    difference_steps,
    fit,
)
from frogkick.identification.law_kinds import kinds_of
from frogkick.identification.refine import from_grids
from frogkick.identification.search import Found, nominal_fit
from frogkick.identification.segments import Data, Segments
from frogkick.identification.steps import deviance_of
from frogkick.identification.terms import Term, catalogue

QUIET = Noise((2e-4, 3.5e-3), (2e-5, 5e-4), (2e-5, 5e-4))
WEAR = {"name": "limb_wear", "limb": "rear_left", "gain": 0.7}


def held_but(model: Model, *free: int) -> Model:
    return replace(model, fixed=frozenset(range(len(model.values))) - set(free))


def fitted_to(data: Data, terms: tuple[Term, ...], *free: int) -> Fitted:
    model = held_but(Model(robot(), terms, QUIET, REFINING_LEG_S), *free)
    return derivatives([fit(model, data, 4).model], data)[0]


def test_a_law_that_amounts_to_wear_of_a_limb_is_named_as_wear() -> None:
    """A law by heading that does not depend on the heading, as it remains beside a tether."""
    swims = [make_swim([WEAR], 3, 8)]
    data = Data(swims, np.ones(8, dtype=bool))
    kinds = {kind.named: kind for kind in kinds_of(robot(), swims)}
    every, rhythm = (kinds[f"stroke {name} rear_left"] for name in ("by heading", "in rhythm"))
    others = [rhythm.term(rhythm.grid[0]), term("limb_wear rear_right")]
    law = fitted_to(data, (every.term({}).at((-0.28, 0.0, 0.0)),), 0)
    named, alike = resolve_equivalent(data, law, [others], catalogue(robot()))
    (wear,) = named.model.terms
    assert wear.title == "limb_wear rear_left" and wear.values[0] == pytest.approx(
        1.0 + law.model.values[0], abs=4e-3
    )
    assert [each.title for each in alike[0]] == ["limb_wear rear_right"]
    turning = fitted_to(data, (every.term({}).at((-0.28, 0.05, 0.0)),), 0, 1)
    assert resolve_equivalent(data, turning, [[]], catalogue(robot()))[0] is turning


@pytest.fixture(scope="module")
def late() -> list[Segments]:
    """Runs of a robot with a worn limb, whose fixes are late."""
    return [make_swim([WEAR, {"name": "fix_latency", "delay_s": 0.12}], 3, 16)]


@from_ci
def test_an_effect_that_others_make_needless_is_dropped(late: list[Segments]) -> None:
    data = nominal_fit(late, robot())[0]
    terms = (term("steady_wrench", 1e-4, 0.0, 0.0), term("limb_wear rear_left"), term("fix_latency", 0.1))
    current = fitted_to(data, terms, 0, 3, 6)
    found, confounded = revise(data, current, [[term("fix_latency")], [], []], [[], [], []])
    assert [each.title for each in found.model.terms] == ["limb_wear rear_left", "fix_latency"]
    assert len(confounded) == 2
    assert found.model.terms[0].values[0] == pytest.approx(0.7, abs=0.01)
    assert found.model.terms[1].values[0] == pytest.approx(0.12, abs=0.01)


def test_the_delay_of_a_limb_leaves_a_local_minimum() -> None:
    """The deviance oscillates with a stroke's delay, as the frame does: descent stays in its minimum."""
    data = nominal_fit([make_swim([{**WEAR, "gain": 0.55, "delay_s": 0.09}], 3, 16)], robot())[0]
    model = held_but(Model(robot(), (term("limb_wear rear_left", 0.55, 0.0),), QUIET, REFINING_LEG_S), 0, 1)
    (stuck,) = derivatives([model], data)
    found = from_grids(stuck, data)
    assert found.deviance < stuck.deviance - 1.0 and abs(found.model.values[0] - 0.55) < 0.03
    late = [model.with_values(np.array([0.55, delay_s, 1.0])) for delay_s in DELAYS_S]
    at_one_noise = [replace(each, noise=found.model.noise, leg_s=found.model.leg_s) for each in late]
    assert found.deviance < min(deviances_of(at_one_noise, data)) + 1.0
    assert from_grids(found, data).model.values == pytest.approx(found.model.values, abs=0.02)


@from_ci
@pytest.mark.parametrize("delayed_first", [True, False])
def test_a_constant_that_pauses_is_said_as_a_law_at_intervals(delayed_first: bool) -> None:
    swims = [make_swim([], seed, 12) for seed in (4, 5)]
    kind = next(each for each in kinds_of(robot(), swims) if each.title == "fixes late at intervals")
    planted = {"late": 0.12, "cycle": 7.3, "middle": 2.0, "share": 0.6}
    late = [make_swim([{**dict(kind.term(planted).table), **planted}], seed, 16) for seed in (4, 5)]
    data = nominal_fit(late, robot())[0]
    pauses = kind.term({"late": -0.12, "cycle": 7.3, "middle": 2.0 + 3.65, "share": 0.4})
    constant = term("fix_latency", 0.12)
    terms = (constant, pauses) if delayed_first else (pauses, constant)
    current = fitted_to(data, terms, 0, 1, 2, 3, 4)
    found, kept = backward_elimination(data, current)
    assert kept == [terms.index(pauses)]
    values = dict(zip((p.name for p in pauses.parameters), found.model.terms[0].values, strict=True))
    assert values["late"] == pytest.approx(0.12, abs=0.01) and values["share"] == pytest.approx(0.6, abs=0.03)
    assert (values["middle"] - 2.0 + 3.65) % 7.3 == pytest.approx(3.65, abs=0.2)
    # Such fixes seem to jump as well, where one comes late: the law makes jumps superfluous.
    baseline = nominal_fit(late, robot())[1]
    alone = Found(data, baseline, found, confounded_with=[[]])
    again = in_all_fixes(alone, late, robot())
    assert again is not None and again.fitted.model.terms[0].title == pauses.title
    assert in_all_fixes(Found(data, baseline, baseline), late, robot()) is None


def test_a_parameter_at_its_bound_is_no_end_of_the_search() -> None:
    worn = term("limb_wear rear_left", 0.7)
    for values, at_bound in ((worn.values, False), ((worn.parameters[0].low, *worn.values[1:]), True)):
        assert _at_bound(Model(robot(), (worn.at(values),), QUIET)) == at_bound


@from_ci
def test_another_effect_takes_the_place_of_one_that_stood_in_for_it(late: list[Segments]) -> None:
    """Late strokes of all limbs resemble late fixes; beside the worn limb the latency fits better."""
    data = nominal_fit(late, robot())[0]
    taken = fitted_to(data, (term("limb_wear all", 1.0, 0.12, 1.0),), 1)
    rival = fitted_to(data, (term("fix_latency", 0.1),), 0)
    terms = (*taken.model.terms, term("limb_wear rear_left", 0.8, 0.0, 1.0))
    current = fitted_to(data, terms, 1, 3)
    found, confounded = revise(data, current, [[], []], [[taken, rival], []])
    assert [each.title for each in found.model.terms] == ["fix_latency", "limb_wear rear_left"]
    assert found.model.terms[0].values[0] == pytest.approx(0.12, abs=0.01)
    assert all(each.title == "limb_wear all" for each in confounded[0])


@from_ci
def test_delays_of_all_limbs_are_no_substitute_for_late_fixes(late: list[Segments]) -> None:
    """Delays of four limbs, taken one by one, imitate late fixes, which did not seem best after the first."""
    data = nominal_fit(late, robot())[0]
    wear = fitted_to(data, (term("limb_wear rear_left", 0.8, 0.0, 1.0),), 0)
    latency = fitted_to(data, (term("fix_latency", 0.1),), 0)
    limbs = ("rear_left", "rear_right", "front_left", "front_right")
    terms = tuple(term(f"limb_wear {limb}", 0.7 if limb == "rear_left" else 1.0, 0.1, 1.0) for limb in limbs)
    current = fitted_to(data, terms, 0, 1, 4, 7, 10)
    none = [list[Fitted]()] * 4
    every = fitted_to(data, (term("limb_wear all", 1.0, 0.12, 1.0),), 1)
    found, confounded = revise(data, current, [[], [], [], []], none, [every, wear, latency])
    assert [each.title for each in found.model.terms] == ["limb_wear rear_left", "fix_latency"]
    assert confounded[0] == [] and [each.title for each in confounded[1]] in ([], ["limb_wear all"])
    assert found.model.terms[0].values == pytest.approx((0.7, 0.0, 1.0), abs=0.01)
    assert found.model.terms[1].values[0] == pytest.approx(0.12, abs=0.01)
    alone = revise(data, current, [[], [], [], []], none)[0]
    assert len(alone.model.terms) > 2


def test_a_step_that_failed_is_cut_short() -> None:
    rng = np.random.default_rng(5)
    residuals, jacobian = rng.normal(0.0, 1e-3, (40, 9)), rng.normal(0.0, 1e-3, (40, 9, 1))
    model = Model(robot(), (term("fix_latency", 0.2),), QUIET)
    fitted = Fitted(model, [], residuals + 0.1 * jacobian[:, :, 0], jacobian, 0.0)
    whole, promise = _damped_step(fitted, 0)
    for failed in (1, 2):
        part, less = _damped_step(fitted, failed)
        share = (part.values - model.values) / (whole.values - model.values)
        assert 0.0 < share[0] < 1.5 * STEP_SHARES[failed]
        step = part.values - model.values
        assert less == pytest.approx(deviance_of(fitted.residuals + fitted.jacobian @ step))
        assert less > promise


def test_long_steps_are_for_where_an_effect_vanishes() -> None:
    soft, hard = (Model(robot(), (term("wall x_high", 0.4, 0.5, h),), QUIET) for h in (0.0, 0.5))
    assert difference_steps(soft)[2] == pytest.approx(0.5)
    assert difference_steps(hard)[2] == pytest.approx(0.04)
    assert difference_steps(hard)[0] == pytest.approx(0.002)
    top = Model(robot(), (term("wall x_high", 0.4, 0.5, 0.79),), QUIET)
    assert difference_steps(top)[2] == pytest.approx(-0.04)


def test_a_wall_is_followed_as_finely_as_in_the_pool() -> None:
    for title, values, leg_s in (
        ("wall x_high", (0.4, 0.5, 0.5), LEG_S),
        ("wall x_high", (0.4, 0.5, 0.0), WRENCH_LEG_S),
        ("fix_latency", (0.1,), REFINING_LEG_S),
    ):
        assert Model(robot(), (term(title, *values),), QUIET).fine_leg_s == leg_s


def test_an_effect_that_held_out_parts_do_not_ask_for_goes(late: list[Segments]) -> None:
    """Beside a true effect, one that does nothing can be left out without a loss on held-out parts."""
    terms = (term("limb_wear rear_left", 0.7, 0.0, 1.0), term("fix_latency", 0.12), term("yaw_drag"))
    data, fixed = nominal_fit(late, robot())[0], frozenset({1, 2})
    (whole,) = derivatives([Model(robot(), terms, QUIET, REFINING_LEG_S, fixed=fixed)], data)
    place = superfluous_term(whole, data)
    assert place == 2
    less = whole.model.without(place)
    assert [each.title for each in less.terms] == [
        "limb_wear rear_left",
        "fix_latency",
    ] and less.fixed == fixed
    (fitted,) = derivatives([less], data)
    assert superfluous_term(fitted, data) is None


@from_ci
def test_what_few_draws_of_the_runs_would_take_is_unstable(
    late: list[Segments], whole: list[Segments]
) -> None:
    """True effects are selected in every resample, a false one in few of them, although it was fitted."""
    data = nominal_fit(late, robot())[0]
    terms = (term("limb_wear rear_left", 0.7, 0.0, 1.0), term("fix_latency", 0.12), term("yaw_drag"))
    fitted = fitted_to(data, terms, 0, 3, 4)
    shares = stability(fitted, data, True)
    assert min(shares[:2]) > 0.95 and shares[2] < STABLE
    begun = nominal_fit(whole, robot())
    alone = fitted_to(begun[0], (term("limb_wear front_left", 0.99, 0.0, 1.0),), 0)
    kept = pruned(Found(*begun, alone, [[]], [[]]), lambda *_: None)
    assert not kept.fitted.model.terms and not kept.stability and not kept.confounded_with
    joint = pruned(Found(*begun, alone, [], [[]]), lambda *_: None)
    assert joint.fitted is alone and len(joint.stability) == 1, "what a calibrated start has stays together"
