"""Limbs that do nothing by chance are told from runs: which, how often, and at which strokes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from made import make_swim, robot
from tests.conftest import LEVEL, count

from frogkick.identification.misfires import fitted_mixture, misfires_of, without_failed
from frogkick.identification.outcome import identify
from frogkick.identification.search import nominal_fit
from frogkick.identification.segments import read_segments
from frogkick.identification.verdict import PARTLY
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


@pytest.mark.parametrize(("limb", "chance"), [("front_left", 0.3), ("rear_right", 0.2)])
def test_the_limb_that_misfires_is_named(limb: str, chance: float) -> None:
    swims = [make_swim(misfire(limb, chance), seed, count(24, 36)) for seed in (1, 2, 3)]
    _, rows, nominal = nominal_fit(swims, robot())
    found = misfires_of(nominal, swims, rows)
    assert found is not None and found.limbs == (limb,)
    _, low, high = found.chance[0]
    assert low - 0.05 < chance < high + 0.05 and found.stability[0] > 0.9
    fewer = without_failed(swims, found)
    gone = sum(len(swim.strokes) for swim in swims) - sum(len(swim.strokes) for swim in fewer)
    assert gone == sum(share > 0.5 for *_, share in found.failed[0])
    _, _, clean = nominal_fit(fewer, robot())
    ends, before = (np.sqrt((each.residuals[:, -3:-1] ** 2).sum(axis=1).mean()) for each in (clean, nominal))
    assert ends < 0.4 * before


def test_no_limb_misfires_where_none_does() -> None:
    worn = [{"name": "limb_wear", "limb": "rear_left", "gain": 0.7}]
    for effects in ([], worn):
        swims = [make_swim(effects, seed, 18) for seed in (1, 2, 3)]
        _, rows, nominal = nominal_fit(swims, robot())
        found = misfires_of(nominal, swims, rows)
        assert found is None or (effects and found.chance[0][0] > 0.4)


@pytest.mark.skipif(not GIVEN.is_dir() or LEVEL == "quick", reason="logs of a misfire; FK_LEVEL=ci")
def test_the_logs_of_a_misfire_are_partly_explained() -> None:
    named = load_robot("frog2022")
    every = [
        read_segments(GIVEN / f"{name}.h5", named) for name in ("line", "sine", "ellipse", "eight", "bends")
    ]
    outcome = identify(every[:4], every[4:], named, laws=True)
    assert outcome.verdict == PARTLY
    (effect,) = outcome.as_json()["effects"]
    failing = effect["parameters"]["failing"]
    assert effect["limb"] == "front_left" and failing["interval"][0] < 0.3 < failing["interval"][1]
    assert outcome.tested.after == outcome.tested.before
