"""Once round the ring: every stage leaves its file, and the numbers agree."""

from __future__ import annotations

from pathlib import Path

from tests.loop import rig

from frogkick.cli.common import progress_bar
from frogkick.library import library_info
from frogkick.loop.runlog_file import read_run
from frogkick.planner.image import read_image
from frogkick.study.ring import go_round


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
    assert ring.chip.passed and ring.flash_bytes > len(ring.tables.image)
    assert ring.mean_distance_m == ring.runs[0].tracking.mean_distance_m
    assert ring.missed["periods"] == len(ring.runs[0].missed.time_s) > 0
    assert {"library", "tables, C", "firmware", "swim the line"} <= ring.stage_s.keys()
