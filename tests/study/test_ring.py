"""Once round the ring: every stage leaves its file, and the numbers agree."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from tests.loop import rig

from frogkick.cli.common import progress_bar
from frogkick.identify import outcome as outcome_module
from frogkick.identify.outcome import Outcome, identify
from frogkick.identify.swim import Swim
from frogkick.identify.terms import catalogue
from frogkick.library import library_info
from frogkick.loop.runlog_file import read_run
from frogkick.planner.image import read_image
from frogkick.report.ring_page import write_ring_report
from frogkick.robot import load_robot
from frogkick.study import closing as closing_module
from frogkick.study.closing import plant
from frogkick.study.ring import close, go_round


def test_the_ring_leaves_every_stage_behind(tmp_path: Path) -> None:
    ring = go_round(rig.robot(), tmp_path, 10, 1, 3, progress_bar, paths=("line",), time_limit_s=4.0)
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "emitted", "firmware", "library.h5", "line.h5", "tables.fkt",
    ]  # fmt: skip
    assert library_info(tmp_path / "library.h5")["states"] == 10
    assert read_image(tmp_path / "tables.fkt").crc32 == ring.tables.crc32
    log = read_run(tmp_path / "line.h5")
    assert log.seed == 3 and log.table_crc == ring.tables.crc32
    assert [run.mismatches for run in ring.runs] == [0]
    assert ring.chip.passed and ring.built.flash_bytes > len(ring.tables.image)
    assert ring.mean_distance_m == ring.runs[0].tracking.mean_distance_m
    assert ring.missed["periods"] == len(ring.runs[0].missed.time_s) > 0
    assert {"library, tables", "C, firmware", "swim the line"} <= ring.stage_s.keys()


def test_the_ring_closes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A limb wears, which nobody tells the model: logs tell it, and new firmware swims knowing it."""
    planted = plant(rig.robot(), 3)
    names = ("limb_wear " + planted["limb"], "drag_scale")
    few = [term for term in catalogue(rig.robot()) if term.title in names]
    given: list[Sequence[Swim]] = []

    def watched(train: Sequence[Swim], test: Sequence[Swim], *more: Any, **options: Any) -> Outcome:
        given.extend((train, test))
        return identify(train, test, *more, **options)

    monkeypatch.setattr(outcome_module, "catalogue", lambda *_: few)
    monkeypatch.setattr(outcome_module, "relatives", lambda _robot: {})
    monkeypatch.setattr(closing_module, "identify", watched)
    ring = go_round(
        rig.robot(), tmp_path, 10, 1, 3, progress_bar, paths=("line", "ellipse"), time_limit_s=18.0
    )
    close(ring, tmp_path, 3, progress_bar, held_out="bends")
    closing = ring.closing
    assert closing is not None and closing.planted == planted
    assert [swim.name for swim in given[0]] == ["worn-line.h5", "worn-ellipse.h5"]
    assert [swim.name for swim in given[1]] == ["worn-bends.h5"]
    assert read_run(tmp_path / "worn-line.h5").truth is None
    told = closing.as_json()
    assert told["verdict"] == "found" and [each["limb"] for each in told["found"]] == [planted["limb"]]
    gain = told["found"][0]["parameters"]["gain"]
    assert abs(gain["value"] - planted["gain"]) < 0.05
    before, after, floor = (told[key]["position_rmse_m"] for key in ("before", "after", "noise_floor"))
    assert after < 0.5 * before and 0.3 * after < floor < before
    assert [row["periods"] for row in told["horizons"]] == [1, 2, 3, 5]
    assert told["before"]["periods"] == told["horizons"][0]["count"]
    assert [len(closing.old), len(closing.new)] == [2, 2]
    old, new = (closing.distance_m(runs) for runs in (closing.old, closing.new))
    assert told["changed_robot"] == {"mean_distance_before_m": old, "mean_distance_after_m": new}
    assert old != new
    new_tables = read_image(tmp_path / "new" / "tables.fkt")
    assert new_tables.crc32 != ring.tables.crc32 and closing.new[0].log.table_crc == new_tables.crc32
    assert [effect["name"] for effect in load_robot(tmp_path / "found.toml").effects] == ["limb_wear"]
    write_ring_report(tmp_path / "report.html", ring)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert f"limb_wear {planted['limb']}, gain {planted['gain']:g}" in page and "kept out of learning" in page


def test_what_wears_goes_by_the_seed() -> None:
    every = [plant(rig.robot(), seed) for seed in range(20)]
    assert every[3] == plant(rig.robot(), 3)
    assert {each["limb"] for each in every} == {limb.name for limb in rig.robot().limbs}
    assert all(0.6 <= each["gain"] <= 0.8 for each in every)
