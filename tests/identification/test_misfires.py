"""Limbs that do nothing by chance and fixes that jump: how often, and which ones."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made import make_swim, robot
from tests.conftest import LEVEL, count, from_ci, some

from frogkick.effects import Fix
from frogkick.identification.jumps import jumped, jumps_of, turned, turns_of, without_jumps
from frogkick.identification.misfires import fitted_mixture, misfires_of, without_failed
from frogkick.identification.outcome import identify
from frogkick.identification.responses import responses_of
from frogkick.identification.search import nominal_fit
from frogkick.identification.segments import read_segments
from frogkick.identification.verdict import PARTLY
from frogkick.report.identify_figures import missing_terms_figure
from frogkick.robot import load_robot

GIVEN = Path(__file__).parents[3] / "shared" / "data" / "misfire"


def misfire(limb: str, chance: float) -> list[dict[str, object]]:
    failing = {"failing": {"value": chance, "unit": "1"}}
    return [{"name": "law", "on": "stroke", "limb": limb, "gain": "chance >= failing", "parameters": failing}]


def test_a_mixture_knows_how_often_and_when() -> None:
    rng = np.random.default_rng(1)
    fired = rng.random((120, 1)) < 0.8
    failed = fired & (rng.random((120, 1)) < 0.3)
    change = rng.normal([2e-3, -1e-3, 5e-2], 1e-3, (120, 3))[:, :, None]
    noise = rng.standard_t(4, (120, 3)) * [2e-4, 2e-4, 3e-3]
    found = fitted_mixture(noise - change[:, :, 0] * failed, change, fired)
    assert found.chance[0] == pytest.approx(failed.sum() / fired.sum(), abs=0.01)
    assert ((found.failed > 0.5) == failed).all()


@from_ci
@pytest.mark.parametrize(("limb", "chance"), some([("front_left", 0.3), ("rear_right", 0.2)], 1))
def test_the_limb_that_misfires_is_named(limb: str, chance: float) -> None:
    swims = [make_swim(misfire(limb, chance), seed, count(24, 36)) for seed in (1, 2, 3)]
    data, nominal = nominal_fit(swims, robot())
    found = misfires_of(nominal, data)
    assert found is not None and found.limbs == (limb,)
    low, high = found.chance[0].interval
    assert low - 0.05 < chance < high + 0.05 and found.stability[0] > 0.9
    fewer = without_failed(swims, found)
    gone = sum(len(swim.strokes) for swim in swims) - sum(len(swim.strokes) for swim in fewer)
    assert gone == sum(share > 0.5 for *_, share in found.failed[0])
    _, clean = nominal_fit(fewer, robot())
    ends, before = (np.sqrt((each.residuals[:, -3:-1] ** 2).sum(axis=1).mean()) for each in (clean, nominal))
    assert ends < 0.4 * before


@from_ci
def test_no_limb_misfires_where_none_does() -> None:
    worn = [{"name": "limb_wear", "limb": "rear_left", "gain": 0.7}]
    for effects in ([], worn):
        swims = [make_swim(effects, seed, 18) for seed in (1, 2, 3)]
        data, nominal = nominal_fit(swims, robot())
        found = misfires_of(nominal, data)
        assert found is None or (effects and found.chance[0].value > 0.4)


@from_ci
def test_one_stroke_that_fails_is_an_accident() -> None:
    at = {"at": {"value": 13.0, "unit": "s"}, "within": {"value": 0.75, "unit": "s"}}
    once = {"on": "stroke", "limb": "front_left", "gain": "1 - (abs(time_s - at) < within)", "parameters": at}
    swims = [
        make_swim([{"name": "law", **once}], 1, count(24, 36)),
        *(make_swim([], seed, count(24, 36)) for seed in (2, 3)),
    ]
    data, nominal = nominal_fit(swims, robot())
    assert misfires_of(nominal, data) is None


@from_ci
def test_a_limb_that_breaks_does_not_misfire() -> None:
    at = {"at": {"value": 15.0, "unit": "s"}}
    table = {"name": "law", "on": "stroke", "limb": "front_left", "gain": "time_s < at", "parameters": at}
    for effects, right in (([table], True), (misfire("front_left", 0.3), False)):
        swims = [make_swim(effects, seed, count(20, 30)) for seed in range(1, count(3, 4))]
        data, nominal = nominal_fit(swims, robot())
        responses = responses_of(nominal, data)
        found = misfires_of(nominal, data, responses.idle)
        assert found is None or found.patterned(responses.fired) == right


@pytest.mark.skipif(not GIVEN.is_dir() or LEVEL == "quick", reason="logs of a misfire; FK_LEVEL=ci")
def test_the_logs_of_a_misfire_are_partly_explained() -> None:
    named = load_robot("frog2022")
    names = ("line", "sine", "ellipse", "eight")[: count(2, 4)]
    *train, test = (read_segments(GIVEN / f"{name}.h5", named) for name in (*names, "bends"))
    outcome = identify(train, [test], named, laws=True)
    assert outcome.verdict == PARTLY
    (effect,) = outcome.as_json()["effects"]
    failing = effect["parameters"]["failing"]
    assert effect["limb"] == "front_left" and failing["interval"][0] < 0.3 < failing["interval"][1]
    assert outcome.tested.after == outcome.tested.before
    assert missing_terms_figure(outcome) is not None
    strokes = outcome.as_json()["residuals"]["strokes"]
    assert {each["limb"] for each in strokes if each["log_ratio"] < -10.0} == {"front_left"}


class Jumping:
    """A run whose places are a smooth curve with noise, some of them far off."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.swim = make_swim([], seed, 12)
        count = len(self.swim.time_s)
        self.off = rng.random(count) < 0.06
        way, pose = rng.uniform(0.0, 6.28, count), self.swim.pose.copy()
        pose[self.off, 0] += 6e-3 * np.cos(way[self.off])
        pose[self.off, 1] += 6e-3 * np.sin(way[self.off])
        self.swim = replace(self.swim, pose=pose)


def test_fixes_that_jump_are_told_by_their_neighbours() -> None:
    runs = [Jumping(seed) for seed in (1, 2)]
    found = jumps_of([run.swim for run in runs])
    assert found is not None
    planted = sum(int(run.off.sum()) for run in runs)
    right = sum(int(run.off[jumped(run.swim)[0]].sum()) for run in runs)
    reported = sum(len(jumped(run.swim)[0]) for run in runs)
    assert right >= 0.9 * planted and reported - right <= 0.1 * planted
    assert found.size.value == pytest.approx(6e-3, rel=0.1)
    kept = without_jumps([run.swim for run in runs])
    assert sum(len(swim.time_s) for swim in kept) == sum(len(run.swim.time_s) for run in runs) - reported
    effect = found.term.effect()
    rng = np.random.default_rng(0)
    moved = [effect.fix(Fix(0.0, 0.0, 0.0, 0.0, 0.0), rng) for _ in range(2000)]
    far = [np.hypot(fix.x_m, fix.y_m) for fix in moved if fix is not None]
    assert np.mean(np.array(far) > 1e-3) == pytest.approx(found.chance.value, abs=0.02)
    assert max(far) == pytest.approx(found.size.value)


@pytest.mark.parametrize(("length", "turn_rad"), [(1, 0.1), (3, 0.1), (1, 1.57), (1, 3.1)])
def test_headings_that_jump_are_told_by_their_neighbours(length: int, turn_rad: float) -> None:
    """One fix, a burst of them, or a tag that is taken for one turned by a quarter or by half."""
    swims, planted = [], []
    for seed in (1, 2):
        rng, swim = np.random.default_rng(seed), make_swim([], seed, 12)
        off = np.zeros(len(swim.time_s), dtype=bool)
        for first in np.flatnonzero(rng.random(len(off) - 20) < 0.04 / length) + 10:
            if not off[first - 4 : first].any():
                off[first : first + length] = True
        pose = swim.pose.copy()
        pose[off, 2] += turn_rad
        pose[:, 2] = np.unwrap(pose[:, 2])
        swims.append(replace(swim, pose=pose))
        (kept,) = without_jumps(swims[-1:], of_heading=True)
        left = np.isin(swim.time_s, kept.time_s)
        assert np.abs(kept.pose[:, 2] - swim.pose[left, 2]).max() < 0.12
        planted.append(off)
        assert turns_of([swim]) is None and not len(turned(swim)[0])
    found = turns_of(swims)
    assert found is not None and found.size.value == pytest.approx(turn_rad, rel=0.1)
    right = sum(int(off[turned(swim)[0]].sum()) for off, swim in zip(planted, swims, strict=True))
    reported = sum(len(turned(swim)[0]) for swim in swims)
    assert reported == right >= 0.7 * sum(int(off.sum()) for off in planted)
    assert sum(len(swim.time_s) for swim in without_jumps(swims, of_heading=True)) == sum(
        len(swim.time_s) - len(turned(swim)[0]) for swim in swims
    )
    effect, rng = found.term.effect(), np.random.default_rng(0)
    moved = [effect.fix(Fix(0.0, 0.0, 0.0, 0.0, 0.0), rng) for _ in range(2000)]
    turns = np.array([fix.heading_rad for fix in moved if fix is not None])
    assert np.mean(turns != 0.0) == pytest.approx(found.chance.value, abs=0.02)
    assert set(np.round(turns, 9)) == {0.0, *np.round([-found.size.value, found.size.value], 9)}


def test_no_fix_jumps_where_a_camera_is_moved_or_nothing_is_off() -> None:
    swim = make_swim([], 1, 12)
    assert jumps_of([swim]) is None
    pose = swim.pose.copy()
    for first in range(20, len(pose), 40):
        pose[first : first + 20, 0] += 6e-3
    assert jumps_of([replace(swim, pose=pose)]) is None
