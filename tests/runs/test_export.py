"""Runs as CSV and MCAP: read back by other programs' readers, they equal the log."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from tests.runs import rig

import frogkick as fk
from frogkick.core import errors
from frogkick.core.errors import InputError
from frogkick.runs.export_csv import export_csv
from frogkick.runs.export_mcap import export_mcap
from frogkick.runs.recorded.importer import load_run
from frogkick.runs.runlog import RunLog


@pytest.fixture(scope="module")
def swum() -> RunLog:
    recording = rig.swim("pool", "sine", 6.0)
    return recording.log()


def rows_of(file: Path) -> dict[str, list[str]]:
    with file.open(newline="", encoding="utf-8") as opened:
        head, *rows = list(csv.reader(opened))
    return dict(zip(head, map(list, zip(*rows, strict=True)), strict=True))


def test_csv_gives_every_number_back(swum: RunLog, tmp_path: Path) -> None:
    made = export_csv(swum, tmp_path)
    assert sorted(made) == sorted(file.name for file in tmp_path.iterdir())
    fixes, decisions = rows_of(tmp_path / "fixes.csv"), rows_of(tmp_path / "decisions.csv")
    assert np.array_equal(np.array(fixes["x_m"], dtype=float), swum.fixes.x_m)
    assert np.array_equal(np.array(fixes["sequence"], dtype=int), swum.fixes.extra["sequence"])
    assert swum.decisions.estimate is not None
    for k, part in enumerate(("x_m", "y_m", "heading_rad", "vx_mps", "vy_mps", "omega_radps")):
        given = np.array(decisions[f"estimate_{part}"], dtype=float)
        assert np.array_equal(given, swum.decisions.estimate[:, k]), part
    assert decisions["action_name"] == [swum.action_names[index] for index in swum.decisions.action]
    assert swum.truth is not None
    truth = rows_of(tmp_path / "truth.csv")
    assert np.array_equal(np.array(truth["velocity_body_vx_mps"], float), swum.truth.velocity_body[:, 0])
    about = json.loads((tmp_path / "run.json").read_text())
    assert about["actions"] == list(swum.action_names) and about["table_crc"] == swum.table_crc


def test_what_a_recorded_run_misses_is_empty(frog2022_dir: Path, tmp_path: Path) -> None:
    run = load_run(frog2022_dir / "control" / "line1.csv")
    assert "truth.csv" not in export_csv(run, tmp_path)
    cells = rows_of(tmp_path / "fixes.csv")["capture_time_s"]
    assert [cell == "" for cell in cells] == np.isnan(run.fixes.capture_time_s).tolist()


def messages(file: Path) -> dict[str, list[tuple[int, Any]]]:
    """Channel -> (time, message), decoded with the readers of MCAP and protobuf."""
    found: dict[str, list[tuple[int, Any]]] = {}
    with file.open("rb") as opened:
        reader = make_reader(opened, decoder_factories=[DecoderFactory()])
        for schema, channel, message in reader.iter_messages():
            assert schema is not None
            assert channel.message_encoding == schema.encoding == "protobuf"
            decode = DecoderFactory().decoder_for("protobuf", schema)
            assert decode is not None
            said = decode(message.data)
            found.setdefault(channel.topic, []).append((message.log_time, said))
    return found


def test_mcap_has_poses_path_and_plan_in_foxglove_s_schemas(swum: RunLog, tmp_path: Path) -> None:
    target = tmp_path / "run.mcap"
    counts = export_mcap(swum, target)
    found = messages(target)
    assert {topic: len(rows) for topic, rows in found.items()} == counts
    with target.open("rb") as opened:
        summary = make_reader(opened).get_summary()
    assert summary is not None
    kinds = {channel.topic: summary.schemas[channel.schema_id].name for channel in summary.channels.values()}
    assert kinds == {
        "/fix": "foxglove.PoseInFrame",
        "/estimate": "foxglove.PoseInFrame",
        "/predicted": "foxglove.PoseInFrame",
        "/truth": "foxglove.PoseInFrame",
        "/path": "foxglove.PosesInFrame",
        "/plan": "foxglove.SceneUpdate",
        "/tf": "foxglove.FrameTransform",
        "/decision": "frogkick.Decision",
        "/stroke": "frogkick.Stroke",
    }
    decisions = swum.decisions
    assert decisions.estimate is not None and decisions.predicted is not None
    for (time_ns, said), time_s, pose in zip(
        found["/estimate"], decisions.time_s, decisions.estimate, strict=True
    ):
        assert time_ns == round(time_s * 1e9) == said.timestamp.seconds * 10**9 + said.timestamp.nanos
        assert (said.frame_id, said.pose.position.x, said.pose.position.y) == ("pool", pose[0], pose[1])
        turned = said.pose.orientation
        assert 2.0 * np.arctan2(turned.z, turned.w) == pytest.approx(pose[2], abs=1e-12)
    for (time_ns, said), time_s in zip(found["/predicted"], decisions.time_s, strict=True):
        ends_ns = said.timestamp.seconds * 10**9 + said.timestamp.nanos
        assert ends_ns - time_ns == round(swum.period_s * 1e9), "a period after its decision"
        assert time_ns == round(time_s * 1e9)
    (_, path), *more = found["/path"]
    assert not more and swum.path is not None
    assert [pose.position.x for pose in path.poses] == swum.path.x_m.tolist()
    for (_, said), estimate, predicted, action in zip(
        found["/plan"], decisions.estimate, decisions.predicted, decisions.action, strict=True
    ):
        (entity,) = said.entities
        ends = [[point.x, point.y] for point in entity.lines[0].points]
        assert ends == [estimate[:2].tolist(), predicted[:2].tolist()]
        assert entity.texts[0].text == swum.action_names[action]
    reported = [said.name for _, said in found["/decision"]]
    assert reported == [swum.action_names[index] for index in decisions.action]
    assert [said.limb_mask for _, said in found["/stroke"]] == swum.strokes.limb_mask.tolist()
    assert [sum(1 << limb for limb in said.limbs) for _, said in found["/stroke"]] == [
        said.limb_mask for _, said in found["/stroke"]
    ]
    assert decisions.cost is not None
    assert [said.cost for _, said in found["/decision"]] == decisions.cost.tolist()
    times = [time_ns for rows in found.values() for time_ns, _ in rows]
    assert min(times) >= 0


def test_a_layout_shows_every_channel_with_something_to_see(swum: RunLog, tmp_path: Path) -> None:
    counts = export_mcap(swum, tmp_path / "run.mcap")
    layout = json.loads((tmp_path / "run.layout.json").read_text())
    panels = layout["configById"]
    plotted = {path["value"].split(".")[0] for name in panels for path in panels[name].get("paths", ())}
    assert set(panels["3D!pool"]["topics"]) | plotted | {"/stroke"} == set(counts)
    shown = layout["layout"]
    assert {shown["first"], shown["second"]["first"], shown["second"]["second"]} == set(panels)


def test_times_are_those_of_the_clock_on_the_wall(swum: RunLog, tmp_path: Path) -> None:
    made = {"began_at": "2026-03-01T12:00:00.250000+00:00", "frogkick": "1.2"}
    export_mcap(replace(swum, made=made), tmp_path / "run.mcap")
    begin_ns = 1_772_366_400_250_000_000
    found = messages(tmp_path / "run.mcap")
    assert [time_ns - begin_ns for time_ns, _ in found["/estimate"]] == [
        round(time_s * 1e9) for time_s in swum.decisions.time_s
    ]
    stamps = [said.timestamp.seconds * 10**9 + said.timestamp.nanos for _, said in found["/fix"]]
    captures = swum.fixes.capture_time_s[swum.fixes.usable]
    assert stamps == [begin_ns + round(float(time_s) * 1e9) for time_s in captures]
    with (tmp_path / "run.mcap").open("rb") as opened:
        (about,) = make_reader(opened).iter_metadata()
    assert about.metadata.items() >= made.items()


@pytest.mark.parametrize("began_at", ["yesterday", "2026-03-01T12:00:00"])
def test_a_log_that_began_at_no_time_is_refused(swum: RunLog, began_at: str) -> None:
    with pytest.raises(InputError, match=f"began_at is '{began_at}'"):
        replace(swum, made={"began_at": began_at})


def test_pandas_gets_what_csv_gets(swum: RunLog, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import pandas

    tables = fk.Run(**vars(swum)).to_pandas()
    export_csv(swum, tmp_path)
    assert set(tables) == {"fixes", "decisions", "strokes", "path", "truth"}
    for name, table in tables.items():
        read = pandas.read_csv(tmp_path / f"{name}.csv")
        pandas.testing.assert_frame_equal(table, read, check_dtype=False, check_exact=True)
    monkeypatch.setattr(errors, "installed", lambda package: package != "pandas")
    with pytest.raises(InputError, match=r"needs the package 'pandas'.*pip install 'frogkick\[pandas\]'"):
        fk.Run(**vars(swum)).to_pandas()


def test_a_recorded_run_without_estimates_opens_too(frog2022_dir: Path, tmp_path: Path) -> None:
    run = load_run(frog2022_dir / "control" / "line1.csv")
    target = tmp_path / "line1.mcap"
    counts = export_mcap(run, target)
    usable = int(run.fixes.usable.sum())
    assert counts["/fix"] == counts["/tf"] == usable and counts["/path"] == 1
    assert not {"/estimate", "/plan", "/truth"} & set(counts)
    captures = run.fixes.capture_time_s[run.fixes.usable]
    reported = [s.timestamp.seconds * 10**9 + s.timestamp.nanos for _, s in messages(target)["/fix"]]
    assert reported == [round(float(time_s) * 1e9) for time_s in captures]


def test_the_same_run_gives_the_same_bytes(swum: RunLog, tmp_path: Path) -> None:
    for name in ("a.mcap", "b.mcap"):
        export_mcap(swum, tmp_path / name)
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


def test_a_package_that_is_not_there_is_named(
    swum: RunLog, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(errors, "installed", lambda package: package != "mcap")
    with pytest.raises(InputError, match=r"MCAP needs the package 'mcap'.*pip install 'frogkick\[mcap\]'"):
        fk.Run(**vars(swum)).export_mcap(tmp_path / "run.mcap")
    assert not list(tmp_path.iterdir())
