"""``frogkick camera``: calibrate the camera over the pool, check how far off it is."""

from __future__ import annotations

import re
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from frogkick.cli.common import JsonOption, SeedOption, json_text, show
from frogkick.errors import InputError
from frogkick.files import require_writable, write_text

if TYPE_CHECKING:
    from frogkick.vision.calibration import Calibration, Lens
    from frogkick.vision.check import Place

app = typer.Typer(help="Calibrate the camera over the pool, check how far off it is.", no_args_is_help=True)


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
    tag_family: Annotated[
        str, typer.Option(help="tag36h11, or tagStandard41h12 (with the extra 'apriltag').")
    ] = "tag36h11",
    tag_id: Annotated[int, typer.Option(help="Number of the tag in its family.")] = 0,
    tag_size_mm: Annotated[
        float, typer.Option(help="Side of tag36h11's black, of tagStandard41h12's white square.")
    ] = 47.0,
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
    import numpy as np

    from frogkick.vision.board import Board, calibrate_lens, read_picture, read_pictures
    from frogkick.vision.calibration import Tag, refraction_offset_m
    from frogkick.vision.calibration_file import write_calibration
    from frogkick.vision.corners import calibrate_corners, read_corners
    from frogkick.vision.plane_board import calibrate_plane

    require_writable(out)
    if (corners is None) == (plane_picture is None):
        raise InputError(
            "give the pool's corners (--corners) or a picture of the board (--plane-picture), one"
        )
    tag = Tag(
        family=tag_family,
        id=tag_id,
        size_m=tag_size_mm / 1e3,
        height_m=tag_height_mm / 1e3,
        refraction_offset_m=refraction_offset_m(tag_height_mm / 1e3),
        height_sd_m=tag_height_sd_mm / 1e3,
        tilt_sd_rad=float(np.deg2rad(tag_tilt_sd_deg)),
        mount_heading_rad=float(np.deg2rad(tag_heading_deg)),
        offset_body_m=_signed_pair(tag_at_mm, "--tag-at-mm", 1e-3),
    )
    pool_m = _pair(pool, "--pool")
    size = None if image is None else _whole_pair(image, "--image")
    described = None
    if board is not None:
        described = Board(board, *_whole_pair(squares, "--squares"), square_mm / 1e3)
    lens: Lens | None = None
    lens_rms = float("nan")
    if pictures is not None:
        if described is None:
            raise InputError("--pictures shows a board: say which with --board chessboard or --board charuco")
        found = read_pictures(pictures)
        lens, lens_rms, _ = calibrate_lens(described, found)
        seen = (found[0][1].shape[1], found[0][1].shape[0])
        if size is not None and size != seen:
            raise InputError(f"--image {image} is not the pictures' size, {seen[0]}x{seen[1]}")
        size = seen
    if plane_picture is not None:
        if described is None:
            raise InputError("--plane-picture shows a board: say which with --board chessboard or charuco")
        laid = read_picture(plane_picture)
        at = _signed_pair(board_at, "--board-at", 1.0)
        made = calibrate_plane(
            described, laid, at, pool_m, tag, corner_height_mm / 1e3, camera_height_m, lens
        )
    else:
        assert corners is not None
        if size is None:
            raise InputError("the corners are pixels of a picture: give its size, as --image 640x480")
        made = calibrate_corners(
            read_corners(corners), pool_m, size, tag, corner_height_mm / 1e3, camera_height_m, lens
        )
    write_calibration(out, made)
    values = _facts(made, lens_rms) | {"out": str(out)}
    show(values, json)


def _signed_pair(text: str, option: str, unit: float) -> tuple[float, float]:
    try:
        first, second = (unit * float(part) for part in text.split(","))
    except ValueError as error:
        raise InputError(f"{option} {text!r} is not two numbers: write as 10,-5") from error
    if not (abs(first) < 100 and abs(second) < 100):
        raise InputError(f"{option} {text!r} is beyond 100 m")
    return first, second


def _facts(made: Calibration, lens_rms_px: float) -> dict[str, Any]:
    import numpy as np

    corner = np.array([[0, 0], [made.pool_m[0], 0], [*made.pool_m], [0, made.pool_m[1]]], dtype=float)
    middle = corner.mean(axis=0, keepdims=True)
    step = made.pixels(middle + np.array([[0, 0], [1e-3, 0], [0, 1e-3]]))
    shift = None
    if made.camera_m is not None:
        above = made.camera_m[2] - made.tag.apparent_height_m
        shift = float(np.hypot(*(corner - made.camera_m[:2]).T).max() / above)
    return {
        "method": made.method,
        "points": made.points,
        "rms_px": made.rms_px,
        "lens_rms_px": lens_rms_px,
        "camera_m": made.camera_m,
        "tag_height_m": made.tag.height_m,
        "refraction_offset_m": made.tag.refraction_offset_m,
        "heave_shift_mm_per_mm": shift,
        "px_per_mm": float(np.sqrt(abs(np.linalg.det(step[1:] - step[0])))),
    }


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
    import numpy as np

    from frogkick.vision.calibration_file import read_calibration
    from frogkick.vision.check import check_frames, check_points, known_places, rendered, summary
    from frogkick.vision.scene import Conditions

    require_writable(out, folder=True)
    known = read_calibration(calibration)
    if points is not None and places is not None:
        raise InputError("--points and --places are two checks: give one of them")
    if points is not None:
        found, source = check_points(known, points), "points"
    elif places is not None:
        found, source = check_frames(known, known_places(places)), "places"
    else:
        columns, across = _whole_pair(grid, "--grid")
        if not (1 <= columns <= 50 and 1 <= across <= 50):
            raise InputError(f"--grid {grid}: allowed is 1x1 to 50x50")
        conditions = Conditions(blur_px=blur_px, noise=noise, wave_height_m=wave_mm / 1e3)
        rng = np.random.default_rng(seed)
        found, source = check_frames(known, rendered(known, conditions, columns, across, rng)), "rendered"
    facts: dict[str, Any] = {"source": source, **summary(found), "limit_mm": limit_mm, "limit_deg": limit_deg}
    facts["within"] = bool(
        facts["found"] == facts["places"]
        and facts["max_mm"] <= limit_mm
        and not facts["heading_max_deg"] > limit_deg
    )
    rows = [_row(place) for place in found]
    if out is not None:
        from frogkick.report.camera_figure import write_error_map

        write_error_map(
            known.pool_m,
            np.array([[p.x_m, p.y_m, p.error_x_mm, p.error_y_mm] for p in found]),
            f"{source}: rms {facts['rms_mm']:.3f} mm, max {facts['max_mm']:.3f} mm",
            out / "error_map.png",
        )
        write_text(out / "error_map.json", json_text({**facts, "map": rows}) + "\n")
    show({**facts, "map": rows} if json else facts, json)
    if not facts["within"]:
        print(
            f"frogkick: camera check: {facts['found']} of {facts['places']} places found, largest error "
            f"{facts['max_mm']:.3f} mm (limit {limit_mm:g}), {facts['heading_max_deg']:.3f} degrees "
            f"(limit {limit_deg:g})",
            file=sys.stderr,
        )
        raise typer.Exit(1)


def _row(place: Place) -> dict[str, Any]:
    return {**asdict(place), "error_mm": place.error_mm}
