"""``frogkick camera``: calibrate the camera over the pool, check it, track the tag, print it."""

from __future__ import annotations

import math
import re
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from frogkick.cli.common import JsonOption, SeedOption, WholeLines, json_text, say, show
from frogkick.core.errors import InputError
from frogkick.core.files import require_writable, write_text

app = typer.Typer(
    cls=WholeLines,
    help="Calibrate the camera over the pool, check how far off it is, track the tag, print it.",
    no_args_is_help=True,
)

FamilyOption = Annotated[str, typer.Option(help="tag36h11, or tagStandard41h12 (with the extra 'apriltag').")]
TagIdOption = Annotated[int, typer.Option(help="Number of the tag in its family.")]
TagSizeOption = Annotated[
    float, typer.Option(help="Side of tag36h11's black, of tagStandard41h12's white square.")
]


def _pair(text: str, option: str) -> tuple[float, float]:
    parts = re.fullmatch(r"([0-9.]+)[x,]([0-9.]+)", text.strip())
    try:
        if parts:
            return float(parts[1]), float(parts[2])
    except ValueError:
        pass
    raise InputError(f"{option} {text!r} is not two numbers: write as 1.2x0.9")


def _whole_pair(text: str, option: str) -> tuple[int, int]:
    first, second = _pair(text, option)
    if first != int(first) or second != int(second):
        raise InputError(f"{option} {text!r} is not two whole numbers")
    return int(first), int(second)


@app.command()
def calibrate(
    pool: Annotated[str, typer.Option(help="Length x width of the pool, m.", metavar="LxW")],
    out: Annotated[Path, typer.Option(help="Calibration to write (.toml).")],
    corners: Annotated[
        Path | None, typer.Option(help="Pool corners in pixels (.toml, .csv): (0,0), (L,0), (L,W), (0,W).")
    ] = None,
    corner_height_mm: Annotated[
        float, typer.Option(help="Corners or board over the water; negative: under it.")
    ] = 0.0,
    image: Annotated[str | None, typer.Option(help="Size of the pictures, px.", metavar="WxH")] = None,
    camera_height_m: Annotated[
        float | None, typer.Option(help="Camera over the water, measured; not needed with a board.")
    ] = None,
    board: Annotated[str | None, typer.Option(help="Find the lens: chessboard or charuco.")] = None,
    squares: Annotated[str, typer.Option(help="Squares of the board.", metavar="CxR")] = "9x6",
    square_mm: Annotated[float, typer.Option(help="Side of a square.")] = 25.0,
    pictures: Annotated[Path | None, typer.Option(help="Folder of pictures of the board.")] = None,
    plane_picture: Annotated[
        Path | None, typer.Option(help="Instead of corners: the board laid on the water's plane.")
    ] = None,
    board_at: Annotated[
        str,
        typer.Option(help="Its first inner corner in the pool, m; its rows along the pool.", metavar="X,Y"),
    ] = "0,0",
    tag_family: FamilyOption = "tag36h11",
    tag_id: TagIdOption = 0,
    tag_size_mm: TagSizeOption = 47.0,
    tag_height_mm: Annotated[float, typer.Option(help="Over the water; negative: under it.")] = 0.0,
    tag_height_sd_mm: Annotated[float, typer.Option(help="By how much waves move it.")] = 0.5,
    tag_tilt_sd_deg: Annotated[float, typer.Option(help="By how much waves and swimming tilt it.")] = 1.15,
    tag_heading_deg: Annotated[
        float, typer.Option(help="Its picture's top, counter-clockwise from the robot's forward.")
    ] = 0.0,
    tag_at_mm: Annotated[
        str, typer.Option(help="Its centre on the robot: forward, left.", metavar="X,Y")
    ] = "0,0",
    json: JsonOption = False,
) -> None:
    """Calibrate from the pool's four corners or from a board laid on the water's plane; lens from a board."""
    from frogkick.front.cameras import Board, Tag, calibrate_camera

    require_writable(out)
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
    made = calibrate_camera(
        _pair(pool, "--pool"),
        tag,
        corners=corners,
        plane_picture=plane_picture,
        image_px=None if image is None else _whole_pair(image, "--image"),
        height_m=corner_height_mm / 1e3,
        camera_height_m=camera_height_m,
        board=None if board is None else Board(board, *_whole_pair(squares, "--squares"), square_mm / 1e3),
        pictures=pictures,
        board_at_m=(0.0, 0.0) if plane_picture is None else _signed_pair(board_at, "--board-at", 1.0),
    )
    made.save(out)
    show({**made.as_json(), "out": str(out)}, json)


def _signed_pair(text: str, option: str, unit: float) -> tuple[float, float]:
    try:
        first, second = (unit * float(part) for part in text.split(","))
    except ValueError as error:
        raise InputError(f"{option} {text!r} is not two numbers: write as 10,-5") from error
    if not (abs(first) < 100 and abs(second) < 100):
        raise InputError(f"{option} {text!r} is beyond 100 m")
    return first, second


@app.command()
def check(
    calibration: Annotated[Path, typer.Argument(help="What 'camera calibrate' wrote.")],
    points: Annotated[Path | None, typer.Option(help="Marked points: CSV with x_px, y_px, x_m, y_m.")] = None,
    places: Annotated[
        Path | None, typer.Option(help="The tag laid down: CSV with image, x_m, y_m, heading_deg.")
    ] = None,
    grid: Annotated[str, typer.Option(help="Without either: rendered tags, so many.", metavar="NxM")] = "9x7",
    blur_px: Annotated[float, typer.Option(help="Blur of the rendered pictures.")] = 0.6,
    noise: Annotated[float, typer.Option(help="Noise of the rendered pictures, grey levels.")] = 2.0,
    wave_mm: Annotated[float, typer.Option(help="Heave of the rendered tag, standard deviation.")] = 0.0,
    limit_mm: Annotated[float, typer.Option(help="Largest error allowed.", min=0.0)] = 1.0,
    limit_deg: Annotated[float, typer.Option(help="Largest heading error allowed.", min=0.0)] = 0.5,
    out: Annotated[Path | None, typer.Option(help="Folder for error_map.json and error_map.png.")] = None,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Map the errors over the pool, in mm. Exit 1 if one is above its limit or a place was not found.

    Rendered pictures (neither --points nor --places) show what camera, pool and tag can give at best, the
    calibration taken as true; marked points and tags laid down show what it is off by.
    """
    from frogkick.front.cameras import Rendering, check_camera

    require_writable(out, folder=True)
    rendering = None
    if points is None and places is None:
        rendering = Rendering(*_whole_pair(grid, "--grid"), blur_px, noise, wave_mm / 1e3, seed)
    checked = check_camera(
        calibration,
        points=points,
        places=places,
        rendering=rendering,
        limit_mm=limit_mm,
        limit_deg=limit_deg,
    )
    facts, told = checked.summary(), checked.as_json()
    if out is not None:
        checked.draw(out / "error_map.png")
        write_text(out / "error_map.json", json_text(told) + "\n")
    show(told if json else facts, json)
    if not facts["within"]:
        print(
            f"frogkick: camera check: {facts['found']} of {facts['places']} places found, largest error "
            f"{facts['max_mm']:.3f} mm (limit {limit_mm:g}), {facts['heading_max_deg']:.3f} degrees "
            f"(limit {limit_deg:g})",
            file=sys.stderr,
        )
        for remark in checked.remarks:
            say(remark)
        raise typer.Exit(1)


@app.command()
def track(
    calibration: Annotated[Path, typer.Argument(help="What 'camera calibrate' wrote.")],
    source: Annotated[str, typer.Option(help="Camera number, video, or folder of pictures.")] = "0",
    seconds: Annotated[float | None, typer.Option(help="How long; default: to the end, or Ctrl-C.")] = None,
    view: Annotated[
        bool, typer.Option("--view", help="Draw pictures, tag and fixes in the browser.")
    ] = False,
    json: JsonOption = False,
) -> None:
    """Print the tag's place in each picture, without a robot. Exit 1 if none told one.

    A line for each is x_m y_m heading_rad age_s: pose in the pool's frame, and how old its picture is. So the
    lines may be piped into 'frogkick run --fixes stdin'.
    """
    from frogkick.front.cameras import track_camera

    def tell(fix: Any) -> None:
        x_m, y_m, heading_rad = fix.pose_world
        print(f"{x_m:.5f} {y_m:.5f} {heading_rad:.5f} {fix.delay_s:.4f}", flush=True)

    found = track_camera(
        calibration, source, seconds=seconds, view=view, each=(lambda _fix: None) if json else tell
    )
    told = found.as_json()
    if json:
        show(told, json)
    without = {reason: count for reason, count in found.reasons.items() if reason != "found"}
    why = ", ".join(f"{count} x {reason}" for reason, count in without.items())
    say(
        f"{found.fixes} places of {told['pictures']} pictures, {told['rate_hz']:.1f} a second"
        f"{f'; without one: {why}' if why else ''}"
    )
    if not found.fixes:
        raise typer.Exit(1)


@app.command("tag")
def tag_page(
    out: Annotated[Path, typer.Option(help="Page to print (.pdf, .svg or .png).")],
    tag_family: FamilyOption = "tag36h11",
    tag_id: TagIdOption = 0,
    tag_size_mm: TagSizeOption = 47.0,
    json: JsonOption = False,
) -> None:
    """Write a tag to print at true scale, with an arrow that points forward, and a ruler."""
    from frogkick.front.cameras import write_tag

    require_writable(out)
    width_m, height_m = write_tag(out, family=tag_family, tag_id=tag_id, size_m=tag_size_mm / 1e3)
    show({"out": str(out), "page_mm": [1e3 * width_m, 1e3 * height_m], "tag_size_mm": tag_size_mm}, json)
