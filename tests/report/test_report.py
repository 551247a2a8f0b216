"""The report: one file that needs no other, with all that it promises, and units on the axes."""

from __future__ import annotations

import base64
import functools
import os
import re
import subprocess
import sys
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from tests.conftest import from_ci
from tests.identification.made import robot
from tests.runs import rig

from frogkick.core.errors import InputError
from frogkick.core.progress import progress_bar
from frogkick.report.page import Section, Table, write_page
from frogkick.report.run_figure import run_figure
from frogkick.report.style import figure_uri
from frogkick.runs.runlog import PathChange, RunLog

# What a page can fetch from elsewhere.
FETCHING = {"src", "href", "data", "action", "poster", "srcset", "background"}


class Links(HTMLParser):
    """All links of a page, and its text."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.found: list[str] = []
        self.beside: list[str] = []
        self.tags: list[str] = []
        self.text = ""
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        links = self.beside if tag == "a" else self.found  # what is fetched when one asks for it
        links += [value or "" for name, value in attrs if name in FETCHING]

    def handle_data(self, data: str) -> None:
        self.text += data


def self_contained(page: str) -> Links:
    links = Links(page)
    assert all(link.startswith("data:image/png;base64,") for link in links.found)
    assert not {"script", "link", "iframe", "object"} & set(links.tags)
    outside = re.sub(r"data:image/png;base64,[A-Za-z0-9+/=]*", "", page)
    assert not re.search(r"https?:|url\(|@import|file:", outside)
    for link in links.found:
        picture = base64.b64decode(link.partition(",")[2], validate=True)
        assert picture.startswith(b"\x89PNG") and len(picture) > 5000
    return links


@functools.cache
def short_run() -> RunLog:
    recording = rig.swim("pool", "sine", 6.0)
    return recording.log()


@functools.cache
def figure() -> Figure:
    return run_figure(short_run(), "a run")


def test_every_axis_of_a_run_has_a_label_and_a_unit() -> None:
    axes = figure().axes
    assert len(axes) == 5
    for each in axes:
        assert each.get_title(loc="left"), "each panel says what it is"
        label = each.get_ylabel()
        assert label == "action" or re.search(r"\((cm|mm|s|mm, deg)\)$", label), label
    assert [each.get_xlabel() for each in axes if each.get_xlabel()] == [
        "x in the pool (cm)",
        "time (s)",
    ]
    track = axes[0]
    assert track.get_aspect() == 1.0
    legend = track.get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == [
        "desired path", "position fixes", "true track", "start of the path",
    ]  # fmt: skip
    path = short_run().path
    assert path is not None
    (desired,) = (line for line in track.lines if line.get_label() == "desired path")
    assert np.asarray(desired.get_xydata()) == pytest.approx(100.0 * path.points_m), "in the pool's frame"
    letters = [text.get_text() for text in track.texts]
    assert letters == [short_run().action_names[index] for index in short_run().decisions.action]


def test_errors_fit_into_their_panel_where_a_decision_has_no_plan() -> None:
    """Also with rows of NaN: they must not set the limits."""
    bare = run_figure(rig.without_plan(short_run(), (0,)), "a run")
    for panel in (figure().axes[3], bare.axes[3]):
        largest = max(np.nanmax(line.get_ydata()) for line in panel.lines)
        assert largest < panel.get_ylim()[1] < 2.0 * largest


def test_no_text_of_a_figure_is_cut_off() -> None:
    drawn = figure()
    renderer = FigureCanvasAgg(drawn).get_renderer()
    drawn.draw_without_rendering()
    width, height = drawn.bbox.width, drawn.bbox.height
    for axes in drawn.axes:
        for text in (axes.title, axes._left_title, axes.xaxis.label, axes.yaxis.label):
            if text.get_text():
                box = text.get_window_extent(renderer)
                assert box.x0 >= 0 and box.y0 >= 0 and box.x1 <= width and box.y1 <= height, text.get_text()


@from_ci
def test_the_same_run_gives_the_same_picture() -> None:
    assert figure_uri(run_figure(short_run(), "t")) == figure_uri(run_figure(short_run(), "t"))


@pytest.mark.parametrize(
    ("settings", "backend"),
    [("text.usetex: True\nfont.size: 30\nsavefig.dpi: 30\n", "agg"), ("", "nonsense")],
)
def test_a_figure_does_not_depend_on_the_user_s_settings(settings: str, backend: str, tmp_path: Path) -> None:
    """Not even where they need a program that is not there, or name a backend that is none."""
    (tmp_path / "matplotlibrc").write_text(settings)
    code = """
from frogkick.report.style import figure_uri, new_figure
with new_figure(2, 2) as figure:
    figure.subplots().plot([0, 1])
print(figure_uri(figure))
"""
    uris = [
        subprocess.run(
            [sys.executable, "-c", code], env=os.environ | added, capture_output=True, text=True, check=True
        ).stdout
        for added in ({}, {"MPLCONFIGDIR": str(tmp_path), "MPLBACKEND": backend})
    ]
    assert len(uris[0]) > 1000 and uris[1] == uris[0]


def test_paths_of_a_hold_and_limits_between_walls_are_drawn_as_what_they_are() -> None:
    run = short_run()
    assert run.path is not None
    end_m = run.path.points_m[-1]
    change = PathChange(2, run.path, hold=(float(end_m[0]), float(end_m[1]), 60))
    walls = {"wall_x_min_m": -0.1, "wall_x_max_m": 0.9, "wall_y_min_m": -0.2, "wall_y_max_m": 0.5}
    planner = {**run.planner, "wall_weight_per_m": 1.0, **walls}
    track = run_figure(replace(run, then=(change,), planner=planner), "a run").axes[0]
    lines = {line.get_label(): np.asarray(line.get_xydata()) for line in track.lines}
    points = 100.0 * run.path.points_m
    assert lines["desired path"] == pytest.approx(points)
    assert lines["approach of the hold"] == pytest.approx(points[:61])
    assert lines["circle of the hold"] == pytest.approx(points[60:])
    (limit,) = (patch for patch in track.patches if isinstance(patch, Rectangle))
    assert limit.get_bbox().extents.tolist() == pytest.approx([-10.0, -20.0, 90.0, 50.0])


def test_actions_with_words_for_names_are_numbers_on_the_track() -> None:
    words = tuple(f"stroke {name}" for name in short_run().action_names)
    axes = run_figure(replace(short_run(), action_names=words), "a run").axes
    decided = short_run().decisions.action
    assert [text.get_text() for text in axes[0].texts] == [str(index + 1) for index in decided]
    assert [text.get_text() for text in axes[2].get_yticklabels()][:2] == [
        f"{words[0]} (1)",
        f"{words[1]} (2)",
    ]


def test_a_page_escapes_what_it_is_given(tmp_path: Path) -> None:
    target = tmp_path / "deep" / "page.html"
    section = Section("<b>", ("a & b",), Table(("<th>",), [("<script>x</script>",)]))
    write_page(target, "1 < 2", "lead", [section])
    page = target.read_text(encoding="utf-8")
    assert "<script>" not in page and "&lt;script&gt;" in page and "1 &lt; 2" in page
    self_contained(page)
    with pytest.raises(InputError):
        write_page(target / "below a file.html", "t", "l", [])


@from_ci
def test_the_rings_report(tmp_path: Path) -> None:
    from frogkick.report.ring_page import write_ring_report
    from frogkick.ring import run_demo

    ring = run_demo(robot(), tmp_path, 10, 1, 0, progress_bar, paths=("line", "sine"), time_limit_s=4.0)
    target = tmp_path / "report.html"
    write_ring_report(target, ring)
    links = self_contained(target.read_text(encoding="utf-8"))
    assert links.beside == ["line.h5", "sine.h5"] and all((tmp_path / name).exists() for name in links.beside)
    assert len(links.found) == 4  # the robot, its actions, a picture for each path
    for reported in (
        "distance", "actions", "estimate", "mismatches", "guard limits violated", "flash", "RAM", "stack",
        "one plan at depth 1", "one plan at depth 4", "cycles at 64 MHz", "Line", "Sine", "15 Hz",
        "library, tables", "actions: which limbs to heat", "the largest mean distance", "robot in any period",
    ):  # fmt: skip
        assert reported in links.text, reported
    assert "nan" not in links.text.lower().split()
    assert str(tmp_path) not in links.text
