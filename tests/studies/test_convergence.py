"""The convergence study: its arithmetic, and that the default step keeps its limit."""

from __future__ import annotations

import json

import numpy as np
import pytest
from tests.conftest import count, from_ci

from frogkick.cli.main import run_command
from frogkick.der import STEP_S
from frogkick_studies.convergence import ERROR_LIMIT, STEPS_S, Curve


def test_a_made_curve_gives_its_own_order() -> None:
    steps = np.array(STEPS_S)
    curve = Curve("made", steps, 3.0 * steps**2, 6.0 * steps**2)
    assert curve.order == pytest.approx(2.0)
    assert curve.at_default == pytest.approx(3.0 * STEP_S**2)


@from_ci
def test_second_order_and_the_limit_at_the_default_step(
    capsys: pytest.CaptureFixture[str], tmp_path_factory: pytest.TempPathFactory
) -> None:
    picture = tmp_path_factory.mktemp("convergence") / "order.png"
    asked = ["study", "convergence", "--json", "--out", str(picture), "--every", str(count(18, 1))]
    assert run_command(asked) == 0
    output = json.loads(capsys.readouterr().out)
    assert 1.7 < output["order"]["strokes"] < 2.3
    # Below 0.1 % what is left is the phase of the frame's 40 Hz swing, of second order only from 0.4 ms on.
    assert 1.3 < output["order"]["gaits"] < 2.3
    for kind in ("strokes", "gaits"):
        assert output["error_at_default"][kind] < 0.5 * ERROR_LIMIT
        assert output["worst"][kind][str(STEP_S)] < ERROR_LIMIT
    assert picture.read_bytes().startswith(b"\x89PNG")
