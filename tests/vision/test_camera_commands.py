"""``frogkick camera``: from corners and boards to a file, from the file to an error map; wrong input."""

from __future__ import annotations

import json
import re
import urllib.request
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from tests.cli.commands import frogkick
from tests.conftest import count
from tests.vision.scenes import calibration, scene

from frogkick.core.poses import Fix
from frogkick.front.cameras import track_camera
from frogkick.runs.tracked_fixes import parse_line
from frogkick.vision.board import Board
from frogkick.vision.calibration import read_calibration, write_calibration
from frogkick.vision.tags import dictionary, picture_order

USUAL = scene()


def corners_file(folder: Path) -> Path:
    file = folder / "corners.toml"
    rows = ", ".join(f"[{x:.3f}, {y:.3f}]" for x, y in USUAL.corners_px())
    file.write_text(f"corners_px = [{rows}]\n")
    return file


def calibrated(folder: Path, capsys: pytest.CaptureFixture[str]) -> Path:
    out = folder / "camera.toml"
    done = frogkick(
        capsys, "camera", "calibrate", "--pool", "1.2x0.9", "--image", "640x480", "--corners",
        corners_file(folder), "--camera-height-m", "1.35", "--tag-height-mm", "12", "--out", out, "--json",
    )  # fmt: skip
    assert done.code == 0, done.stderr
    assert done.json["px_per_mm"] == pytest.approx(0.47, abs=0.02)
    farthest = np.hypot(0.7, 0.65) / (1.35 - 0.012)  # the camera over (0.7, 0.25), the corner (0, 0.9)
    assert done.json["heave_shift_mm_per_mm"] == pytest.approx(farthest, abs=0.01)
    return out


def test_calibrate_and_check(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = calibrated(tmp_path, capsys)
    assert read_calibration(file).tag.height_m == pytest.approx(0.012)
    done = frogkick(capsys, "camera", "check", file, "--grid", "3x2", "--out", tmp_path / "map", "--json")
    assert done.code == 0, done.stderr
    assert done.json["found"] == done.json["places"] == 6
    assert done.json["max_mm"] < 1.0 and done.json["heading_max_deg"] < 0.5
    assert json.loads((tmp_path / "map" / "error_map.json").read_text())["map"] == done.json["map"]
    picture = cv2.imread(str(tmp_path / "map" / "error_map.png"))
    assert picture is not None and picture.std() > 5


def test_check_says_what_is_beyond_the_limit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = calibrated(tmp_path, capsys)
    truth = np.array([[0.2, 0.2], [0.9, 0.6]])
    seen = USUAL.view.pixels(np.c_[truth, np.zeros(2)])
    points = tmp_path / "points.csv"

    def write(off_px: float) -> None:
        rows = [f"{x + off_px},{y},{a},{b}" for (x, y), (a, b) in zip(seen, truth, strict=True)]
        points.write_text("x_px,y_px,x_m,y_m\n" + "\n".join(rows) + "\n")

    write(0.0)
    assert frogkick(capsys, "camera", "check", file, "--points", points).code == 0
    write(2.0)
    done = frogkick(capsys, "camera", "check", file, "--points", points, "--json")
    assert done.code == 1
    assert 3.0 < done.json["max_mm"] < 6.0
    assert "2 of 2 tags found, largest error" in done.stderr


def test_check_with_tags_laid_down(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = calibrated(tmp_path, capsys)
    rng = np.random.default_rng(21)
    rows = ["image,x_m,y_m,heading_deg"]
    for k, (x, y, turn) in enumerate([(0.3, 0.2, 10.0), (1.0, 0.7, -120.0)]):
        cv2.imwrite(str(tmp_path / f"{k}.png"), USUAL.picture((x, y, float(np.deg2rad(turn))), rng))
        rows.append(f"{k}.png,{x},{y},{turn}")
    (tmp_path / "places.csv").write_text("\n".join(rows) + "\n")
    done = frogkick(capsys, "camera", "check", file, "--places", tmp_path / "places.csv", "--json")
    assert done.code == 0, done.stderr
    assert done.json["found"] == 2
    turned = [row.replace("10.0", "190.0").replace("-120.0", "60.0") for row in rows]
    (tmp_path / "turned.csv").write_text("\n".join(turned) + "\n")
    output = frogkick(
        capsys, "camera", "check", file, "--places", tmp_path / "turned.csv"
    ).stderr.splitlines()
    assert "all headings are off by 180 degrees" in output[1], output
    assert "(0.3, 0.2) m: " in output[2] and "(1, 0.7) m: " in output[2]
    (tmp_path / "1.png").write_bytes(b"none")
    wrong = frogkick(capsys, "camera", "check", file, "--places", tmp_path / "places.csv")
    assert wrong.code == 2
    assert "1.png' is not a readable picture" in wrong.stderr


def board_pictures(folder: Path, kind: str) -> tuple[Path, np.ndarray]:
    """A camera matrix, and its pictures of a board of 9 x 6 squares of 40 mm in several poses."""
    cell = 60
    if kind == "charuco":
        flat = Board(kind, 9, 6, 0.04).charuco().generateImage((9 * cell, 6 * cell))
    else:
        flat = (255 * ((np.indices((6, 9)).sum(axis=0)) % 2)).astype(np.uint8)
        flat = np.kron(flat, np.ones((cell, cell), np.uint8))
    flat = cv2.copyMakeBorder(flat, cell, cell, cell, cell, cv2.BORDER_CONSTANT, value=255)
    matrix = np.array([[640.0, 0, 319.5], [0, 640.0, 239.5], [0, 0, 1]])
    flat = cv2.GaussianBlur(flat, (0, 0), 1.2)  # or the smaller pictures would alias
    folder.mkdir()
    tilts = [(0, 0), (0.4, 0), (-0.4, 0.1), (0, 0.4), (0.1, -0.4), (0.3, 0.3), (-0.3, 0.3), (0.3, -0.3)]
    for k, tilt in enumerate(tilts[: count(8, 8, 5)]):
        turn, _ = cv2.Rodrigues(np.array([*tilt, 0.1 * k - 0.3]))
        # Into every corner of the picture: a lens is not known where no board was.
        shift = np.array([0.16 * (-1) ** k, 0.1 * (-1) ** (k // 2), 0.7 + 0.02 * k])
        # A pixel of the drawn board to metres, its centre to the origin.
        scale = 0.04 / cell
        home = np.array(
            [[scale, 0, -scale * (11 * cell - 1) / 2], [0, scale, -scale * (8 * cell - 1) / 2], [0, 0, 1]]
        )
        view = matrix @ np.c_[turn[:, :2], shift] @ home
        image = cv2.warpPerspective(flat, view, (640, 480), flags=cv2.INTER_AREA, borderValue=(90.0,))
        cv2.imwrite(str(folder / f"{k}.png"), cv2.GaussianBlur(image, (0, 0), 0.7))
    return folder, matrix


@pytest.mark.parametrize("kind", ["chessboard", "charuco"])
def test_a_board_gives_the_lens(kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, matrix = board_pictures(tmp_path / "board", kind)
    out = tmp_path / "camera.toml"
    done = frogkick(
        capsys, "camera", "calibrate", "--pool", "1.2x0.9", "--corners", corners_file(tmp_path),
        "--board", kind, "--squares", "9x6", "--square-mm", "40", "--pictures", folder,
        "--tag-height-mm", "12", "--out", out, "--json",
    )  # fmt: skip
    assert done.code == 0, done.stderr
    assert done.json["lens_rms_px"] < 0.3
    lens = read_calibration(out).lens
    assert lens is not None
    assert np.allclose(lens.matrix_px[:2], matrix[:2], atol=12.0)
    assert np.allclose(done.json["camera_m"], USUAL.view.place_m, atol=0.03)


def test_a_board_laid_down_gives_the_plane(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cells = (np.indices((6, 9)).sum(axis=0) % 2).astype(np.float32)
    # The renderer prints squares: 9 x 9 cells with the board in the upper rows, 60 mm each, white around.
    whole = np.pad(np.vstack([cells, np.ones((3, 9), np.float32)]), 1, constant_values=1.0)
    still = scene(light_slope=0.0)
    size = 0.06 * 9
    flat = type(still)(tag_height_m=0.0, conditions=still.conditions)
    # The printed top to +y: columns along +x, rows along -y, 60 mm each.
    image = flat.picture(None, np.random.default_rng(22), [(whole, 0.6, 0.45, np.pi / 2, size)])
    cv2.imwrite(str(tmp_path / "plane.png"), image)
    out = tmp_path / "camera.toml"
    done = frogkick(
        capsys, "camera", "calibrate", "--pool", "1.2x0.9", "--board", "chessboard", "--squares", "9x6",
        "--square-mm", "60", "--plane-picture", tmp_path / "plane.png",
        "--board-at", f"{0.6 - 0.21},{0.45 + 0.21}", "--out", out, "--json",
    )  # fmt: skip
    assert done.code == 0, done.stderr
    assert done.json["points"] == 40 and done.json["rms_px"] < 0.2
    truth = np.array([[0.3, 0.3], [0.9, 0.7]])
    made = read_calibration(out)
    assert np.allclose(made.pool(USUAL.view.pixels(np.c_[truth, np.zeros(2)])), truth, atol=1e-3)


SEEN = ("--image", "640x480", "--camera-height-m", "1.35")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--pool", "1.2", "--corners", "c.toml", "--out", "o.toml"], "--pool '1.2' is not two numbers"),
        (["--pool", "1.2,0.9", "--out", "o.toml"], "not two numbers: write it like 1.2x0.9"),
        (["--pool", "1.2x0.9", "--out", "o.toml"], "give exactly one, the pool's corners"),
        (["--pool", "1.2x0.9", "--corners", "c.toml", "--out", "o.toml"], "give its size, such as --image"),
        (
            ["--pool", "1.2x0.9", "--corners", "none.toml", "--image", "640x480", "--out", "o.toml"],
            "corners file 'none.toml' does not exist",
        ),
        (
            ["--pool", "1.2x0.9", "--corners", "line.toml", "--image", "640x480", "--out", "o.toml"],
            "lie on one line",
        ),
        (
            ["--pool", "1.2x0.9", "--board", "chessboard", "--plane-picture", "grey.png", "--out", "o.toml"],
            "no chessboard board of 9 x 6 squares is seen",
        ),
        (
            [
                "--pool",
                "1.2x0.9",
                "--corners",
                "c.toml",
                "--board",
                "chessboard",
                "--pictures",
                ".",
                "--out",
                "o.toml",
            ],
            "seen in 0 of 1 pictures, needed are 5",
        ),
        (
            ["--pool", "1.2x0.9", "--corners", "c.toml", "--pictures", ".", "--out", "o.toml"],
            "give its kind with --board",
        ),
        (
            ["--pool", "0.9x1.2", *SEEN, "--corners", "c.toml", "--out", "o.toml"],
            "length appears 1.78 times too long for its width: give --pool as length x width",
        ),
        (
            ["--pool", "1.2x0.9", *SEEN, "--corners", "quarter.toml", "--out", "o.toml"],
            "the corners along the length first, (0, 0), (length, 0)",
        ),
        (
            ["--pool", "1200x900", *SEEN, "--corners", "c.toml", "--out", "o.toml"],
            "--pool is 1200 x 900 m, but each side must be 0.05 to 100 m: give length x width in m",
        ),
        (
            [
                "--pool",
                "1.2x0.9",
                *SEEN,
                "--tag-height-mm",
                "0.012",
                "--corners",
                "c.toml",
                "--out",
                "o.toml",
            ],
            "--tag-height-mm is 0.012 mm: give mm",
        ),
        (
            ["--pool", "1.2x0.9", "--board", "circles", "--plane-picture", "grey.png", "--out", "o.toml"],
            "board 'circles' is not known",
        ),
    ],
)
def test_wrong_input_is_one_line(
    arguments: list[str], says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    corners_file(tmp_path).rename(tmp_path / "c.toml")
    rows = np.roll(USUAL.corners_px(), -1, axis=0).tolist()
    (tmp_path / "quarter.toml").write_text(f"corners_px = {rows}\n")
    (tmp_path / "line.toml").write_text("corners_px = [[10, 400], [300, 400], [600, 400], [30, 30]]\n")
    cv2.imwrite("grey.png", np.full((480, 640), 128, np.uint8))
    done = frogkick(capsys, "camera", "calibrate", *arguments)
    assert done.code == 2
    assert says in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "o.toml").exists()


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, np.ndarray]:
    """A calibration, pictures of a moving tag after four without one, and the poses of the tag."""
    folder = tmp_path_factory.mktemp("filmed")
    (folder / "pictures").mkdir()
    rng = np.random.default_rng(8)
    poses = np.array([(0.4 + 0.005 * k, 0.5 - 0.003 * k, 0.3 + 0.02 * k) for k in range(24)])
    for k in range(4 + len(poses)):
        pose = None if k < 4 else tuple(map(float, poses[k - 4]))
        cv2.imwrite(str(folder / "pictures" / f"{k:03d}.png"), USUAL.picture(pose, rng))
    write_calibration(folder / "camera.toml", calibration(USUAL))
    return folder / "camera.toml", folder / "pictures", poses


def test_a_tag_is_tracked_without_a_robot(
    filmed: tuple[Path, Path, np.ndarray], capsys: pytest.CaptureFixture[str]
) -> None:
    file, pictures, poses = filmed
    done = frogkick(capsys, "camera", "track", file, "--source", pictures)
    assert done.code == 0, done.stderr
    lines = [parse_line(line) for line in done.stdout.splitlines()]
    assert 1 < len(lines) <= len(poses)
    begun = 0
    for age_s, pose in lines:  # each is one of the poses, in their order
        apart = np.abs(poses[begun:] - pose).max(axis=1)
        begun += int(apart.argmin()) + 1
        assert apart.min() < 2e-3 and 0.0 <= age_s < 5.0
    line = r"frogkick: (\d+) fixes from (\d+) pictures, [\d.]+ a second; pictures without a fix: "
    output = re.match(line, done.stderr)
    assert output is not None and int(output[1]) == len(lines) and int(output[2]) >= len(lines) + 1
    asked = frogkick(capsys, "camera", "track", file, "--source", pictures, "--json", "--seconds", "30")
    assert asked.code == 0 and asked.json["fixes"] == asked.json["reasons"]["found"] > 5
    assert asked.json["pictures"] == sum(asked.json["reasons"].values()) and asked.json["rate_hz"] > 0.5


def test_a_page_shows_what_the_camera_sees(
    filmed: tuple[Path, Path, np.ndarray], capsys: pytest.CaptureFixture[str]
) -> None:
    file, pictures, poses = filmed
    seen: list[dict[str, Any]] = []
    address = ""

    def look(_fix: Fix) -> None:
        nonlocal address
        output = re.search(r"what the camera sees is drawn at (\S+)", capsys.readouterr().err)
        address = output[1] if output else address
        with urllib.request.urlopen(f"{address}state.json", timeout=60.0) as answer:
            seen.append(json.load(answer))

    found = track_camera(file, str(pictures), view=True, each=look)
    assert found["fixes"] == len(seen) > 5
    fixes = seen[-1]["fixes"]
    assert fixes and np.abs(poses[:, :2] - fixes[-1][:2]).max(axis=1).min() < 2e-3
    assert len(seen[-1]["robot"]) >= 4 and not seen[-1]["path"], "the tag's outline, and no path"


def test_tracking_tells_what_is_wrong(
    filmed: tuple[Path, Path, np.ndarray], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, pictures, _ = filmed
    cv2.imwrite(str(tmp_path / "0.png"), cv2.imread(str(pictures / "000.png")))
    without = frogkick(capsys, "camera", "track", file, "--source", tmp_path, "--json")
    assert (without.code, without.json["fixes"], without.json["rate_hz"]) == (1, 0, 0.0)
    for source, more, says in (
        (tmp_path / "none", (), "none"),
        (pictures, ("--seconds", "0"), "give more than 0"),
    ):
        done = frogkick(capsys, "camera", "track", file, "--source", source, *more)
        assert done.code == 2 and says in done.stderr and done.stderr.count("\n") == 1


def test_a_printed_tag_is_to_scale_and_points_forward(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """OpenCV finds the tag on the page: its corners are as far apart as its size, the arrow is at its top."""
    done = frogkick(capsys, "camera", "tag", "--out", tmp_path / "t.png", "--tag-id", "7", "--json")
    assert done.code == 0
    image = cv2.imread(str(tmp_path / "t.png"), cv2.IMREAD_GRAYSCALE)
    per_mm = image.shape[1] / done.json["page_mm"][0]
    assert image.shape[0] / done.json["page_mm"][1] == pytest.approx(per_mm, rel=2e-3)
    corners, numbers, _ = cv2.aruco.ArucoDetector(dictionary()).detectMarkers(image)
    assert numbers.ravel().tolist() == [7]
    top_left, top_right, bottom_right, _ = picture_order(corners[0][0].astype(np.float64))
    assert np.hypot(*(top_right - top_left)) / per_mm == pytest.approx(47.0, abs=0.1)
    assert top_left[0] < top_right[0] and bottom_right[1] > top_right[1], "the page is not turned"
    above = image[: int(top_left[1] - 6 * per_mm), image.shape[1] // 2 - 2 : image.shape[1] // 2 + 2]
    assert (above < 100).any(), "the arrow is above the picture's top"
    first = frogkick(capsys, "camera", "tag", "--out", tmp_path / "a.pdf")
    again = frogkick(capsys, "camera", "tag", "--out", tmp_path / "b.pdf")
    assert first.code == again.code == 0 and (tmp_path / "a.pdf").read_bytes()[:5] == b"%PDF-"
    assert (tmp_path / "a.pdf").read_bytes() == (tmp_path / "b.pdf").read_bytes()
    for more, says in (
        (("--tag-id", "9999"), "has no tag 9999"),
        (("--tag-size-mm", "900"), "give a size that makes it 1 to 250 mm"),
        (("--tag-family", "tag16h5"), "is not known"),
    ):
        output = frogkick(capsys, "camera", "tag", "--out", tmp_path / "c.pdf", *more)
        assert output.code == 2 and says in output.stderr and not (tmp_path / "c.pdf").exists()
    assert frogkick(capsys, "camera", "tag", "--out", tmp_path / "c.doc").code == 2


def test_a_picture_is_taken(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "pictures").mkdir()
    taken = USUAL.picture((0.6, 0.4, 0.1), np.random.default_rng(3))
    cv2.imwrite(str(tmp_path / "pictures" / "a.png"), taken)
    source = ("--source", tmp_path / "pictures", "--json")
    done = frogkick(capsys, "camera", "picture", "--out", tmp_path / "pool.png", *source)
    assert done.code == 0 and done.json["image_px"] == [640, 480], done.stderr
    assert np.array_equal(cv2.imread(str(tmp_path / "pool.png"), cv2.IMREAD_GRAYSCALE), taken)
    refused = frogkick(capsys, "camera", "picture", "--out", tmp_path / "pool.gif", *source)
    assert refused.code == 2 and "give a name in .png or .jpg" in refused.stderr
    gone = frogkick(
        capsys, "camera", "picture", "--out", tmp_path / "b.png", "--source", "http://127.0.0.1:9/camera.mjpg"
    )
    assert gone.code == 2 and gone.stderr.count("\n") == 1 and "cannot be opened" in gone.stderr
