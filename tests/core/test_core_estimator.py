"""The estimator: C against its Python twin bit for bit, and what it does with each kind of fix."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from tests.conftest import count, from_ci, some
from tests.core.core import (
    ACTION_ROWS,
    COVERAGE_DIR,
    FFI,
    PERIOD_US,
    RESTING,
    STATUS,
    library,
    mutated,
)
from tests.core.estimator_rig import (
    ESTIMATOR_BYTES_MAX,
    CEstimator,
    Twin,
    answers,
    follow,
    on_time,
    stream,
    swim,
)

from frogkick.estimator.wear import ON

WEAR_FLOATS = 28 + 7 + 3 + 4
"""What is learned of four limbs: the sums, the current, the shares."""

PLANTED_LIVES = 6000
"""In so many lives each planted mutation is found; most take one, the rarest 2600."""

RARE = (214, 614)
"""Lives in which a current is not believed, because limbs would then have lost less than nothing."""


@from_ci
def test_the_twin_gives_the_same_bits() -> None:
    # Where gcov counts, fewer lives than sixty have not every answer.
    lives = PLANTED_LIVES // 100 if COVERAGE_DIR else count(PLANTED_LIVES // 2, 200_000, 500)
    seen: dict[object, int] = {}
    restarts = 0
    named: list[bool] = []
    for seed in (*range(lives), *RARE):
        life = stream(seed)
        twin = Twin(life.table)
        ours, theirs = answers(life, CEstimator(life.table)), answers(life, twin)
        assert ours == theirs, f"replay with answers(stream({seed}), ...)"
        for said in ours[:-1]:
            assert isinstance(said, tuple)
            kind = said if said[0] == "fix" else (said[0], said[1] is None)
            seen[kind] = seen.get(kind, 0) + 1
        inside = ours[-1]
        assert isinstance(inside, tuple)
        assert np.isfinite(np.frombuffer(inside[0], dtype=np.float32)).all()
        restarts += inside[1][2]
        if life.table == "worn" and (wear := twin._twin.track.wear) is not None:
            named.append(bool(wear.codes.any()))
    # Limbs that have lost much are learned in these lives, or the bits would say nothing of it.
    assert sum(named) > len(named) // 4 > 0
    statuses = {("fix", STATUS[name]) for name in ("OK", "RANGE", "DOUBLE", "OLD", "OUTLIER")}
    assert set(seen) == statuses | {("at", True), ("at", False)}
    assert min(seen.values()) > lives // 60 and restarts > lives // 60, f"some answer hardly occurred: {seen}"


MUTATIONS = {
    "order of the weighted sum": ("fk_profile.c", "(weights[0] * values[0] + weights[1] * values[1]) +",
                                  "(weights[1] * values[1] + weights[2] * values[2]) +"),
    "stroke's end": ("fk_profile.c", "x <= fire", "x < 0.9f * fire"),
    "glide": ("fk_profile.c", "#define FK_GLIDE_PART 0.41666667f", "#define FK_GLIDE_PART 0.41666670f"),
    "most that limbs fire": ("fk_profile.c", "FK_FIRE_MOST 0.5f", "FK_FIRE_MOST 0.51f"),
    "independent process noise": ("fk_covariance.c", "FK_NOISE_APART 0.2f", "FK_NOISE_APART 0.21f"),
    "process noise at rest": ("fk_covariance.c", "(resting != 0) ?", "(resting == 0) ?"),
    "common shape": ("fk_covariance.c", "FK_SHAPE_COMMON 0.3f", "FK_SHAPE_COMMON 0.31f"),
    "an unknown pose": ("fk_estimator.h", "FK_FIX_UNKNOWN_US 10000000u", "FK_FIX_UNKNOWN_US 9999999u"),
    "what a period must reduce": ("fk_covariance.c", "FK_INFORMED 0.5f", "FK_INFORMED 0.9f"),
    "the largest ratio": ("fk_covariance.c", "FK_RATIO_MOST 9.0f", "FK_RATIO_MOST 8.0f"),
    "least process noise": ("fk_covariance.c", "9e-8f, 3.6e-3f", "9e-6f, 3.6e-3f"),
    "inflation": ("fk_covariance.c", "FK_NOISE_INFLATION 4.0f", "FK_NOISE_INFLATION 3.0f"),
    "gate": ("fk_covariance.c", "FK_GATE 25.0f", "FK_GATE 24.0f"),
    "weight of a period": ("fk_track.c", "0.25f, 0.2f}", "0.25f, 0.25f}"),
    "coasting": ("fk_track.h", "FK_COAST_US 200000u", "FK_COAST_US 199999u"),
    "shortest period": ("fk_track.h", "FK_PERIOD_LEAST_US 50000u", "FK_PERIOD_LEAST_US 50001u"),
    "coasts": ("fk_track.h", "FK_TRACK_COASTS_MAX 8u", "FK_TRACK_COASTS_MAX 7u"),
    "current period": ("fk_track.c", "from > 0u && at_us < track->time_us[from]",
                         "from > 0u && at_us <= track->time_us[from]"),
    "learning from an unknown state": ("fk_track.c", "track->prediction_valid != 0u && track", "track"),
    "learning twice from a period": ("fk_track.c", "track->prediction_valid = 0u; /* once", "/* once"),
    "fading": ("fk_wear.c", "FK_WEAR_FADING 0.96f", "FK_WEAR_FADING 0.961f"),
    "penalty": ("fk_wear.c", "FK_WEAR_PENALTY 9.0f", "FK_WEAR_PENALTY 8.0f"),
    "outlier": ("fk_wear.c", "FK_WEAR_OUTLIER 8.0f", "FK_WEAR_OUTLIER 10.0f"),
    "a current that fades as limbs do": ("fk_wear.c", "(i < 3u) ? FK_WEAR_FADING : kept;", "kept;"),
    "what limbs explain": (
        "fk_wear.c", "(FK_WEAR_FADING - kept) * explained_by_limbs(", "0.0f * explained_by_limbs(",
    ),
    "secant": ("fk_wear.c", "FK_WEAR_SECANT 22937u", "FK_WEAR_SECANT 22938u"),
    "what tells that a limb does nothing": ("fk_wear.c", "FK_WEAR_GONE_BY 1.0f", "FK_WEAR_GONE_BY 3.0f"),
    "limbs that stay gone": ("fk_wear.c", "(was_gone != 0) ? -FK_WEAR_GONE_BY :", "(was_gone != 0) ? 0.0f :"),
    "a limb that misfires once": ("fk_wear.c", "before[limb] > 0u && wear", "wear"),
    "others that are worn as well": ("fk_wear.c", "left[axis] = left[axis] - changes[axis];",
                                     "left[axis] = left[axis] - 0.5f * changes[axis];"),
    "least share": ("fk_wear.c", "FK_WEAR_LEAST 0.02f", "FK_WEAR_LEAST 0.2f"),
    "largest share": ("fk_wear.c", "FK_WEAR_MOST 1.3f", "FK_WEAR_MOST 1.2f"),
    "limbs that cannot be separated": ("fk_wear.c", "FK_WEAR_APART 1e-3f", "FK_WEAR_APART 0.5f"),
    "limbs that others make implausible": ("fk_wear.c", "|| !are_plausible(normal, at, 1u, &value)", ""),
    "when all limbs are meant": ("fk_wear.c", "FK_WEAR_COMMON_BY 9.0f", "FK_WEAR_COMMON_BY 12.0f"),
    "the most that all limbs lose": ("fk_wear.c", "FK_WEAR_COMMON_MOST 0.6f", "FK_WEAR_COMMON_MOST 0.5f"),
    "a current that makes all limbs implausible": ("fk_wear.c", "|| common > FK_WEAR_COMMON_MOST", ""),
    "what a limb has lost beyond all": ("fk_wear.c", "at, 1u, &value) + value;", "at, 1u, &value);"),
    "one limb or all": ("fk_wear.c", "(normal->chosen >> 3u) == 0u", "normal->chosen == 0u"),
    "a current that makes limbs implausible": ("fk_wear.c", "!are_plausible(normal, 0u, 3u, value)", "0"),
    "the better of two limbs": ("fk_wear.c", "if (gain > most) {", "if (gain > FK_WEAR_PENALTY) {"),
    "a current first": ("fk_wear.c", "(normal->chosen & 1u) == 0u", "normal->chosen == 0u"),
    "the rest of a current": ("fk_wear.c", "eliminate(normal, 2u);", ""),
    "limbs held": ("fk_wear.c", "wear->learn != FK_LEARN_ON ||", "wear->learn == FK_LEARN_OFF ||"),
    "what a period must reduce to learn of limbs": ("fk_covariance.c", "left <= (1.0f -", "left <= (0.9f -"),
    "turns": ("fk_track.c", "[2u * i] -= turns_rad;", "[2u * i] -= 0.5f * turns_rad;"),
    "duplicate fixes": ("fk_estimator.c", "estimator->marks[i] == mark", "estimator->marks[i] == mark + 1u"),
    "marks": ("fk_estimator.h", "FK_FIX_MARKS 64u", "FK_FIX_MARKS 8u"),
    "fixes that agree": ("fk_estimator.h", "FK_OUTLIERS_AGREE_M 0.02f", "FK_OUTLIERS_AGREE_M 0.05f"),
    "the earliest first": ("fk_estimator.c", "outliers[i].capture_us < estimator->outliers[first]",
                           "outliers[i].capture_us > estimator->outliers[first]"),
    "stale": ("fk_estimator.h", "FK_FIX_STALE_US 500000", "FK_FIX_STALE_US 499999"),
    "future": ("fk_estimator.h", "FK_FIX_FUTURE_US 100000", "FK_FIX_FUTURE_US 99999"),
    "field": ("fk_estimator.c", "value >= -limit && value <= limit", "value > -limit && value < limit"),
}  # fmt: skip


@pytest.mark.parametrize("name", some(list(MUTATIONS)[:: count(3, 1)], 3))
def test_a_changed_estimator_is_not_the_twin(name: str) -> None:
    changed = library(mutated(*MUTATIONS[name]))
    for seed in range(PLANTED_LIVES):
        life = stream(seed)
        if answers(life, CEstimator(life.table, changed)) != expected(seed):
            return
    pytest.fail(f"an estimator with another {name} gave the twin's answers {PLANTED_LIVES} times")


@cache
def expected(seed: int) -> list[object]:
    """Results of the unchanged C, which the test above has compared with the Python."""
    life = stream(seed)
    return answers(life, CEstimator(life.table))


@pytest.mark.parametrize("value", [np.nan, np.inf, 30.0])
def test_a_period_whose_end_is_nowhere_is_not_learned_from(value: float) -> None:
    """The pose at a period's end is not a number, or metres from where the robot can be."""
    given = swim(3, 4, kick=0.0, name="worn")
    ours, theirs = CEstimator("worn"), Twin("worn")
    for made in (ours, theirs):
        made.learn(ON)
        follow(given, on_time(given), made)
        for number, (time_us, pose) in enumerate(given.fixes):
            made.add(time_us, pose, number)  # those of the last period are new
        made.at(given.starts_us[-1] + PERIOD_US)
        made.spoil(0, value)
        before = made.inside()[0][-4 * WEAR_FLOATS :]
        made.act(given.starts_us[-1] + PERIOD_US, RESTING)
        assert made.inside()[0][-4 * WEAR_FLOATS :] == before
    assert ours.inside() == theirs.inside()


def test_a_period_for_which_the_table_has_no_row_is_not_learned_from() -> None:
    given = swim(3, 6, kick=1.0, name="worn")
    given.actions[:] = [len(ACTION_ROWS)] * len(given.actions)
    ours, theirs = CEstimator("worn"), Twin("worn")
    for made in (ours, theirs):
        made.learn(ON)
        follow(given, on_time(given), made)
        assert not np.frombuffer(made.inside()[0], dtype=np.float32)[-WEAR_FLOATS:].any()
    assert ours.inside() == theirs.inside()


def test_it_is_small() -> None:
    assert FFI.sizeof("fk_estimator_t") < ESTIMATOR_BYTES_MAX
