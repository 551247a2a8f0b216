"""The studies of tables: their figures are those of the tables made by hand, their commands say them all."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.conftest import FULL, count, from_ci
from tests.identification.made import robot
from tests.library.synthetic import Known

from frogkick.cli.main import run_command
from frogkick.library import Library, error_on, fit_table, quantise, sample_library, write_library
from frogkick.tables.image import open_image
from frogkick_studies import history
from frogkick_studies import tables as tables_study
from frogkick_studies.history import HistoryStudy
from frogkick_studies.tables import (
    TablePoint,
    TableSizes,
    least_bytes_as_good,
    over_full_nearest,
    slope,
    table_sizes,
)


@pytest.fixture(scope="module")
def library() -> Library:
    """Of a made system: what is measured on simulated states then only has to be told right."""
    made = Known(1, 3).library(90, 2)
    return replace(made, robot_toml=robot().toml, robot_sha256=robot().sha256)


@pytest.fixture
def few_sizes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tables_study, "NEAREST_STATES", (30,))
    monkeypatch.setattr(tables_study, "AFFINE_KIB", (3, 6))
    monkeypatch.setattr(tables_study, "LIBRARY_STATES", (60,))


@from_ci
@pytest.mark.usefixtures("few_sizes")
def test_each_point_is_a_table_made_and_measured_by_hand(library: Library) -> None:
    seen: list[tuple[int, int]] = []
    sizes = table_sizes(library, 4, 7, lambda done, whole: seen.append((done, whole)), swims="visited")
    assert seen[-1][0] == seen[-1][1]
    assert [(p.kind, p.library_states) for p in sizes.by_size] == [
        ("nearest", 30), ("nearest", 90), ("affine", 90), ("affine", 90)
    ]  # fmt: skip
    assert [p.library_states for p in sizes.by_library] == [60, 90]
    box, visited = (sample_library(robot(), 4, 7, sampling) for sampling in ("box", "visited"))
    for point, image in (
        (sizes.by_size[0], quantise(library.part(np.arange(30)))),
        (sizes.by_size[3], fit_table(library, "affine", 6 * 1024).image),
        (sizes.by_library[0], fit_table(library.part(np.arange(60)), "affine", 64 * 1024).image),
    ):
        tables = open_image(image)
        assert (point.bytes, point.states) == (len(image), len(tables.states))
        assert point.box == error_on(tables, box)
        assert point.visited == error_on(tables, visited)


def made(kind: str, size: int, states: int, error: float) -> TablePoint:
    errors = {"position_m": error, "heading_rad": 2.0 * error, "velocity_mps": error, "omega_rad_s": error}
    return TablePoint(kind, states, size, states, errors, errors)


def test_the_ratio_is_of_the_largest_affine_table_within_64_kib_to_the_largest_nearest_one() -> None:
    points = (
        made("nearest", 9000, 100, 9.0),
        made("nearest", 99_999, 8503, 2.0),
        made("affine", 4096, 9, 1.5),
        made("affine", 65_536, 290, 0.5),
        made("affine", 65_540, 300, 0.1),
    )
    found = over_full_nearest(TableSizes(points, ()))
    assert set(found) == {"box", "visited"}
    assert set(found["box"]) == {"position_m", "heading_rad", "velocity_mps", "omega_rad_s"}
    assert set(found["box"].values()) == {0.25}
    assert over_full_nearest(TableSizes(points[:2], ())) == {}


def test_the_smallest_table_as_good_and_the_exponent() -> None:
    affine = tuple(made("affine", size, 9, 1e-4 * (8192 / size) ** 0.7) for size in (4096, 8192, 16384))
    sizes = TableSizes((made("nearest", 999, 100, 1.0), made("nearest", 9999, 8503, 1.1e-4), *affine), ())
    assert least_bytes_as_good(sizes) == 8192
    assert slope(affine, "heading_rad") == pytest.approx(-0.7)
    assert least_bytes_as_good(TableSizes((made("nearest", 9, 9, 1e-9), *affine), ())) is None


@from_ci
@pytest.mark.usefixtures("few_sizes")
def test_the_command_draws_and_tells(
    library: Library, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_library(library, tmp_path / "lib.h5")
    picture = tmp_path / "sizes.png"
    options = ("--test-states", "4", "--swims", "visited", "--out", str(picture), "--json")
    assert run_command(["study", "tables", str(tmp_path / "lib.h5"), *options]) == 0
    output = json.loads(capsys.readouterr().out)
    assert [point["kind"] for point in output["by_size"]] == ["nearest", "nearest", "affine", "affine"]
    assert all(point["box"]["position_m"] > 0.0 for point in output["by_size"] + output["by_library"])
    last, full = output["by_size"][-1]["visited"], output["by_size"][1]["visited"]
    ratio = output["affine_64_kib_over_full_nearest"]["visited"]
    assert ratio["heading_rad"] == pytest.approx(last["heading_rad"] / full["heading_rad"])
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert run_command(["study", "tables", str(tmp_path / "none.h5")]) == 2


@from_ci
def test_history_as_an_input_is_worth_most_where_limbs_tire(monkeypatch: pytest.MonkeyPatch) -> None:
    fading = list(history.VARIANTS)[-1]
    if not FULL:
        monkeypatch.setattr(history, "VARIANTS", {fading: history.VARIANTS[fading]})
    results = history.measure_limb_use(robot(), count(60, 400), count(8, 100), 1)
    tiring = [result for result in results if result.variant != "as described"]
    assert len(tiring) == count(1, 2)
    better = count(80, 30) / 100.0
    for result in tiring:
        assert result.largest_mm > 1.0
        for name in ("position_m", "heading_rad"):
            assert result.with_use[name] < better * result.without[name] < better * result.restarted[name]
    for plain in results[: len(results) - len(tiring)]:
        assert plain.largest_mm < 0.1
        assert plain.with_use["position_m"] < 1e-4
    heights = sorted(bar.get_height() for bar in HistoryStudy(results, 1).plot().axes[0].patches)
    errors = [getattr(r, t)["position_m"] for r in results for t in ("restarted", "without", "with_use")]
    assert heights == pytest.approx(sorted(1e3 * error for error in errors))


def test_the_picture_has_both_kinds_and_units() -> None:
    points = tuple(
        made(kind, size, states, 1e-3 / states)
        for kind in ("nearest", "affine")
        for size, states in ((4000, 10), (9000, 30))
    )
    figure = TableSizes(points, points[2:]).plot()
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert labels == ["position error (mm)", "heading error (degrees)", "position error (mm)"]
    for axes in figure.axes:
        assert axes.get_xscale() == axes.get_yscale() == "log"
        assert len({line.get_color() for line in axes.lines if line.get_marker() in "os"}) == 2
    drawn = figure.axes[0].lines[0]
    assert np.asarray(drawn.get_xdata()) == pytest.approx([4000 / 1024, 9000 / 1024])
    assert np.asarray(drawn.get_ydata()) == pytest.approx([0.1, 1.0 / 30.0])
