"""Wear curves: what a limb that wears takes from the transitions of the actions that fire it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.conftest import from_ci
from tests.library import synthetic

from frogkick.core.errors import InputError
from frogkick.effects import rods_of
from frogkick.library import library_info, quantise, read_library, wear, write_library
from frogkick.library.store import Library
from frogkick.library.surface import noise_of
from frogkick.library.wear import GAINS, no_curves, wear_curves
from frogkick.robot import load_robot
from frogkick.tables.image import open_image
from frogkick.tables.layout import WEAR_KNOTS

VELOCITY = np.array([[0.0, 0.0, 0.0], [0.02, 0.004, 0.2], [0.02, -0.004, -0.2]])


@pytest.fixture(scope="module")
def curves() -> np.ndarray:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(wear, "GAINS", GAINS)  # all of them, see conftest.py
        return wear_curves(rods_of(load_robot("frog2022")), VELOCITY)


@from_ci
def test_each_limb_loses_more_and_more_of_its_own_contribution(curves: np.ndarray) -> None:
    robot = load_robot("frog2022")
    names = [limb.name for limb in robot.limbs]
    scaled = curves / noise_of(robot)
    for limb in range(4):
        shares = scaled[limb] @ scaled[limb, -1] / (scaled[limb, -1] @ scaled[limb, -1])
        assert shares == pytest.approx(np.arange(1, WEAR_KNOTS + 1) / WEAR_KNOTS, abs=1e-9)
    assert (curves[:, -1, 0] < -0.003).all()  # a lost limb: several millimetres less forward
    side = np.array([1.0, -1.0, -1.0, 1.0, -1.0, -1.0])
    for pair in ("front", "rear"):  # the robot is symmetric, and so are its losses
        left, right = (names.index(f"{pair}_{side}") for side in ("left", "right"))
        assert curves[left] == pytest.approx(curves[right] * side, abs=1e-6)


def test_a_limb_that_no_action_fires_has_no_loss() -> None:
    robot = load_robot("frog2022")
    actions = tuple(action for action in robot.actions if action.name in "GI")
    some = replace(rods_of(robot), robot=replace(robot, actions=actions))
    found = wear_curves(some, VELOCITY)
    fired = [bool(actions[0].first_mask >> limb & 1) for limb in range(4)]
    assert [bool(curve.any()) for curve in found] == fired


@from_ci
def test_a_library_file_and_its_table_carry_the_curves(curves: np.ndarray, tmp_path: Path) -> None:
    plain = synthetic.Known(1, 1).library(40, 1)
    library = replace(plain, limb_wear=curves)
    assert library.content_sha256() != plain.content_sha256()
    for each, knots in ((plain, 0), (library, WEAR_KNOTS)):
        write_library(each, tmp_path / "library.h5")
        again = read_library(tmp_path / "library.h5")
        assert np.array_equal(again.limb_wear, each.limb_wear)
        assert library_info(tmp_path / "library.h5")["wear_curves"] == len(each.limb_wear)
        tables = open_image(quantise(again))
        assert tables.limb_wear.shape == (4, knots, 6)
        scale = np.concatenate([tables.motion_scale, tables.velocity_scale])
        error = tables.limb_wear * scale - each.limb_wear.reshape(4, knots, 6)
        assert (np.abs(error) <= 0.5001 * scale).all()


def test_a_file_with_damaged_curves_is_refused(tmp_path: Path) -> None:
    library: Library = synthetic.Known(1, 1).library(40, 1)
    for wrong in (np.zeros((3, WEAR_KNOTS, 6)), np.full((4, WEAR_KNOTS, 6), np.nan)):
        write_library(replace(library, limb_wear=wrong), tmp_path / "library.h5")
        with pytest.raises(InputError, match="limb_wear has shape"):
            read_library(tmp_path / "library.h5")
    assert not no_curves().size
