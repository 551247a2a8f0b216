"""``frogkick camera``: calibrate and check the camera over the pool, and track or print the tag."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Annotated, Any

import typer

from frogkick.cli import options as opt
from frogkick.cli.common import Result, json_text, text_lines
from frogkick.core.errors import InputError
from frogkick.core.files import write_text

FamilyOption = Annotated[str, "Tag family: tag36h11, or tagStandard41h12 (needs the extra 'apriltag')."]
TagIdOption = Annotated[int, "Number of the tag in its family."]
TagSizeOption = Annotated[
    float, "Side of the black square of tag36h11, or of the white square of tagStandard41h12."
]
SourceOption = Annotated[
    str, "Camera number, network camera's address (http:, rtsp:), video, or folder of pictures."
]


def _pair(text: str, option: str) -> tuple[float, float]:
    parts = re.fullmatch(r"([0-9.]+)x([0-9.]+)", text.strip())
    try:
        if parts:
            return float(parts[1]), float(parts[2])
    except ValueError:
        pass
    raise InputError(f"{option} {text!r} is not two numbers: write it like 1.2x0.9")


def _whole_pair(text: str, option: str) -> tuple[int, int]:
    first, second = _pair(text, option)
    if first != int(first) or second != int(second):
        raise InputError(f"{option} {text!r} is not two whole numbers: write it like 9x6")
    return int(first), int(second)


def calibrate(
    pool: Annotated[str, "Length and width of the pool, m.", opt.With(metavar="LxW")],
    out: Annotated[Path, "Calibration file to write (.toml)."],
    corners: Annotated[
        Path | None, "File of the pool's corners in pixels (.toml, .csv), ordered (0,0), (L,0), (L,W), (0,W)."
    ] = None,
    corner_height_mm: Annotated[
        float, "Height of the corners or of the board above the water; negative if below."
    ] = 0.0,
    image: Annotated[str | None, "Size of the camera's pictures, px.", opt.With(metavar="WxH")] = None,
    camera_height_m: Annotated[
        float | None, "Measured height of the camera above the water; not needed with a board."
    ] = None,
    board: Annotated[
        str | None, "Calibrate the lens from pictures of a board: chessboard or charuco."
    ] = None,
    squares: Annotated[
        str, "Number of squares of the board, columns and rows.", opt.With(metavar="CxR")
    ] = "9x6",
    square_mm: Annotated[float, "Side of a square of the board."] = 25.0,
    pictures: Annotated[Path | None, "Folder of pictures of the board."] = None,
    plane_picture: Annotated[
        Path | None, "Picture of the board lying on the water's plane; replaces --corners."
    ] = None,
    board_at: Annotated[
        str,
        "Position of the board's first inner corner in the pool, m. Its rows run along the pool.",
        opt.With(metavar="X,Y"),
    ] = "0,0",
    tag_family: FamilyOption = "tag36h11",
    tag_id: TagIdOption = 0,
    tag_size_mm: TagSizeOption = 47.0,
    tag_height_mm: Annotated[float, "Height of the tag above the water; negative if below."] = 0.0,
    tag_height_sd_mm: Annotated[float, "Standard deviation of the tag's height in waves."] = 0.5,
    tag_tilt_sd_deg: Annotated[
        float, "Standard deviation of the tag's tilt in waves and while the robot swims."
    ] = 1.15,
    tag_heading_deg: Annotated[
        float, "Direction of the tag's top edge, counter-clockwise from the robot's forward axis."
    ] = 0.0,
    tag_at_mm: Annotated[
        str, "Position of the tag's centre on the robot: forward, left.", opt.With(metavar="X,Y")
    ] = "0,0",
) -> Result:
    """Calibrate the camera from the pool's four corners, or from a board that lies on the water's plane.

    With --board and --pictures the lens is calibrated as well.
    """
    from frogkick.front.cameras import Board, Tag, calibrate_camera

    tag = Tag(
        family=tag_family,
        id=tag_id,
        size_m=tag_size_mm / 1e3,
        height_m=tag_height_mm / 1e3,
        height_sd_m=tag_height_sd_mm / 1e3,
        tilt_sd_rad=math.radians(tag_tilt_sd_deg),
        mount_heading_rad=math.radians(tag_heading_deg),
        offset_body_m=_signed_pair(tag_at_mm, "--tag-at-mm", 1e-3),
    )
    made = opt.call(
        calibrate_camera,
        locals(),
        pool_m=_pair(pool, "--pool"),
        tag=tag,
        image_px=None if image is None else _whole_pair(image, "--image"),
        height_m=corner_height_mm / 1e3,
        board=None if board is None else Board(board, *_whole_pair(squares, "--squares"), square_mm / 1e3),
        board_at_m=(0.0, 0.0) if plane_picture is None else _signed_pair(board_at, "--board-at", 1.0),
    )
    made.save(out)
    return Result({**made.as_json(), "out": str(out)})


def _signed_pair(text: str, option: str, unit: float) -> tuple[float, float]:
    try:
        first, second = (unit * float(part) for part in text.split(","))
    except ValueError as error:
        raise InputError(f"{option} {text!r} is not two numbers: write it like 10,-5") from error
    if not (abs(first) < 100 and abs(second) < 100):
        raise InputError(f"{option} {text!r} is beyond the limit of 100 m: check the unit")
    return first, second


def check(
    calibration: Annotated[Path, typer.Argument(help="What 'camera calibrate' wrote.")],
    points: Annotated[Path | None, "CSV of marked points with the columns x_px, y_px, x_m, y_m."] = None,
    places: Annotated[
        Path | None,
        "CSV of pictures of the tag at known poses, with the columns image, x_m, y_m, heading_deg.",
    ] = None,
    grid: Annotated[
        str, "Number of rendered tags, used without --points and --places.", opt.With(metavar="NxM")
    ] = "9x7",
    blur_px: Annotated[float, "Blur of the rendered pictures."] = 0.6,
    noise: Annotated[float, "Noise of the rendered pictures, in grey levels."] = 2.0,
    wave_mm: Annotated[float, "Standard deviation of the rendered tag's heave."] = 0.0,
    limit_mm: Annotated[float, "Largest position error allowed.", opt.With(0.0)] = 1.0,
    limit_deg: Annotated[float, "Largest heading error allowed.", opt.With(0.0)] = 0.5,
    out: Annotated[Path | None, "Folder for error_map.json and error_map.png.", opt.With(folder=True)] = None,
    seed: opt.Seed = 0,
) -> Result:
    """Map the position errors over the pool, in mm.

    Without --points and --places the pictures are rendered, with the calibration taken as true. They show
    the best that camera, pool and tag can reach. Marked points and tags at known poses show the error of the
    calibration itself. The exit code is 1 if an error is above its limit or a tag was not found.
    """
    from frogkick.front.cameras import Conditions, check_camera

    rendering: dict[str, Any] = {}
    if points is None and places is None:
        rendering["tags"] = _whole_pair(grid, "--grid")
        rendering["conditions"] = Conditions(blur_px=blur_px, noise=noise, wave_height_m=wave_mm / 1e3)
    checked = opt.call(check_camera, locals(), **rendering)
    facts, values = checked.summary(), checked.as_json()
    if out is not None:
        checked.draw(out / "error_map.png")
        write_text(out / "error_map.json", json_text(values) + "\n")
    failed = (
        f"camera check: {facts['found']} of {facts['places']} tags found, largest error "
        f"{facts['max_mm']:.3f} mm (limit {limit_mm:g}), {facts['heading_max_deg']:.3f} degrees "
        f"(limit {limit_deg:g})"
    )
    remarks = [] if facts["within"] else [failed, *checked.remarks]
    return Result(values, text_lines(facts), facts["within"], remarks)


def track(
    calibration: Annotated[Path, typer.Argument(help="What 'camera calibrate' wrote.")],
    source: SourceOption = "0",
    seconds: Annotated[
        float | None, "Time to track; default: to the end of the source, or until Ctrl-C."
    ] = None,
    view: Annotated[bool, "Draw the pictures, the tag and the fixes in the browser."] = False,
    json: bool = False,
) -> Result:
    """Print the tag's pose in each picture. No robot is needed.

    Each line is x_m y_m heading_rad age_s: the pose in the pool's frame and the age of its picture. The
    lines may be piped into 'frogkick run --fixes stdin'. The exit code is 1 if no picture shows the tag.
    """
    from frogkick.front.cameras import track_camera

    def print_fix(fix: Any) -> None:
        x_m, y_m, heading_rad = fix.pose_world
        print(f"{x_m:.5f} {y_m:.5f} {heading_rad:.5f} {fix.delay_s:.4f}", flush=True)

    each = (lambda _fix: None) if json else print_fix
    found = track_camera(calibration, source, seconds=seconds, view=view, each=each)
    without = {reason: count for reason, count in found["reasons"].items() if reason != "found"}
    why = ", ".join(f"{count} x {reason}" for reason, count in without.items())
    remark = (
        f"{found['fixes']} fixes from {found['pictures']} pictures, {found['rate_hz']:.1f} a second"
        f"{f'; pictures without a fix: {why}' if why else ''}"
    )
    remarks = [remark]
    if found["behind_s"]:
        remarks.append(
            f"the pictures took {found['behind_s']:.1f} s longer to play than to take: a busy machine"
        )
    return Result(found, [], bool(found["fixes"]), remarks)


def picture(out: Annotated[Path, "Picture to write (.png or .jpg)."], source: SourceOption = "0") -> Result:
    """Take a picture, in which the pool's corners can be found.

    A camera has a second to find its exposure.
    """
    from frogkick.front.cameras import take_picture

    width_px, height_px = take_picture(out, source)
    return Result({"out": str(out), "image_px": [width_px, height_px]})


def tag_page(
    out: Annotated[Path, "Page to print (.pdf, .svg or .png)."],
    tag_family: FamilyOption = "tag36h11",
    tag_id: TagIdOption = 0,
    tag_size_mm: TagSizeOption = 47.0,
) -> Result:
    """Write a page with the tag at true scale, an arrow that points forward, and a ruler."""
    from frogkick.front.cameras import write_tag

    width_m, height_m = write_tag(out, family=tag_family, tag_id=tag_id, size_m=tag_size_mm / 1e3)
    page_mm = [1e3 * width_m, 1e3 * height_m]
    return Result({"out": str(out), "page_mm": page_mm, "tag_size_mm": tag_size_mm})
