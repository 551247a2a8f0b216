"""The default table: of which kind and size it is, and that it is accurate where the planner leads."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from tests.conftest import count, from_ci
from tests.identification.made import robot

from frogkick.core.progress import Tell
from frogkick.library import default_table, error_on, fit_table, quantise, read_library, sample_library
from frogkick.library.fitting import BUDGET_BYTES, WHOLE_MIN
from frogkick.robot import Robot, load_robot
from frogkick.tables.image import open_image

titles: list[str] = []


@contextmanager
def stage(title: str) -> Iterator[Tell]:
    titles.append(title)
    yield lambda _done, _whole, /, note="": None


def made(folder: Path, swimmer: Robot, states: int, seed: int = 0) -> bytes:
    return default_table(swimmer, folder / "library.h5", stage, "library", states, seed)


@from_ci
def test_it_is_affine_and_of_states_that_the_planner_leads_to(tmp_path: Path) -> None:
    """And errs there at most half as much as a nearest table of the same library, in place and in heading."""
    titles.clear()
    drawn = load_robot("frog2022")
    image = made(tmp_path, drawn, count(100, 300))
    assert titles == ["library", "tables tried"]
    library = read_library(tmp_path / "library.h5")
    assert library.sampling == "planned" and library.seed == 0
    tables = open_image(image)
    assert tables.kind == "affine" and len(image) <= BUDGET_BYTES
    assert tables.provenance == library.content_sha256()
    assert image == fit_table(library).image == fit_table(library, "affine").image
    unseen = sample_library(drawn, 64, 9, "planned")
    affine, nearest = error_on(tables, unseen), error_on(open_image(quantise(library)), unseen)
    assert affine["position_m"] < 0.5 * nearest["position_m"]
    assert affine["heading_rad"] < 0.5 * nearest["heading_rad"]


def test_a_library_that_is_too_small_for_an_affine_table_gives_a_nearest_one(tmp_path: Path) -> None:
    image = made(tmp_path, robot(), 5, 3)
    library = read_library(tmp_path / "library.h5")
    assert library.seed == 3 and image == quantise(library)
    assert open_image(image).kind == "nearest" and len(open_image(image).states) == 5


@from_ci
def test_it_is_the_table_of_commands_that_are_given_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """``fk.load_table()`` and the demo make the same one of a robot."""
    import frogkick as fk
    from frogkick.ring import make_tables

    monkeypatch.setenv("FROGKICK_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr("frogkick.front.tables.STATES", WHOLE_MIN)
    few = robot()
    few.save(tmp_path / "own.toml")
    kept = fk.load_table(robot=str(tmp_path / "own.toml"))
    ours = make_tables(few, tmp_path, WHOLE_MIN, 0, stage, "library")
    assert kept.kind == "affine" and np.array_equal(kept.tables.states, open_image(ours.read_bytes()).states)
