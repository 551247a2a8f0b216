"""The paper's recorded runs: real ones if they are there, and small synthetic files with known faults."""

from __future__ import annotations

import pathlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.conftest import from_ci

from frogkick.core.errors import InputError
from frogkick.runs.recorded.clock import estimate_clock
from frogkick.runs.recorded.importer import (
    cost_mismatch,
    import_recorded,
    load_run,
    motion_lag,
    read_recorded,
    summarise,
)
from frogkick.runs.recorded.table import mark_frames, misdetections, untrusted_times
from frogkick.runs.runlog import DecisionFlag, FixFlag

REST = 8
LIMITS_S = (0.8, 2.5)
HEAD = (
    "CV Data Logger started on:,2022-2-24_173308\n"
    "Timestamp (millisec since midnight today),x,y,theta,xdot,ydot,thetadot,cost,last action\n"
)
# rows, rest rows, misdetected rows, decisions and the period's standard uncertainty of the published runs
RUNS = {
    "line1": (247, 63, [], "BBBBBBBCBCCA"),
    "sin1": (358, 65, [], "FFCCCEEBDFFFFEEEE"),
    "sin3": (353, 72, [], "FFEBCCEEEDFFFCEEI"),
    "ellipse1": (668, 55, [], "FFGBDCBBGCCCCCGGECCEGGCACCCCCCBCC"),
    "ellipse3": (590, 57, [76], "FFBAGCBCCCBCACEEEEEEEEEECBBBCCCE"),
    "ellipse5": (471, 73, [165], "EEBDDFFFFFFFBFFFFFFFFFF"),
    "ellipse6": (750, 179, [713, 715], "EECBFFHFDBDDFFFFFHDBDDHFHDDDIDDDA"),
}


def made_up(
    folder: pathlib.Path,
    rows: int = 120,
    backlog: int = 10,
    period_s: float = 1.425,
    labels: str = "BCBFEB",
    seed: int = 1,
    name: str = "line7",
) -> list[list[str]]:
    """The cells of a run that follows a line at 25 mm/s; the file and its path file are written."""
    rng = np.random.default_rng(seed)
    time_ms = np.concatenate([np.arange(backlog), backlog + 67 * np.arange(1, rows - backlog + 1)])
    time_ms = time_ms + np.concatenate([np.zeros(backlog), rng.integers(-8, 9, rows - backlog)])
    x = 0.025 * np.maximum(time_ms * 1e-3 - 1.0, 0.0) + rng.normal(0, 1e-4, rows)
    cells = []
    for time, position in zip(time_ms, x, strict=True):
        count = int(np.floor((time * 1e-3 - 1.0) / period_s))
        label = "I" if count < 0 else labels[min(count, len(labels) - 1)]
        cells.append([f"{43200000 + time:.0f}", repr(float(position)), "0.1", "6.2", *["0.0"] * 7, label])
    write(folder, cells, name)
    (folder / f"{name[:-1]}p{name[-1]}.csv").write_text("".join(f"{i / 99},0.1,1,0\n" for i in range(100)))
    return cells


def write(folder: pathlib.Path, cells: list[list[str]], name: str = "line7") -> pathlib.Path:
    file = folder / f"{name}.csv"
    file.write_text(HEAD + "".join(",".join(row) + "\n" for row in cells))
    return file


@pytest.mark.parametrize("name", RUNS)
def test_published_run(frog2022_dir: pathlib.Path, name: str) -> None:
    rows, rest, wrong, labels = RUNS[name]
    run = load_run(frog2022_dir / "control" / f"{name}.csv")
    raw = np.genfromtxt(
        frog2022_dir / "control" / f"{name}.csv", delimiter=",", skip_header=2, usecols=range(11)
    )
    fixes = run.fixes
    assert len(fixes) == rows
    assert np.array_equal(fixes.x_m, raw[:, 1])
    assert fixes.time_s == pytest.approx((raw[:, 0] - raw[0, 0]) * 1e-3)
    assert np.cos(fixes.heading_rad) == pytest.approx(np.cos(raw[:, 3]), abs=1e-12)
    assert np.all(np.abs(fixes.heading_rad) <= np.pi)
    assert np.flatnonzero(fixes.quality == 0).tolist() == wrong
    assert "".join(run.action_names[index] for index in run.decisions.action) == labels
    # REFERENCE.md, section 4: one constant clock fits every run.
    assert 1.4229 <= run.period_s <= 1.4281
    assert run.measured["clock_slack_s"] > 0.0
    assert run.measured["period_std_s"] < 0.0035
    assert -0.01 <= run.measured["motion_lag_s"] <= 0.10
    summary = summarise(run)
    assert summary["rest_rows"] == rest
    assert 5e-5 < summary["rest_noise_m"] < 4e-4
    assert 0.1 < np.degrees(summary["rest_noise_rad"]) < 0.3
    # The costs of the record are those of the record's path, to the float32 of the path.
    assert cost_mismatch(run) < 2e-5


def test_published_labels_and_strokes_agree(frog2022_dir: pathlib.Path) -> None:
    run = load_run(frog2022_dir / "control" / "ellipse6.csv")
    decided = np.searchsorted(run.decisions.time_s, run.fixes.time_s, side="right") - 1
    expected = np.where(decided < 0, REST, run.decisions.action[np.maximum(decided, 0)])
    # The clock is within its uncertainty of every change: only rows that close to one may differ.
    differ = np.flatnonzero(expected != run.fixes.extra["logged_action"])
    near = np.abs(run.fixes.time_s[differ, None] - run.decisions.time_s).min(axis=1)
    assert np.all(near < 0.02)
    # B fires both front limbs, then both rear ones a pulse later.
    first = run.decisions.time_s[3]
    assert run.action_names[run.decisions.action[3]] == "B"
    at = np.flatnonzero(np.abs(run.strokes.time_s - first) < 0.1)
    assert run.strokes.limb_mask[at].tolist() == [3, 12]
    assert np.diff(run.strokes.time_s[at]) == pytest.approx([0.08])


def test_import_writes_what_load_reads(frog2022_dir: pathlib.Path, tmp_path: pathlib.Path) -> None:
    calls: list[tuple[int, int]] = []
    summaries = import_recorded(
        frog2022_dir, tmp_path / "out", lambda done, total: calls.append((done, total))
    )
    assert [summary["run"] for summary in summaries] == [f"{name}.csv" for name in RUNS]
    assert calls[-1] == (7, 7)
    first = load_run(tmp_path / "out" / "sin1.h5")
    again = read_recorded(frog2022_dir / "control" / "sin1.csv")
    assert first.path == again.path
    assert np.array_equal(first.decisions.time_s, again.decisions.time_s)
    assert summarise(first) == summarise(again)
    lines = [summary["mean_distance_m"] for summary in summaries]
    assert lines[0] == pytest.approx(0.0178, abs=5e-4)


def test_made_up_run_gives_its_clock_back(tmp_path: pathlib.Path) -> None:
    made_up(tmp_path, rows=150)
    run = load_run(tmp_path / "line7.csv")
    assert run.period_s == pytest.approx(1.425, abs=0.02)
    assert run.measured["phase_s"] == pytest.approx(1.0, abs=0.05)
    assert "".join(run.action_names[i] for i in run.decisions.action)[:6] == "BCBFEB"
    flags = run.fixes.flags
    assert np.flatnonzero(flags & int(FixFlag.UNTRUSTED_TIME)).tolist() == list(range(10))
    assert np.isnan(run.fixes.capture_time_s[:10]).all()
    assert np.isfinite(run.fixes.capture_time_s[10:]).all()
    assert np.all(run.fixes.quality == 1)


@from_ci
@given(st.floats(0.85, 2.4), st.integers(0, 1000))
@settings(max_examples=40, deadline=None)
def test_clock_is_within_its_polygon(period_s: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(0.05, 0.14, 400))
    phase = time[20] - 0.01
    count = np.floor((time - phase) / period_s).astype(int)
    labels = np.array([0, 1, 2, 3, 0, 2, 1, 3, 2, 0, 1])[np.maximum(count, 0) % 11]
    clock = estimate_clock(time, np.where(count < 0, REST, labels), np.ones(400, dtype=bool), REST, LIMITS_S)
    assert clock is not None
    assert clock.evidence["clock_slack_s"] > 0.0 and not clock.problem and not clock.slips
    assert clock.evidence["clock_resultant"] > 0.93 and clock.evidence["clock_labels"] > 10
    assert abs(clock.period_s - period_s) < 5 * clock.evidence["period_std_s"] + 2e-4
    assert abs(clock.evidence["phase_s"] - phase) < 5 * clock.evidence["phase_std_s"] + 2e-3


def test_clock_without_changes_and_against_the_labels() -> None:
    time = np.arange(200) * 0.067
    trusted = np.ones(200, dtype=bool)
    assert estimate_clock(time, np.full(200, REST), trusted, REST, LIMITS_S) is None
    one = estimate_clock(time, np.where(time < 1.0, REST, 1), trusted, REST, LIMITS_S)
    assert one is not None
    assert "do not determine the period" in one.problem
    # Changes every 0.7 s cannot come from a clock of this robot.
    labels = np.where(time < 1.0, REST, (time // 0.7).astype(int) % 4)
    bad = estimate_clock(time, labels, trusted, REST, LIMITS_S)
    assert bad is not None
    assert bad.problem


def test_motion_lag_is_found() -> None:
    time = np.arange(0.0, 60.0, 0.067)
    fired = 1.0 + 1.425 * np.arange(40)
    late = np.clip(time[:, None] - fired - 0.06, 0.0, 0.3)
    x = 0.02 * time + (0.5 * 0.2 * late**2).sum(axis=1)
    pose = np.column_stack([x, np.zeros_like(x), np.zeros_like(x)])
    lag = motion_lag(time, pose, np.ones(len(time), dtype=bool), fired)
    assert lag == pytest.approx(0.06, abs=0.006)


@given(
    st.integers(2, 55), st.floats(-np.pi, np.pi), st.floats(0.006, 0.2), st.integers(0, 99), st.integers(1, 3)
)
@settings(max_examples=60, deadline=None)
def test_misdetections_there_and_back_are_found_and_no_others(
    row: int, direction: float, size_m: float, seed: int, width: int
) -> None:
    rng = np.random.default_rng(seed)
    time = np.arange(60) * 0.067
    pose = np.column_stack([0.03 * time, np.zeros(60), 6.0 * time]) + rng.normal(
        0, [2e-4, 2e-4, 3e-3], (60, 3)
    )
    pose[:, 2] = np.mod(0.4 * time, 2 * np.pi)
    clean = misdetections(time, pose, np.ones(60, dtype=bool))
    assert not clean.any()
    size = size_m * width  # the wider the hole, the more a robot could have moved within it
    pose[row : row + width, :2] += size * np.array([np.cos(direction), np.sin(direction)])
    found = np.flatnonzero(misdetections(time, pose, np.ones(60, dtype=bool)))
    assert found.tolist() == list(range(row, row + width))


def test_a_step_that_stays_is_a_jump_not_a_misdetection() -> None:
    time = np.arange(40) * 0.067
    pose = np.zeros((40, 3))
    pose[:, 0] = 1e-3 * np.arange(40)
    pose[20:, 0] += 0.1
    quality, flags = mark_frames(time, pose, np.zeros(40, dtype=bool))
    assert np.flatnonzero(flags & int(FixFlag.JUMP)).tolist() == [20]
    assert np.all(quality == 1)
    pose[20:39, 0] -= 0.1
    quality, flags = mark_frames(time, pose, np.zeros(40, dtype=bool))
    assert np.flatnonzero(quality == 0).tolist() == [39]


def test_heading_flip_is_a_misdetection() -> None:
    time = np.arange(40) * 0.067
    pose = np.column_stack([1e-3 * np.arange(40), np.zeros(40), np.full(40, 3.1)])
    pose[15, 2] -= np.pi / 2
    quality, _ = mark_frames(time, pose, np.zeros(40, dtype=bool))
    assert np.flatnonzero(quality == 0).tolist() == [15]


def test_backlog_tail_gap_and_later_burst() -> None:
    spacing = [0.001] * 9 + [0.088, 0.036, 0.019] + [0.067] * 10 + [0.76, 0.067, 0.002, 0.067]
    time = np.concatenate([[0.0], np.cumsum(spacing)])
    untrusted = untrusted_times(time)
    assert np.flatnonzero(untrusted).tolist() == [*range(13), 25]
    pose = np.column_stack([1e-4 * np.arange(len(time)), np.zeros((len(time), 2))])
    _, flags = mark_frames(time, pose, np.zeros(len(time), dtype=bool))
    assert np.flatnonzero(flags & int(FixFlag.AFTER_GAP)).tolist() == [23]
    assert not untrusted_times(np.arange(30) * 0.067).any()


def test_midnight_and_repeats_are_marked(tmp_path: pathlib.Path) -> None:
    cells = made_up(tmp_path)
    for index, row in enumerate(cells):
        row[0] = str((int(row[0]) + 86_400_000 - 43_200_000 - 4000) % 86_400_000)
        if index == 50:
            row[1:4] = cells[49][1:4]
    run = load_run(write(tmp_path, cells))
    assert np.all(np.diff(run.fixes.time_s) >= 0.0)
    assert run.fixes.time_s[-1] < 20.0
    carried = (run.fixes.flags & int(FixFlag.REPAIRED_STAMP)) != 0
    assert np.array_equal(carried, run.fixes.time_s >= 4.0)
    assert run.fixes.quality[50] == 0


def test_unseen_period_is_not_invented(tmp_path: pathlib.Path) -> None:
    cells = made_up(tmp_path)
    start = 43_200_000 + 1000 + 3 * 1425
    kept = [row for row in cells if not start - 20 <= int(row[0]) <= start + 1425 + 20]
    run = load_run(write(tmp_path, kept))
    unseen = np.flatnonzero(run.decisions.flags & int(DecisionFlag.UNSEEN))
    assert unseen.tolist() == [3]
    assert run.decisions.action[3] == -1
    near = np.abs(run.strokes.time_s[:, None] - run.decisions.time_s[3])
    assert near.min() > 0.5


def test_run_that_never_fires(tmp_path: pathlib.Path) -> None:
    made_up(tmp_path, labels="I")
    run = load_run(tmp_path / "line7.csv")
    assert len(run.decisions) == len(run.strokes) == 0
    assert np.all(run.fixes.flags & int(FixFlag.AT_REST))


@pytest.mark.parametrize(
    ("row", "column", "cell", "text"),
    [
        (3, 1, "nan", "line 6 column 'x' is 'nan'"),
        (3, 3, "inf", "line 6 column 'theta' is 'inf'"),
        (0, 2, "abc", "line 3 column 'y' is 'abc'"),
        (7, 10, "", "line 10 column 'cost_progress' is ''"),
        (5, 11, "Q", "line 8: last action is 'Q'"),
        (30, 0, "43200000", "line 33: time goes back"),
        (4, 1, "1e308", "line 7 column 'x' is '1e308', more than 1e.09: correct it or cut that line"),
    ],
)
def test_bad_cells(tmp_path: pathlib.Path, row: int, column: int, cell: str, text: str) -> None:
    cells = made_up(tmp_path)
    cells[row][column] = cell
    with pytest.raises(InputError, match=text) as caught:
        load_run(write(tmp_path, cells))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("columns", "factor", "text"),
    [
        ((1, 2), 1e3, r"frames are farther from others than .* give x and y in m, theta in rad"),
        ((1, 2), 1e2, "give x and y in m"),
        ((3,), 180.0 / np.pi, "theta in rad"),
        ((0,), 1e-3, "no frame has a usable time, as all stamps are less than 20 ms apart"),
    ],
    ids=["mm", "cm", "degrees", "seconds"],
)
def test_other_units_are_refused(
    tmp_path: pathlib.Path, columns: tuple[int, ...], factor: float, text: str
) -> None:
    """Nearly every frame would be marked as wrong."""
    cells = made_up(tmp_path)
    rng = np.random.default_rng(2)
    for row in cells:
        row[3] = repr(4.2 + float(rng.normal(0, 3e-3)))
        for column in columns:
            row[column] = repr(float(row[column]) * factor)
    with pytest.raises(InputError, match=text):
        load_run(write(tmp_path, cells))


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("before", ["", "\ufeff"], ids=["plain", "with BOM"])
def test_line_ends_and_empty_lines_do_not_matter(tmp_path: pathlib.Path, before: str, end: str) -> None:
    """As editors and mail programs write them; errors count lines as an editor does."""
    made_up(tmp_path)
    plain = load_run(tmp_path / "line7.csv")
    text = (tmp_path / "line7.csv").read_text()
    other = before + "\n" + "\n\n , ,\n".join(text.splitlines())
    (tmp_path / "line7.csv").write_bytes(other.replace("\n", end).encode())
    again = load_run(tmp_path / "line7.csv")
    for group in ("fixes", "decisions", "strokes"):
        first, second = getattr(plain, group).all_columns(), getattr(again, group).all_columns()
        assert all(np.array_equal(first[name], second[name], equal_nan=True) for name in first)
    (tmp_path / "line7.csv").write_bytes(other.replace(",theta,", ",").replace("\n", end).encode())
    with pytest.raises(InputError, match="'theta' is missing in line 5"):
        load_run(tmp_path / "line7.csv")


def test_bad_files(tmp_path: pathlib.Path) -> None:
    cells = made_up(tmp_path)
    with pytest.raises(InputError, match="line 4 has 11 columns"):
        load_run(write(tmp_path, [cells[0], cells[1][:-1], *cells[2:]]))
    file = write(tmp_path, cells)
    file.write_text(file.read_text().replace(",theta,", ","))
    with pytest.raises(InputError, match="'theta' is missing"):
        load_run(file)
    with pytest.raises(InputError, match="holds 0 rows"):
        load_run(write(tmp_path, []))
    with pytest.raises(InputError, match="not a recorded run"):
        load_run(tmp_path / "linep7.csv")
    file.write_text("")
    with pytest.raises(InputError, match="is empty"):
        load_run(file)
    text = write(tmp_path, cells).read_text()
    for separator, name in ((";", "';'"), ("\t", r"'\\t'")):
        file.write_text(text.replace(",", separator))
        with pytest.raises(InputError, match=f"separates its columns by {name}: needed are commas"):
            load_run(file)
    for raw in (text.encode("utf-16"), text.replace("started on:,", "started on:,\xb5").encode("latin-1")):
        file.write_bytes(raw)
        with pytest.raises(InputError, match=r"is not UTF-8 from byte \d+ on: save it again as UTF-8"):
            load_run(file)
    file.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="is not a run: give a log"):
        load_run(file)
    with pytest.raises(InputError, match="does not exist"):
        load_run(tmp_path / "line99.csv")


def test_missing_path_and_import_of_a_bad_folder(tmp_path: pathlib.Path) -> None:
    data, out = tmp_path / "data", tmp_path / "out"
    data.mkdir()
    with pytest.raises(InputError, match="holds 0 recorded runs"):
        import_recorded(data, out)
    made_up(data)
    cells = made_up(data, name="sin2")
    (data / "sinp2.csv").unlink()
    with pytest.raises(InputError, match=r"'sinp2\.csv' is not beside it"):
        load_run(data / "sin2.csv")
    summaries = import_recorded(data, out)
    assert [(s["run"], "skipped" in s) for s in summaries] == [("line7.csv", False), ("sin2.csv", True)]
    assert [file.name for file in out.iterdir()] == ["line7.h5"]
    # One bad run: nothing at all is written.
    (data / "sinp2.csv").write_text("0,0\n1,1\n")
    cells[5][1] = "nan"
    write(data, cells, "sin2")
    with pytest.raises(InputError, match="'nan'"):
        import_recorded(data, tmp_path / "none")
    assert not (tmp_path / "none").exists()
    with pytest.raises(InputError, match="not a folder"):
        import_recorded(tmp_path / "nowhere", out)
    (data / "other.csv").write_text(HEAD)
    with pytest.raises(InputError, match="holds 0 rows"):
        load_run(data / "other.csv")
