"""Once round the ring: every stage leaves its file, and the numbers agree."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.conftest import count, from_ci
from tests.identification.made import robot

from frogkick import ring as closing_module
from frogkick import ring as ring_module
from frogkick.cli.main import run_command
from frogkick.core.progress import progress_bar
from frogkick.identification import choice as choice_module
from frogkick.identification import outcome as outcome_module
from frogkick.identification import segments as segments_module
from frogkick.identification.outcome import Outcome, identify
from frogkick.identification.segments import Segments
from frogkick.identification.terms import catalogue
from frogkick.library import library_info
from frogkick.library.fitting import WHOLE_MIN
from frogkick.report import identify_page, ring_page
from frogkick.report.ring_page import write_ring_report
from frogkick.ring import Ring, adapt, draw_wear, run_demo
from frogkick.robot import load_robot
from frogkick.runs.runlog_file import read_run
from frogkick.runs.summary import lost_of
from frogkick.tables.image import read_image

SWUM_S = float(count(17, 17, 14))


@pytest.fixture(scope="module")
def round_once(tmp_path_factory: pytest.TempPathFactory) -> tuple[Ring, Path, list[str]]:
    """A small ring, with the least library that gives an affine table; its folder, and what is in that."""
    out = tmp_path_factory.mktemp("ring")
    ring = run_demo(robot(), out, WHOLE_MIN, 1, 3, progress_bar, paths=("line", "sine"), time_limit_s=SWUM_S)
    return ring, out, sorted(path.name for path in out.iterdir())


@from_ci
def test_the_ring_leaves_every_stage_behind(round_once: tuple[Ring, Path, list[str]]) -> None:
    ring, out, left = round_once
    assert left == ["emitted", "firmware", "library.h5", "line.h5", "sine.h5", "tables.fkt"]
    assert library_info(out / "library.h5")["states"] == WHOLE_MIN == ring.states
    assert ring.tables.kind == "affine"
    assert read_image(out / "tables.fkt").crc32 == ring.tables.crc32
    log = read_run(out / "line.h5")
    assert log.seed == 3 and log.table_crc == ring.tables.crc32
    assert [run.mismatches for run in ring.runs] == [0, 0]
    assert ring.chip.passed and ring.built.flash_bytes > len(ring.tables.image)
    assert ring.mean_distance_m == np.mean([run.tracking.mean_distance_m for run in ring.runs])
    assert ring.prediction_error.count == sum(len(run.gap_body) for run in ring.runs) > 0
    assert {"library, tables", "C, firmware", "swim the line"} <= ring.stage_s.keys()


@from_ci
def test_a_ring_that_tells_too_little_says_so(
    round_once: tuple[Ring, Path, list[str]], tmp_path: Path
) -> None:
    ring = replace(round_once[0], options=replace(round_once[0].options, time_limit_s=4.0))
    adapt(ring, tmp_path, 3, progress_bar)  # far too few periods to learn from
    adaptation = ring.adaptation
    assert adaptation is not None and adaptation.outcome.verdict == "not enough data" and not adaptation.new
    reported = adaptation.as_json()
    assert reported["horizons"] == [] and reported["before"] == reported["after"]
    assert np.isnan(reported["changed_robot"]["mean_distance_after_m"]) and not (tmp_path / "new").exists()
    write_ring_report(tmp_path / "report.html", ring)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "not enough data (no effect)" in page and "were not changed" in page


@from_ci
def test_the_ring_closes(
    round_once: tuple[Ring, Path, list[str]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A limb wears, which nobody tells the model: logs tell it, and new firmware swims knowing it."""
    true_effect = draw_wear(robot(), 3)
    names = ("limb_wear " + true_effect["limb"], "warm_up")
    few = [term for term in catalogue(robot()) if term.title in names]
    given: list[Sequence[Segments]] = []

    def watched(train: Sequence[Segments], test: Sequence[Segments], *more: Any, **options: Any) -> Outcome:
        given.extend((train, test))
        return identify(train, test, *more, **options)

    monkeypatch.setattr(outcome_module, "catalogue", lambda *_: few)
    monkeypatch.setattr(choice_module, "calibrated_starts", lambda _robot: {})
    monkeypatch.setattr(segments_module, "PERIODS_LEAST", count(20, 20, 16))
    monkeypatch.setattr(closing_module, "identify", watched)
    ring = replace(round_once[0])
    adapt(ring, tmp_path, 3, progress_bar)
    adaptation = ring.adaptation
    assert adaptation is not None and adaptation.true_effect == true_effect
    assert [swim.name for swim in given[0]] == ["worn-line.h5", "worn-sine.h5"]
    assert [swim.name for swim in given[1]] == ["worn-bends.h5"]
    assert read_run(tmp_path / "worn-line.h5").truth is None
    reported = adaptation.as_json()
    assert reported["verdict"] == "found" and [each["limb"] for each in reported["found"]] == [
        true_effect["limb"]
    ]
    gain = reported["found"][0]["parameters"]["gain"]
    assert abs(gain["value"] - true_effect["gain"]) < 0.05
    before, after, floor = (reported[key]["position_rmse_m"] for key in ("before", "after", "noise_floor"))
    assert after < 0.5 * before and 0.3 * after < floor < before
    assert [row["periods"] for row in reported["horizons"]] == [1, 2, 3, 5]
    assert reported["before"]["periods"] == reported["horizons"][0]["count"]
    every = adaptation.old, adaptation.learned, adaptation.new
    assert [len(runs) for runs in every] == [2, 2, 2]
    old, learned, new = (adaptation.distance_m(runs) for runs in every)
    assert reported["changed_robot"] == {
        "mean_distance_before_m": old,
        "mean_distance_learning_m": learned,
        "mean_distance_after_m": new,
    }
    assert old != new and [lost_of(run) is None for run in (*adaptation.old, *adaptation.learned)] == [
        True,
        True,
        False,
        False,
    ]
    new_tables = read_image(tmp_path / "new" / "tables.fkt")
    assert new_tables.kind == "affine"
    assert library_info(tmp_path / "new" / "library.h5")["states"] == WHOLE_MIN
    assert new_tables.crc32 != ring.tables.crc32 and adaptation.new[0].table_crc == new_tables.crc32
    assert [effect["name"] for effect in load_robot(tmp_path / "found.toml").effects] == ["limb_wear"]
    monkeypatch.setattr(ring_module, "run_demo", lambda *_: ring)
    monkeypatch.setattr(ring_module, "adapt", lambda *_: None)
    pages: list[Path] = []
    monkeypatch.setattr(identify_page, "write_identify_page", lambda target, _outcome: pages.append(target))
    capsys.readouterr()
    assert run_command(["demo", "--out", str(tmp_path), "--json"]) == 0
    values = json.loads(capsys.readouterr().out)
    assert values["before"] == reported["before"] and values["after"] == reported["after"]
    assert values["table_missed"] == {
        **ring.prediction_error.as_json(),
        "periods": ring.prediction_error.count,
    }
    assert values["mean_distance_m"] == ring.mean_distance_m
    page = Path(values["report"]).read_text(encoding="utf-8")
    assert f"limb_wear {true_effect['limb']}, gain {true_effect['gain']:g}" in page
    assert "ahead on the test run" in page
    assert pages == [tmp_path / "identify.html"]
    monkeypatch.setattr(ring_page, "write_ring_report", lambda *_: None)
    assert run_command(["demo", "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert f"hidden effect: limb_wear, {true_effect['limb']}" in said and "mm with the new" in said


def test_what_wears_goes_by_the_seed() -> None:
    every = [draw_wear(robot(), seed) for seed in range(20)]
    assert every[3] == draw_wear(robot(), 3)
    assert {each["limb"] for each in every} == {limb.name for limb in robot().limbs}
    assert all(0.6 <= each["gain"] <= 0.8 for each in every)
