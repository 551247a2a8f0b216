"""The run log: what is written is read back, and what is not a run is refused in one line."""

from __future__ import annotations

import dataclasses
import math
import pathlib
from typing import Any

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from frogkick.core.errors import InputError
from frogkick.core.hdf5 import seal
from frogkick.paths import line
from frogkick.runs.runlog import (
    DecisionFlag,
    Decisions,
    Fixes,
    FixFlag,
    RunLog,
    Strokes,
    Truth,
)
from frogkick.runs.runlog_file import read_run, write_run


def make_fixes(rows: int = 4, **changes: Any) -> Fixes:
    time = np.arange(rows) * 0.067
    columns: dict[str, Any] = {
        "time_s": time,
        "capture_time_s": time - 0.03,
        "x_m": 0.01 * time,
        "y_m": -0.02 * time,
        "heading_rad": np.full(rows, 0.5),
        "quality": np.ones(rows, dtype=int),
        "flags": np.zeros(rows, dtype=int),
    }
    return Fixes(**{**columns, **changes})


def make_run(**changes: Any) -> RunLog:
    run = RunLog(
        robot_id="frog2022",
        source="bench",
        period_s=1.425,
        pulse_s=0.08,
        action_names=("A", "B"),
        fixes=make_fixes(extra={"vx_world_mps": np.zeros(4), "sequence": np.arange(4)}),
        decisions=Decisions(
            time_s=[0.1, 0.2],
            action=[1, 0],
            fix_sequence=[0, 3],
            flags=[0, int(DecisionFlag.NO_PLAN)],
            cost=[12.5, math.nan],
            estimate=np.array([[1.0] * 6, [math.nan] * 6]),
            plan_s=[0.001, math.nan],
        ),
        strokes=Strokes(time_s=[0.1, 0.18], limb_mask=[3, 12], pulse_s=[0.08, 0.08]),
        path=line(0.3),
        truth=Truth(time_s=[0.0, 0.1], pose_world=np.zeros((2, 3)), velocity_body=np.ones((2, 3))),
        table_crc=0xFFFFFFFF,
        seed=7,
        notes="a note",
        measured={"rest_noise_m": 2e-4},
    )
    return dataclasses.replace(run, **changes)


def test_round_trip_keeps_everything_and_the_bytes(tmp_path: pathlib.Path) -> None:
    run = make_run()
    write_run(tmp_path / "a.h5", run)
    back = read_run(tmp_path / "a.h5")
    for group in ("fixes", "decisions", "strokes", "truth"):
        for entry in dataclasses.fields(getattr(run, group)):
            first, second = (
                getattr(getattr(run, group), entry.name),
                getattr(getattr(back, group), entry.name),
            )
            if entry.name == "extra":
                assert first.keys() == second.keys()
                assert all(np.array_equal(first[key], second[key]) for key in first)
            elif first is None:
                assert second is None
            else:
                assert np.array_equal(first, second, equal_nan=True), (group, entry.name)
    for name in ("robot_id", "source", "period_s", "pulse_s", "action_names", "table_crc", "seed", "notes"):
        assert getattr(run, name) == getattr(back, name)
    assert back.path == run.path
    assert back.measured == run.measured
    write_run(tmp_path / "b.h5", back)
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()


def test_every_dataset_has_a_unit_and_flags_are_named(tmp_path: pathlib.Path) -> None:
    write_run(tmp_path / "a.h5", make_run())
    without: list[str] = []
    with h5py.File(tmp_path / "a.h5") as file:
        file.visititems(
            lambda name, item: (
                without.append(name) if isinstance(item, h5py.Dataset) and "unit" not in item.attrs else None
            )
        )
        assert "misdetection=4" in file["fixes/flags"].attrs["bits"]
        assert file["fixes/vx_world_mps"].attrs["unit"] == "m/s"
        assert list(file["decisions/action"].attrs["names"]) == ["A", "B"]
    assert without == []


@given(st.integers(0, 30), st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_any_length_round_trips(tmp_path_factory: pytest.TempPathFactory, rows: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    time = np.sort(rng.uniform(0, 100, rows))
    run = make_run(
        fixes=make_fixes(rows, time_s=time, x_m=rng.normal(size=rows)),
        decisions=Decisions(time_s=[], action=[], fix_sequence=[], flags=[]),
        strokes=Strokes(time_s=[], limb_mask=[], pulse_s=[]),
        path=None,
        truth=None,
        seed=None,
        table_crc=None,
        action_names=(),
        measured={},
    )
    file = tmp_path_factory.mktemp("run") / "r.h5"
    write_run(file, run)
    back = read_run(file)
    assert np.array_equal(back.fixes.x_m, run.fixes.x_m)
    assert (back.path, back.truth, back.seed, back.table_crc, back.action_names) == (
        None,
        None,
        None,
        None,
        (),
    )


@pytest.mark.parametrize("column", ["time_s", "capture_time_s", "x_m", "y_m", "heading_rad"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_nan_is_named_by_column_and_row(column: str, value: float) -> None:
    values = np.arange(4.0)
    values[2] = value
    with pytest.raises(InputError, match=f"fixes/{column} row 2"):
        make_fixes(**{column: values})


def test_nan_passes_only_where_its_flag_says_so() -> None:
    values = np.array([0.0, math.nan, 2.0, 3.0])
    lost = [0, int(FixFlag.MISSING), 0, 0]
    fixes = make_fixes(x_m=values, y_m=values, heading_rad=values, flags=lost)
    assert fixes.usable.tolist() == [True, False, True, True]
    untrusted = [0, int(FixFlag.UNTRUSTED_TIME), 0, 0]
    make_fixes(capture_time_s=values, flags=untrusted)
    with pytest.raises(InputError, match="x_m row 1"):
        make_fixes(x_m=values, flags=untrusted)
    with pytest.raises(InputError, match="decisions/estimate row 0"):
        Decisions(time_s=[0.0], action=[0], fix_sequence=[-1], flags=[0], estimate=np.full((1, 6), math.nan))


def test_nan_put_into_a_file_is_found(tmp_path: pathlib.Path) -> None:
    write_run(tmp_path / "a.h5", make_run())
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        file["fixes/y_m"][3] = math.nan
    seal(tmp_path / "a.h5")
    with pytest.raises(InputError, match=r"run log 'a\.h5': fixes/y_m row 3 is nan"):
        read_run(tmp_path / "a.h5")


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"period_s": 0.0}, "period_s"),
        ({"pulse_s": math.nan}, "pulse_s"),
        ({"source": "/home/me/line1.csv"}, "name only"),
        ({"action_names": ("A",)}, "decisions/action row 0 is 1"),
        ({"measured": {"x_m": math.nan}}, "measured x_m"),
        ({"fixes": make_fixes(3)}, "fix_sequence row 1 is 3"),
    ],
)
def test_bad_runs(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(InputError, match=text):
        make_run(**changes)


def test_bad_columns() -> None:
    with pytest.raises(InputError, match="time_s row 2 goes back"):
        make_fixes(time_s=[0.0, 1.0, 0.5, 2.0])
    with pytest.raises(InputError, match="x_m has 2 rows"):
        make_fixes(x_m=[0.0, 1.0])
    with pytest.raises(InputError, match="quality row 1 is 300"):
        make_fixes(quality=[1, 300, 1, 1])
    with pytest.raises(InputError, match="shape"):
        make_fixes(x_m=np.zeros((4, 2)))
    with pytest.raises(InputError, match="numbers"):
        make_fixes(extra={"label": np.array(list("abcd"))})


def test_foreign_truncated_empty_and_newer_files(tmp_path: pathlib.Path) -> None:
    good = tmp_path / "good.h5"
    write_run(good, make_run())
    content = good.read_bytes()
    cases = {
        "text.h5": b"time,x,y\n1,2,3\n",
        "half.h5": content[: len(content) // 2],
        "short.h5": content[:-100],
        "empty.h5": b"",
    }
    for name, bytes_ in cases.items():
        (tmp_path / name).write_bytes(bytes_)
        with pytest.raises(InputError) as caught:
            read_run(tmp_path / name)
        assert "\n" not in str(caught.value)
        assert name in str(caught.value)
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file.attrs["format"] = "frogkick library"
    with pytest.raises(InputError, match="another kind of file"):
        read_run(tmp_path / "other.h5")
    with h5py.File(good, "r+") as file:
        file.attrs["format_version"] = 2
    seal(good)
    with pytest.raises(InputError, match="format version 2"):
        read_run(good)
    with pytest.raises(InputError, match="does not exist"):
        read_run(tmp_path / "no.h5")


@pytest.mark.parametrize("gone", ["fixes", "strokes/limb_mask", "decisions", "path/x_m"])
def test_missing_parts(tmp_path: pathlib.Path, gone: str) -> None:
    write_run(tmp_path / "a.h5", make_run())
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        del file[gone]
    seal(tmp_path / "a.h5")
    with pytest.raises(InputError) as caught:
        read_run(tmp_path / "a.h5")
    assert "\n" not in str(caught.value)
