"""Path files: what is taken, and one clear line for what is not."""

from __future__ import annotations

import math
import pathlib

import numpy as np
import pytest

from frogkick.core.errors import InputError
from frogkick.paths import from_csv


def write(folder: pathlib.Path, text: str) -> pathlib.Path:
    file = folder / "p.csv"
    file.write_text(text)
    return file


def test_published_file_keeps_points_and_tangents(frog2022_dir: pathlib.Path) -> None:
    file = frog2022_dir / "control" / "sinp3.csv"
    raw = np.loadtxt(file, delimiter=",")
    path = from_csv(file)
    assert len(path) == 100
    assert np.array_equal(path.x_m, raw[:, 0].astype(np.float32))
    assert path.tangent_rad == pytest.approx(np.arctan2(raw[:, 3], raw[:, 2]), abs=1e-6)
    assert path.name == "sinp3"


def test_points_alone_are_resampled(tmp_path: pathlib.Path) -> None:
    path = from_csv(write(tmp_path, "0,0\n1,0\n1,1\n"))
    assert len(path) == 100
    assert path.length_m == pytest.approx(2.0, abs=0.02)


def test_header_in_any_order_blank_lines_and_mark(tmp_path: pathlib.Path) -> None:
    path = from_csv(write(tmp_path, "\ufeffY_m, x_m, tangent_rad\n0,0,0\n\n0,1,0\n"))
    assert path.x_m.tolist() == [0.0, 1.0]
    path = from_csv(write(tmp_path, "x,y,dx,dy\n0,0,0,-2\n0,-1,0,-2\n"))
    assert path.tangent_rad == pytest.approx(-math.pi / 2)


def test_more_than_the_planner_holds_is_resampled(tmp_path: pathlib.Path) -> None:
    rows = "\n".join(f"{i / 200},0,1,0" for i in range(201))
    path = from_csv(write(tmp_path, rows))
    assert len(path) == 100
    assert path.length_m == pytest.approx(1.0)


def test_who_gives_more_points_is_told_what_becomes_of_them(tmp_path: pathlib.Path) -> None:
    """How far a zigzag's 201 points are beside the result; of three nothing is said."""
    reported: list[str] = []
    turns = "\n".join(f"{i / 200},{0.02 * (i % 40 // 20)}" for i in range(201))
    path = from_csv(write(tmp_path, turns), reported.append)
    (line,) = reported
    assert line.startswith("path file 'p.csv': 201 points are resampled to 100, the robot's limit; ")
    off_mm = float(line.split("at most ")[1].split(" mm")[0])
    given = np.loadtxt(turns.splitlines(), delimiter=",")
    ends = path.points_m[:-1], path.points_m[1:]
    step = ends[1] - ends[0]
    along = ((given[:, None] - ends[0]) * step).sum(axis=2) / (step**2).sum(axis=1)
    beside = np.linalg.norm(given[:, None] - (ends[0] + along.clip(0.0, 1.0)[..., None] * step), axis=2)
    assert off_mm == pytest.approx(1e3 * beside.min(axis=1).max(), rel=0.05)
    from_csv(write(tmp_path, "0,0\n1,0\n1,1\n"), reported.append)
    assert len(reported) == 1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ("\n\n", "no rows"),
        ("x,y\n", "empty"),
        ("1,2\n", "1 point"),
        ("1,2\n1,2\n", "no length"),
        ("1,2,3,4,5\n", "5 columns"),
        ("1,2,3\n2,2,3\n", "3 columns"),
        ("x,y,z\n1,2,3\n", "unknown column 'z'"),
        ("x,tangent_rd\n1,2\n", "did you mean 'tangent_rad'"),
        ("x,x\n1,2\n", "twice"),
        ("x,dx,dy\n1,2,3\n", "'y' is missing"),
        ("x,y,dx\n1,2,3\n", "'dy' is missing"),
        ("x,y,dx,dy,tangent_rad\n0,0,1,0,0\n1,0,1,0,0\n", "tangent_rad and dx, dy are both given: keep one"),
        ("x,y,tangent_rad,dy\n0,0,0,1\n1,0,0,1\n", "tangent_rad and dx, dy are both given: keep one"),
        ("1,2\n3,nan\n", "row 2 column 'y' is 'nan'"),
        ("1,2\n3,inf\n", "row 2 column 'y' is 'inf'"),
        ("x,y\n1,2\n3,\n", "row 3 column 'y' is ''"),
        ("1,2\nabc,3\n", "row 2 column 'x' is 'abc'"),
        ("1,2\n3\n", "row 2 has 1 columns"),
        ("1,2,0,0\n3,4,1,1\n", "row 1: the tangent"),
        ("1,2\0\n3,4\n", "not text"),
        ("x;y\n0,1;0,2\n", "separated by ';': write commas"),
        ("0;0\n1;0\n", "separated by ';': write commas"),
        ("x\ty\n0\t0\n", "separated by '.t': write commas"),
        ("0,0\n1e308,0\n-1e308,1\n", "point 1 lies at .1e.308, 0. m, the limit is 1000 m"),
        ("x,y,tangent_rad\n0,0,45\n1,1,45\n2,2,30\n", "up to 45, .* degrees off .*: give radians"),
        ("x,y,tangent_rad\n0,0,45\n", "1 point"),
        ("0,0\n450,0\n", "450 m, more than 50 m: coordinates are in metres, are these mm"),
    ],
)
def test_bad_files(tmp_path: pathlib.Path, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        from_csv(write(tmp_path, text))
    assert "\n" not in str(caught.value)


def test_tangents_of_several_turns_are_taken(tmp_path: pathlib.Path) -> None:
    turn = np.linspace(0.0, 5.0 * math.pi, 90)
    x, y = np.cumsum(0.05 * np.array([np.cos(turn), np.sin(turn)]), axis=1)
    rows = "".join(f"{a},{b},{c}\n" for a, b, c in zip(x, y, turn, strict=True))
    path = from_csv(write(tmp_path, "x,y,tangent_rad\n" + rows))
    assert np.cos(path.tangent_rad) == pytest.approx(np.cos(turn), abs=1e-5)


def test_missing_file_folder_and_binary(tmp_path: pathlib.Path) -> None:
    with pytest.raises(InputError, match="does not exist"):
        from_csv(tmp_path / "no.csv")
    with pytest.raises(InputError, match="not a file"):
        from_csv(tmp_path)
    binary = tmp_path / "b.csv"
    binary.write_bytes(b"\x89HDF\r\n\x1a\n\xff\xfe")
    with pytest.raises(InputError, match="not text"):
        from_csv(binary)
