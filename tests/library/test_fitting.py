"""Tables fitted to a library: within their bytes, better with more of them, and as wrong as they say."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.conftest import count, from_ci, some
from tests.library.synthetic import ACTIONS, LIMBS, ROBOT, SIZE, Known

from frogkick.core.errors import InputError
from frogkick.library import Library, error_on, fit_table, fitting, quantise
from frogkick.library.fitting import looked_up
from frogkick.library.surface import History
from frogkick.library.transitions import HISTORY, RESTED, Failed
from frogkick.tables.image import Tables, open_image

EFFECT = np.random.default_rng(5).uniform(-0.1, 0.1, (ACTIONS, LIMBS, 6)) * SIZE
PLAIN = Known(1, 3)
TIRING = Known(1, 3, History(EFFECT, 0.4, 0.6))
SAMPLES_LEAST = count(8192, 8192, 1024)
SAMPLES_A_CELL = count(64, 64, 16)


@pytest.fixture(scope="module", autouse=True)
def samples() -> Iterator[None]:
    """How many a division is made of: for each cell, and at least and at most."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fitting, "_SAMPLES_A_CELL", SAMPLES_A_CELL)
        patch.setattr(fitting, "_SAMPLES", (SAMPLES_LEAST, 131_072))
        yield


@pytest.fixture(scope="module")
def plain() -> Library:
    return PLAIN.library(300, 2)


@pytest.fixture(scope="module")
def tiring() -> Library:
    return TIRING.library(300, 2)


fitted = functools.cache(fit_table)
"""For tests that look at the same table."""


def by_hand(tables: Tables, library: Library) -> np.ndarray:
    """(n, a, 6) what a table says, straight from its layout, with numpy's integers."""
    velocities = library.initial_velocity_body.astype(np.float32) * (np.float32(1.0) / tables.velocity_scale)
    codes = np.copysign(np.floor(np.abs(velocities) + 0.5), velocities).astype(np.int64)
    states, limit = tables.states.astype(np.int64), tables.offset_limit
    inside = np.clip(codes, states.min(axis=0) - limit, states.max(axis=0) + limit)
    apart = ((inside[:, None, :] - states) ** 2).sum(axis=2)
    rows = apart.argmin(axis=1)
    reported = tables.transitions[rows].astype(np.int64)
    if tables.kind == "affine":
        offset = np.clip(codes - states[rows], -limit, limit)
        rise = np.einsum("navx,nx->nav", tables.derivatives[rows].astype(np.int64), offset)
        reported = reported + ((rise + ((1 << tables.correction_shift) >> 1)) >> tables.correction_shift)
        masks = [row.first_mask | row.second_mask for row in tables.actions]
        fires = np.array([[mask >> limb & 1 for limb in range(LIMBS)] for mask in masks])
        use = np.zeros((len(codes), LIMBS), dtype=np.int64)
        for place in range(HISTORY - 1, -1, -1):
            before = library.previous_actions[:, place]
            gained = np.where((before == RESTED)[:, None], 0, fires[before] * tables.use_gain)
            use = np.minimum((use * tables.use_decay >> 15) + gained, 32767)
        reported = reported + (np.einsum("alv,nl->nav", tables.history.astype(np.int64), use) >> 15)
    most = np.concatenate([tables.motion_limit, [16383] * 3])
    scale = np.concatenate([tables.motion_scale, tables.velocity_scale]).astype(np.float64)
    return np.asarray(np.clip(reported, -most, most) * scale)


@pytest.mark.parametrize(
    ("kind", "budget"),
    some([("nearest", 2100), ("nearest", 3001), ("affine", 4097), ("affine", 16_001)], 2),
)
def test_a_budget_is_kept_and_used(tiring: Library, kind: str, budget: int) -> None:
    found = fit_table(tiring, kind, budget)
    assert found.kind == kind
    tables = open_image(found.image)
    assert tables.kind == kind
    assert 0.94 * budget < len(found.image) <= budget
    assert tables.provenance == tiring.content_sha256()
    assert tables.robot_id == ROBOT.id


@pytest.mark.parametrize("kind", ["nearest", "affine"])
def test_the_error_is_that_of_looking_up_by_hand(tiring: Library, kind: str) -> None:
    unseen = TIRING.library(70, 9)
    tables = open_image(fit_table(tiring, kind, 4000).image)
    gap = by_hand(tables, unseen) - unseen.rows()
    turn = np.arctan2(np.sin(gap[..., 2]), np.cos(gap[..., 2]))
    reported = error_on(tables, unseen)
    assert reported["position_m"] == pytest.approx(
        np.sqrt((gap[..., 0] ** 2 + gap[..., 1] ** 2).mean()), rel=1e-5
    )
    assert reported["heading_rad"] == pytest.approx(np.sqrt((turn**2).mean()), rel=1e-5)
    assert reported["velocity_mps"] == pytest.approx(
        np.sqrt((gap[..., 3:5] ** 2).sum(axis=2).mean()), rel=1e-5
    )
    assert reported["omega_rad_s"] == pytest.approx(np.sqrt((gap[..., 5] ** 2).mean()), rel=1e-5)
    found = looked_up(tables, unseen.initial_velocity_body, unseen.previous_actions)
    assert found == pytest.approx(by_hand(tables, unseen), abs=1e-7)


def test_affine_errs_less_than_all_states_and_less_with_more_bytes(plain: Library) -> None:
    unseen = PLAIN.library(200, 9)
    whole = error_on(open_image(quantise(plain)), unseen)
    images = [fitted(plain, "affine", budget).image for budget in (4000, 8000, 16_000)]
    errors = [error_on(open_image(image), unseen) for image in images]
    for name in ("position_m", "heading_rad"):
        assert whole[name] > 1.3 * errors[0][name]
        assert errors[0][name] > 1.4 * errors[1][name] > 1.7 * errors[2][name]


def test_what_is_held_out_tells_what_unseen_states_will(plain: Library) -> None:
    unseen = PLAIN.library(300, 9)
    for kind in ("nearest", "affine"):
        found = fitted(plain, kind, 4000)
        reported = error_on(open_image(found.image), unseen)
        for name, value in reported.items():
            assert found.held_out[name] == pytest.approx(value, rel=0.35)


@from_ci
def test_limb_use_as_an_input_lowers_the_error(tiring: Library) -> None:
    unseen = TIRING.library(200, 9)
    with_use = open_image(fit_table(tiring, "affine", 16_000).image)
    assert (with_use.use_decay, with_use.use_gain) == (round(0.4 * 32768), round(0.6 * 32768))
    assert with_use.history.any()
    rested = replace(tiring, previous_actions=np.full_like(tiring.previous_actions, RESTED))
    without = open_image(fit_table(rested, "affine", 16_000).image)
    assert not without.history.any()
    for name in ("position_m", "heading_rad"):
        assert error_on(with_use, unseen)[name] < 0.3 * error_on(without, unseen)[name]


@from_ci
def test_the_better_kind_is_taken_where_none_is_named(plain: Library) -> None:
    both = {kind: fitted(plain, kind, 4000).score for kind in ("nearest", "affine")}
    assert both["affine"] < both["nearest"]
    assert fit_table(plain, None, 4000).image == fitted(plain, "affine", 4000).image
    tight = fit_table(plain, None, 1400)  # less than a table of kind "nearest" takes
    assert tight.kind == "affine"


def test_nearest_with_room_for_all_is_the_library(plain: Library) -> None:
    whole = quantise(plain)
    assert fit_table(plain, "nearest", len(whole)).image == whole
    assert fit_table(plain, "nearest").image == whole
    few = PLAIN.library(45, 2)
    assert fit_table(few).image == quantise(few), "too few for an affine one"
    less = fit_table(plain, "nearest", len(whole) - 1)
    assert len(less.image) < len(whole)


def test_failed_transitions_are_left_out(plain: Library) -> None:
    hurt = replace(
        plain,
        displacement_body=plain.displacement_body.copy(),
        failed=(Failed(3, 1, "made up"), Failed(7, 0, "made up")),
    )
    hurt.displacement_body[3, 1] = hurt.displacement_body[7, 0] = np.nan
    for kind in ("nearest", "affine"):
        image = fit_table(hurt, kind, 3000).image
        assert error_on(open_image(image), PLAIN.library(50, 9))["position_m"] < 0.02


def test_the_same_library_gives_the_same_bytes(plain: Library) -> None:
    seen: list[tuple[int, int]] = []
    again = fit_table(plain, "affine", 4000, lambda done, whole: seen.append((done, whole)))
    assert again.image == fitted(plain, "affine", 4000).image
    assert seen[0][0] == 0 and seen[-1][0] == seen[-1][1] > 0
    assert seen == sorted(seen)


def test_bad_requests_are_refused(plain: Library, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"'affin'.*affine"):
        fit_table(plain, "affin")
    for kind in ("nearest", "affine"):
        with pytest.raises(InputError, match=r"300 bytes.*smallest has \d+: give --budget-kib") as caught:
            fit_table(plain, kind, 300)
        enough = float(str(caught.value).split("--budget-kib ")[1].split(" ")[0])
        assert len(fit_table(plain, kind, int(enough * 1024)).image) <= enough * 1024
    for kind in ("affine", "nearest"):
        with pytest.raises(InputError, match=r"45 complete states.*takes 46: build it with more --states"):
            fit_table(PLAIN.library(45, 2), kind, 2000)  # less than all states take
    assert open_image(fit_table(PLAIN.library(46, 2), "affine").image).kind == "affine"
