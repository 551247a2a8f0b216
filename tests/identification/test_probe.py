"""Which parameters need a simulation of their own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from made import make_swim, robot, term

from frogkick.core.errors import InputError
from frogkick.effects import Effect, changed_robot
from frogkick.identification.filter import Noise
from frogkick.identification.fit import Model, difference_steps, residuals_of, rollouts_of
from frogkick.identification.screening import Column, LinearSpan, changes, probes_of, sensitivities
from frogkick.identification.segments import Data
from frogkick.identification.steps import linearised_optimum
from frogkick.identification.terms import catalogue, unfittable

NOISE = Noise((2e-4, 3.5e-3), (1e-4, 1e-3), (1e-4, 1e-3))


def change(title: str) -> list[np.ndarray | None]:
    model = Model(robot(), (term(title),), NOISE)
    return changes(probes_of(robot()), term(title), difference_steps(model))


def test_parameters_that_do_nothing_are_told_from_those_that_do() -> None:
    loss, fade = change("limb_memory")
    assert loss is not None and loss.any()
    assert fade is not None and not fade.any()
    assert change("mass_scale") == [None, None]


def test_limbs_add_up_to_their_group_and_delays_do_not() -> None:
    span = LinearSpan()
    singles = [change(f"limb_wear {limb.name}") for limb in robot().limbs]
    for gain, _, _ in singles:
        assert gain is not None and span.weights(gain) is None
        span.add(gain)
    left, _ = change("group_gain left")
    assert left is not None
    weights = span.weights(left)
    assert weights is not None
    fires = ["left" in limb.name for limb in robot().limbs]
    np.testing.assert_allclose(weights, fires, atol=1e-6)
    delay = change("limb_wear all")[1]
    assert delay is not None and span.weights(delay) is None
    memory = change("limb_memory")[0]
    assert memory is not None and span.weights(memory) is None


def test_a_sum_is_what_its_own_simulation_gives() -> None:
    data = Data([make_swim([], 9, 6)], np.ones(6, dtype=bool))
    names = [f"limb_wear {limb.name}" for limb in robot().limbs]
    terms = [term(name) for name in (*names, "group_gain rear")]
    columns = sensitivities(Model(robot(), (), NOISE), terms, data, lambda _done, _whole: None)
    (rear,) = [column for column in columns if column.term.title == "group_gain rear"]
    bare = Model(robot(), (), NOISE)
    moved = Model(robot(), (term("group_gain rear").at((1.02, 1.0)),), NOISE)
    base, there = (residuals_of(rollouts, data.rows) for rollouts in rollouts_of([bare, moved], data.swims))
    own = (there - base) / 0.02
    assert np.linalg.norm(rear.jacobian[:, :, 0] - own) < 0.1 * np.linalg.norm(own)


@pytest.mark.parametrize("hook", ["check", "starts", "robot", "stroke", "flow", "wrench", "fix"])
def test_a_method_of_a_users_effect_that_fails_is_named(tmp_path: Path, hook: str) -> None:
    (tmp_path / "bad.py").write_text(
        "from frogkick.effects import Effect, parameter\n\n\nclass Bad(Effect):\n"
        f"    size = parameter('1', 0.0, 1.0, 0.0)\n\n    def {hook}(self, *given):\n        return 1 / 0\n"
    )
    with pytest.raises(InputError, match=f"effect 'Bad': {hook} fails: ZeroDivisionError"):
        sensitivity_of_own(tmp_path / "bad.py")


@pytest.mark.parametrize(
    ("starts", "why"),
    [
        ("[{'sise': 0.5}]", "starts gave a value of 'sise' .did you mean 'size'..: its parameters are size"),
        ("[{'size': 'big'}]", "starts gave size = 'big', needed is a number"),
        ("[{'size': float('nan')}]", "starts gave size = nan, needed is a number"),
        ("{'size': 0.5}", r"starts gave \{'size': 0.5\}, needed is a list .* as \[\{'size': 0.1\}\]"),
        ("None", "starts gave None, needed is a list"),
        ("({'size': 1 / 0} for _ in range(2))", "starts fails: ZeroDivisionError"),
    ],
)
def test_wrong_starts_of_a_users_effect_are_named(tmp_path: Path, starts: str, why: str) -> None:
    (tmp_path / "bad.py").write_text(
        "from frogkick.effects import Effect, parameter\n\n\nclass Bad(Effect):\n"
        "    size = parameter('1', 0.0, 1.0, 0.0)\n\n    def starts(self, low_m, high_m):\n"
        f"        return {starts}\n"
    )
    with pytest.raises(InputError, match=f"effect 'Bad': {why}"):
        sensitivity_of_own(tmp_path / "bad.py")


def test_options_that_are_no_table_are_named(tmp_path: Path) -> None:
    (tmp_path / "bad.py").write_text(
        "class Bad:\n    options = ['limb']\n\n    def wrench(self, time_s, body):\n        return 0, 0, 0\n"
    )
    with pytest.raises(InputError, match=r"effect 'Bad': options are \['limb'\]: give {'limb': 'all'}"):
        catalogue(robot(), tmp_path / "bad.py")


@pytest.mark.parametrize(
    "acts", ["stroke.time_s > 25.0", "stroke.body is not None and stroke.body.pose_world[0] > -9.0"]
)
def test_a_users_effect_is_tried_where_no_probe_sees_it(tmp_path: Path, acts: str) -> None:
    """The probes are early in a run, and do not know the state of the body when a limb fires."""
    (tmp_path / "late.py").write_text(
        "from frogkick.effects import Effect, parameter\n\n\nclass Late(Effect):\n"
        "    asks_body = True\n    loss = parameter('1', 0.0, 0.9, 0.0)\n\n"
        f"    def stroke(self, stroke, history, rng):\n        if {acts}:\n"
        "            stroke.gain *= 1.0 - self.loss\n"
    )
    (column,) = sensitivity_of_own(tmp_path / "late.py", 18)
    assert column.jacobian[-1].any()


def test_a_users_effect_without_parameters_is_told(tmp_path: Path) -> None:
    (tmp_path / "bare.py").write_text(
        "from frogkick.effects import Effect, parameter\n\n\nclass Bare(Effect):\n"
        "    def wrench(self, time_s, body):\n        return 0.0, self.push, 0.0\n\n\n"
        "class Push(Bare):\n    push = parameter('N', -0.1, 0.1, 0.0)\n"
    )
    assert [term.name for term in catalogue(robot(), tmp_path / "bare.py")][-1:] == ["Push"]
    assert "Bare" not in [term.name for term in catalogue(robot(), tmp_path / "bare.py")]
    (sentence,) = unfittable(tmp_path / "bare.py")
    assert sentence.startswith("effect 'Bare' has no parameters and is not tried: declare one")
    assert unfittable(None) == ()


def sensitivity_of_own(file: Path, periods: int = 6) -> list[Column]:
    """Derivatives by the effect in a user's file."""
    data = Data([make_swim([], 9, periods)], np.ones(periods, dtype=bool))
    model = Model(robot(), (), NOISE)
    return sensitivities(model, catalogue(robot(), file)[-1:], data, lambda _done, _whole: None)


def test_a_method_of_a_users_effect_that_gives_nonsense_is_named() -> None:
    for hook, needed in (("fix", "is a Fix or None"), ("wrench", "are 3 finite numbers")):
        bad = type("Bad", (Effect,), {hook: lambda *_: "nonsense"})()
        with pytest.raises(InputError, match=f"effect 'Bad': {hook} gave 'nonsense', needed {needed}"):
            probes_of(robot()).responses(bad)
    bad = type("Bad", (Effect,), {"robot": lambda *_: "nonsense"})()
    with pytest.raises(InputError, match="effect 'Bad': robot gave 'nonsense', needed is a Robot or None"):
        changed_robot(robot(), [bad])


def test_a_promise_lowers_the_cost_within_bounds() -> None:
    rng = np.random.default_rng(2)
    jacobian = rng.normal(size=(40, 9, 2))
    residuals = rng.normal(0.0, 0.1, (40, 9)) - jacobian @ np.array([0.5, -2.0])
    damping = np.full(2, 1e-9)
    step, deviance = linearised_optimum(residuals, jacobian, np.full(2, -9.0), np.full(2, 9.0), damping)
    np.testing.assert_allclose(step, [0.5, -2.0], atol=0.05)
    fixed, dearer = linearised_optimum(
        residuals, jacobian, np.array([-9.0, -1.0]), np.array([9.0, 0.0]), damping
    )
    assert fixed[1] == -1.0 and dearer > deviance
